"""The GPU that this process computes on, through NVIDIA's Python binding of CUDA (package ``cuda-bindings``)."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from autolights.core.errors import UsageError

_DRIVER_FILE = Path("/proc/driver/nvidia/version")


class GpuInfo(NamedTuple):
    """What an engine is bound to.

    Attributes:
        name: As the driver calls it.
        compute_capability: Like ``8.7``.
        driver: The newest CUDA that the driver knows, and the driver's own version where the system tells it.
    """

    name: str
    compute_capability: str
    driver: str


class Gpu:
    """CUDA's current device: what it is, memory on it, and one stream of work.

    Raises:
        UsageError: If the binding is missing or there is no GPU.
    """

    def __init__(self) -> None:
        try:
            from cuda.bindings import runtime
        except ImportError as error:
            raise UsageError("TensorRT needs NVIDIA's Python binding of CUDA: pip install cuda-bindings") from error
        self._cuda: Any = runtime
        properties = self._call("cudaGetDeviceProperties", self._call("cudaGetDevice"))
        cuda = self._call("cudaDriverGetVersion")
        self.info = GpuInfo(
            name=properties.name.decode().strip("\0"),
            compute_capability=f"{properties.major}.{properties.minor}",
            driver=f"CUDA {cuda // 1000}.{cuda % 1000 // 10}{_driver_version()}",
        )
        self.stream: int = int(self._call("cudaStreamCreate"))

    def allocate(self, byte_count: int) -> int:
        """Address of new memory on the device."""
        return int(self._call("cudaMalloc", max(byte_count, 1)))

    def free(self, address: int) -> None:
        """Give memory back."""
        self._call("cudaFree", address)

    def upload(self, address: int, array: np.ndarray) -> None:
        """Copy a contiguous array to the device, in the order of the stream."""
        kind = self._cuda.cudaMemcpyKind.cudaMemcpyHostToDevice
        self._call("cudaMemcpyAsync", address, array.ctypes.data, array.nbytes, kind, self.stream)

    def download(self, array: np.ndarray, address: int) -> None:
        """Copy from the device into a contiguous array; it is there after `wait`."""
        kind = self._cuda.cudaMemcpyKind.cudaMemcpyDeviceToHost
        self._call("cudaMemcpyAsync", array.ctypes.data, address, array.nbytes, kind, self.stream)

    def wait(self) -> None:
        """Until all work of the stream is done."""
        self._call("cudaStreamSynchronize", self.stream)

    def _call(self, function: str, *arguments: Any) -> Any:
        status, *results = getattr(self._cuda, function)(*arguments)
        if status != self._cuda.cudaError_t.cudaSuccess:
            _, text = self._cuda.cudaGetErrorString(status)
            raise UsageError(f"CUDA cannot be used here: {function}: {text.decode()}")
        return results[0] if results else None


def _driver_version() -> str:
    """Like ``, driver 570.86.15``; empty where the system does not tell."""
    if not _DRIVER_FILE.is_file():
        return ""
    words = _DRIVER_FILE.read_text(encoding="utf-8").partition("\n")[0].split()
    numbers = [word for word in words if word[0].isdigit() and "." in word]
    return f", driver {numbers[0]}" if numbers else ""
