"""Loads weight files as torch tensors by name, without running anything in them."""

from __future__ import annotations

from pathlib import Path

import safetensors
import safetensors.torch
import torch
from torch import Tensor

from ggavatar.errors import InputError
from ggavatar.io.regular_files import regular_size

MAX_WEIGHT_BYTES = 1 << 30


def load_weights(path: Path) -> dict[str, Tensor]:
    """The named tensors of a .pth or .safetensors file, on the CPU.

    Raises:
        InputError: The file is larger than `MAX_WEIGHT_BYTES`, damaged, or holds anything but tensors by name.
    """
    regular_size(path, "a weight file", MAX_WEIGHT_BYTES)
    if path.suffix == ".safetensors":
        try:
            return safetensors.torch.load_file(path)
        except (safetensors.SafetensorError, OSError) as error:  # a file that changed, or a disk that cannot read it
            raise InputError(
                f"{path}: expected tensors by name, found a damaged file: {error}; get it again"
            ) from error
    return _load_pth(path)


def _load_pth(path: Path) -> dict[str, Tensor]:
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except MemoryError:
        raise
    except Exception as error:  # damaged files make torch raise many types, and the disk may fail
        first_line = str(error).partition("\n")[0] or "an empty file"
        raise InputError(f"{path}: expected tensors by name, found other data: {first_line}; get it again") from error
    if not isinstance(state, dict) or not all(isinstance(value, Tensor) for value in state.values()):
        raise InputError(f"{path}: expected tensors by name, found {type(state).__name__}; get it again")
    return dict(state)
