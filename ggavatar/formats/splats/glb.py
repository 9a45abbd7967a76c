"""Writer of glTF binary with the extension KHR_gaussian_splatting, of which it has uncompressed 32-bit floats.

Written by hand: pygltflib and trimesh know no extension of attributes, and the container is two chunks. Attributes of
the extension are activated: rotations are unit quaternions xyzw, scales lengths, opacities in [0, 1]; harmonics are
those of 3DGS. glTF's axes (y up, z to the front of the model) are ours. Viewers without the extension draw points in
`COLOR_0`. The extension has no skinning, so that a file holds one pose.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt16
from numpy import ndarray

from ggavatar.errors import InputError
from ggavatar.formats.splats.file_kinds import GLB_MAGIC
from ggavatar.formats.splats.stored_gaussians import StoredGaussians
from ggavatar.gaussians.initial_colors import SH_C0
from ggavatar.io.atomic import write_atomically

EXTENSION = "KHR_gaussian_splatting"
MAX_FILE_BYTES = (1 << 32) - 1
_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942
_FLOAT, _UNSIGNED_SHORT, _POINTS, _ARRAY_BUFFER = 5126, 5123, 0, 34962
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


def write_glb(path: Path, rows: StoredGaussians) -> None:
    """Write Gaussians given in our axes; the file appears complete or not at all.

    Raises:
        InputError: They do not fit into 4 GiB, which is all that the container can hold.
    """
    attributes = _attributes(rows)
    text = json.dumps(_document(attributes), separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    # Every attribute has rows of a multiple of four bytes, so that all begin at one.
    size = sum(values.nbytes for values in attributes.values())
    total = 12 + 8 + len(text) + 8 + size
    if total > MAX_FILE_BYTES:
        raise InputError(f"{path}: {len(rows)} Gaussians need {total} bytes, glTF binary holds 4 GiB; use --format ply")

    def write(stream: Any) -> None:
        stream.write(struct.pack("<4sII", GLB_MAGIC, 2, total))
        stream.write(struct.pack("<II", len(text), _JSON_CHUNK) + text)
        stream.write(struct.pack("<II", size, _BINARY_CHUNK))
        for values in attributes.values():
            stream.write(values.tobytes())

    write_atomically(path, write)


def _attributes(rows: StoredGaussians) -> dict[str, ndarray]:
    """The arrays of the primitive by their glTF names, in the order of the file."""
    quats = rows.quats.astype(np.float64)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    opacities = 1 / (1 + np.exp(-rows.opacity_logits.astype(np.float64)))
    found = {
        "POSITION": rows.means,
        "COLOR_0": _point_colors(rows.sh_dc, opacities),
        f"{EXTENSION}:ROTATION": quats[:, [1, 2, 3, 0]],
        f"{EXTENSION}:SCALE": np.exp(rows.log_scales.astype(np.float64)),
        f"{EXTENSION}:OPACITY": opacities[:, None],
        f"{EXTENSION}:SH_DEGREE_0_COEF_0": rows.sh_dc,
    }
    for degree in range(1, rows.degree + 1):
        for order in range(2 * degree + 1):
            found[f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{order}"] = rows.sh_rest[:, degree**2 - 1 + order]
    return {name: values if values.dtype == np.uint16 else values.astype("<f4") for name, values in found.items()}


def _point_colors(sh_dc: Float[ndarray, "N 3"], opacities: Float[ndarray, " N"]) -> UInt16[ndarray, "N 4"]:
    """Linear RGB and opacity, normalized, for viewers that draw points: glTF's vertex colors are linear."""
    srgb = (0.5 + SH_C0 * sh_dc.astype(np.float64)).clip(0, 1)
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    return np.rint(np.concatenate((linear, opacities[:, None]), axis=1) * 65535).astype("<u2")


def _document(attributes: Mapping[str, ndarray]) -> dict[str, Any]:
    """The JSON of the file: one mesh of points, an accessor and a view of the buffer for every attribute."""
    accessors, views, offset = [], [], 0
    for index, (name, values) in enumerate(attributes.items()):
        is_float = values.dtype != np.uint16
        accessor = {
            "bufferView": index,
            "componentType": _FLOAT if is_float else _UNSIGNED_SHORT,
            "count": len(values),
            "type": _TYPES[values.shape[1]],
        }
        if not is_float:
            accessor["normalized"] = True
        if name == "POSITION":
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        accessors.append(accessor)
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": values.nbytes, "target": _ARRAY_BUFFER})
        offset += values.nbytes
    primitive = {
        "mode": _POINTS,
        "attributes": {name: index for index, name in enumerate(attributes)},
        "extensions": {EXTENSION: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}},
    }
    return {
        "asset": {"version": "2.0", "generator": "GGAvatar"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offset}],
    }
