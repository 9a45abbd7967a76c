"""Freed memory stays with the process, measured by its page faults (reference: getrusage)."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys

import pytest

COUNT = """
import ctypes, resource, sys
import numpy as np
if sys.argv[1] == "prepared":
    from ggavatar.cli.process import prepare_process
    prepare_process()
ctypes.CDLL(None).prctl(41, 1, 0, 0, 0)  # no huge pages, or their faults would be too few to compare
for number in range(21):
    if number == 1:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    first, second, third = (np.ones(7_500_000, np.float32) for _ in range(3))
    del first, second, third
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(mode: str) -> int:
    """Page faults of twenty rounds that allocate and free 90 MB, after one round of warm-up."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("MALLOC_")}
    command = [sys.executable, "-c", COUNT, mode]
    return int(subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout)


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallopt"), reason="this C library has no mallopt")
def test_freed_memory_is_used_again_without_page_faults() -> None:
    assert faults("prepared") < faults("as it is") / 10
