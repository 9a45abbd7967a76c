"""Reads hostile files in a process of its own and measures what that costs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]

_PROGRAM = """
import importlib, json, pathlib, resource, sys, time
module, name, *files = sys.argv[1:]
read = getattr(importlib.import_module(module), name)
from ggavatar.errors import InputError
for file in files:
    began = time.process_time()
    try:
        read(pathlib.Path(file))
        said = None
    except InputError as error:
        said = str(error)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(json.dumps([said, time.process_time() - began, peak >> 10]), flush=True)
"""


class Cost(NamedTuple):
    """What reading one file came to.

    Attributes:
        message: Of the `InputError`; None if the file was read.
        seconds: Of the processor.
        peak: Largest memory of the process so far, MiB.
    """

    message: str | None
    seconds: float
    peak: int


def costs(module: str, function: str, files: Sequence[Path]) -> list[Cost]:
    """Read the files one after the other with `module.function`; any error but InputError fails."""
    command = [sys.executable, "-c", _PROGRAM, module, function, *map(str, files)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=1800)
    assert ran.returncode == 0, ran.stderr
    return [Cost(*json.loads(line)) for line in ran.stdout.splitlines()]
