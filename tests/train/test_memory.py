"""The effect is seen in page faults: memory that is kept needs not be cleared again."""

import subprocess
import sys

import pytest

_PROGRAM = """
import resource
from autolights.train.memory import keep_freed_memory

if {kept}:
    keep_freed_memory()
for i in range(12):
    if i == 2:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    b"x" * 64_000_000
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def page_faults(*, kept):
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM.format(kept=kept)], capture_output=True, text=True, check=True
    )
    return int(done.stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="malloc is another one here")
def test_a_large_block_is_not_fetched_from_the_system_again():
    assert page_faults(kept=True) < 0.1 * page_faults(kept=False)
