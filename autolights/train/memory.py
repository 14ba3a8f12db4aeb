"""How the C library hands out memory, which decides half of the speed of training on a CPU."""

import ctypes
import sys

# From glibc's malloc.h.
_TRIM_THRESHOLD, _MMAP_MAX = -1, -4
_NEVER = 2**31 - 1


def keep_freed_memory() -> None:
    """Let this process keep what it frees, for the next tensor of that size.

    A step frees hundreds of megabytes of activations. By default glibc gives such blocks back to the system, which then
    clears every page of them again for the next step. The memory of a run does not grow by it: the peak stays the peak.
    Does nothing where the C library is another one, or the network runs elsewhere.
    """
    if sys.platform != "linux":
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # musl has none
    if mallopt is not None:
        mallopt(_MMAP_MAX, 0)
        mallopt(_TRIM_THRESHOLD, _NEVER)
