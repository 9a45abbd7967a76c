"""The device that `--device auto` will mean, told without torch, for the defaults on a help page."""

from __future__ import annotations

import ctypes
import functools
import importlib.util
import os
import re
import sys
from pathlib import Path

DRIVER = "nvcuda.dll" if os.name == "nt" else "libcuda.so.1"
"""NVIDIA's driver, as the loader finds it."""


@functools.cache
def likely_device() -> str:
    """`cuda` if the driver counts a device and the installed torch is built for CUDA, else `cpu`."""
    return "cuda" if _torch_has_cuda() and _devices_of_the_driver() > 0 else "cpu"


def device_default() -> dict[str, str]:
    """What `--device` stands for where it is not given, as `CommandPage.defaults` has it."""
    return {"device": f"auto, here {likely_device()}"}


def _torch_has_cuda() -> bool:
    """Whether the version file of torch names a version of CUDA."""
    try:
        found = importlib.util.find_spec("torch")
        text = (Path(found.origin).parent / "version.py").read_text("utf-8") if found and found.origin else ""
    except (OSError, ValueError, UnicodeDecodeError):
        return False
    return re.search(r"^cuda\b.*=\s*['\"]", text, re.MULTILINE) is not None


def _devices_of_the_driver() -> int:
    """How many CUDA devices the driver shows to this process."""
    if sys.platform == "darwin" or os.environ.get("CUDA_VISIBLE_DEVICES") in ("", "-1"):
        return 0
    count = ctypes.c_int(0)
    try:
        driver = ctypes.CDLL(DRIVER)
        if driver.cuInit(0) != 0 or driver.cuDeviceGetCount(ctypes.byref(count)) != 0:
            return 0
    except (OSError, AttributeError):
        return 0
    return count.value
