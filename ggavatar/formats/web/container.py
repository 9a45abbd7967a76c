"""The bytes of a web avatar: safetensors with a description as JSON, compressed; equal content gives equal bytes.

Layout `ggavatar-web` 1 (docs/web-avatar.md). A tensor X that is stored quantized has X.low and X.step beside it.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from safetensors.numpy import save

SCHEMA, VERSION = "ggavatar-web", 1
DTYPES = (np.uint8, np.uint16, np.uint32, np.float32)
MAX_UNPACKED_BYTES = 64 << 20
"""The page refuses more than this, and more Gaussians than `MAX_GAUSSIANS`."""
MAX_GAUSSIANS = 500_000


def pack(tensors: Mapping[str, np.ndarray], description: Mapping[str, Any]) -> bytes:
    """The compressed container.

    Raises:
        ValueError: A tensor of another type, or a number in the description that JSON does not have.
    """
    # safetensors writes the memory of an array that is not contiguous in the wrong order, without a word.
    arrays = {name: np.ascontiguousarray(tensors[name]) for name in sorted(tensors)}
    wrong = [name for name, array in arrays.items() if array.dtype not in DTYPES]
    if wrong:
        raise ValueError(f"expected tensors of {DTYPES}, got {arrays[wrong[0]].dtype} for {wrong[0]}")
    text = json.dumps({"schema": SCHEMA, "version": VERSION, **description}, allow_nan=False, sort_keys=True)
    return gzip.compress(save(arrays, metadata={"avatar": text}), compresslevel=9, mtime=0)
