"""Reads MediaPipe's `face_landmarker.task` (three networks and the canonical face) and single `.tflite` networks.

The file is not trusted: sizes are bounded, and damage raises `InputError`. The canonical face is one repeated
float field of a protocol buffer, which 25 lines read; `protobuf` would need classes generated from MediaPipe's .proto.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float

from ggavatar.errors import InputError
from ggavatar.io.regular_files import read_file
from ggavatar.io.zip_files import open_zip, read_zipped

MAX_MEMBER_BYTES = 64 * 1024 * 1024
"""Largest network or part of the bundle that is read (64 MiB)."""

MEMBERS = {
    "detector": "face_detector.tflite",
    "landmarks": "face_landmarks_detector.tflite",
    "blendshapes": "face_blendshapes.tflite",
    "geometry": "geometry_pipeline_metadata_landmarks.binarypb",
}
"""File names of the bundle's parts."""

ADVICE = "download it again; ggavatar-prep --help names the official address"


@dataclass(frozen=True)
class CanonicalFace:
    """The average face whose vertices are the first 468 landmarks.

    Attributes:
        vertices: Positions, m; +Y up, face toward +Z, +X the subject's left.
    """

    vertices: Float[np.ndarray, "468 3"]


def read_member(bundle: Path, part: str) -> bytes:
    """Read one part of the bundle: "detector", "landmarks", "blendshapes" or "geometry".

    Raises:
        InputError: The file is not a zip or lacks the part, or the part is damaged or larger than 64 MiB.
    """
    name = MEMBERS[part]
    with open_zip(bundle, f"a face landmarker bundle (a zip archive; {ADVICE})") as archive:
        if name not in archive.namelist():
            raise InputError(f"{bundle}: expected a face landmarker bundle with {name}, which is missing; {ADVICE}")
        size = archive.getinfo(name).file_size
        if size > MAX_MEMBER_BYTES:
            raise InputError(f"{bundle}: expected at most {MAX_MEMBER_BYTES} bytes of {name}, found {size}; {ADVICE}")
        content = read_zipped(archive, name, MAX_MEMBER_BYTES)
    if len(content) != size:
        raise InputError(f"{bundle}: expected {size} bytes of {name}, found {len(content)}; {ADVICE}")
    return content


def load_network(path: Path, part: str) -> cv2.dnn.Net:
    """Load a network, from the bundle or from a `.tflite` file of its own, into OpenCV's DNN module on the CPU.

    Args:
        path: The bundle or the network's file.
        part: Name of the network; for a bundle its key in `MEMBERS`.

    Raises:
        InputError: The file cannot be read, or OpenCV does not support the network.
    """
    is_network_file = path.suffix == ".tflite"
    content = read_file(path, MAX_MEMBER_BYTES, "a network") if is_network_file else read_member(path, part)
    try:
        return cv2.dnn.readNetFromTFLite(np.frombuffer(content, np.uint8))
    except cv2.error as error:
        name = part if is_network_file else MEMBERS[part]
        raise InputError(f"{path}: OpenCV {cv2.__version__} cannot read {name} ({error.err}); {ADVICE}") from error


def canonical_face(bundle: Path) -> CanonicalFace:
    """Read the canonical face from the bundle's geometry metadata.

    Raises:
        InputError: As in `read_member`, or the metadata is damaged.
    """
    content = read_member(bundle, "geometry")
    try:
        return _parse_geometry(content)
    except (ValueError, IndexError, struct.error) as error:
        raise InputError(f"{bundle}: {MEMBERS['geometry']} is damaged ({error}); {ADVICE}") from error


def _parse_geometry(content: bytes) -> CanonicalFace:
    """Parse a geometry message, whose mesh is field 1."""
    vertices = np.zeros((0, 5))
    for number, value in _fields(content):
        if number == 1:
            vertices = _parse_vertices(value)
    if vertices.shape != (468, 5) or not np.isfinite(vertices).all():
        raise ValueError(f"{len(vertices)} vertices, expected 468 finite ones")
    meters_per_unit = 0.01
    return CanonicalFace(vertices[:, :3] * meters_per_unit)


def _parse_vertices(content: bytes) -> np.ndarray:
    """Vertices (x, y, z, u, v) of a mesh message, whose floats are field 3."""
    return np.array([value for number, value in _fields(content) if number == 3], dtype=np.float64).reshape(-1, 5)


def _fields(content: bytes) -> Iterator[tuple[int, Any]]:
    """Field numbers and values of a protocol buffer message: integers, 32-bit floats and byte strings."""
    position = 0
    while position < len(content):
        tag, position = _varint(content, position)
        wire_type = tag & 7
        if wire_type == 0:
            value, position = _varint(content, position)
            yield tag >> 3, value
        elif wire_type == 2:
            length, position = _varint(content, position)
            yield tag >> 3, content[position : position + length]
            position += length
        elif wire_type == 5:
            yield tag >> 3, struct.unpack_from("<f", content, position)[0]
            position += 4
        else:
            raise ValueError(f"unknown wire type {wire_type} at byte {position}")


def _varint(content: bytes, position: int) -> tuple[int, int]:
    """Decode an integer in base 128, least significant digit first; returns it and the position after it."""
    value = 0
    for shift in range(0, 64, 7):
        byte = content[position]
        position += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, position
    raise ValueError(f"an unterminated integer at byte {position}")
