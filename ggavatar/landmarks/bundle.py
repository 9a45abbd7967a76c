"""What is inside `face_landmarker.task`: three networks and the canonical face they refer to.

Read without trusting the file. Networks may also come as files of their own.
"""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float

from ggavatar.errors import InputError

LARGEST_MEMBER = 64 * 1024 * 1024
MEMBERS = {
    "detector": "face_detector.tflite",
    "landmarks": "face_landmarks_detector.tflite",
    "blendshapes": "face_blendshapes.tflite",
    "geometry": "geometry_pipeline_metadata_landmarks.binarypb",
}
ADVICE = "fetch it again: ggavatar-prep --help names the official address"


@dataclass(frozen=True)
class CanonicalFace:
    """The average face whose vertices are the first 468 landmarks.

    Attributes:
        vertices: Positions, m; +Y up, face toward +Z, +X the subject's left.
    """

    vertices: Float[np.ndarray, "468 3"]


def read_member(bundle: Path, part: str) -> bytes:
    """One part of the bundle ("detector", "landmarks", "blendshapes", "geometry").

    Raises:
        InputError: The file is no zip, lacks the part, or the part is larger than 64 MiB or damaged.
    """
    name = MEMBERS[part]
    try:
        with zipfile.ZipFile(bundle) as archive:
            size = archive.getinfo(name).file_size
            if size > LARGEST_MEMBER:
                raise InputError(f"{bundle}: {name} states {size} bytes, expected at most {LARGEST_MEMBER}; {ADVICE}")
            with archive.open(name) as member:
                content = member.read(LARGEST_MEMBER + 1)
    except KeyError as error:
        raise InputError(f"{bundle}: expected a face landmarker bundle holding {name}, found none; {ADVICE}") from error
    except (zipfile.BadZipFile, EOFError, RuntimeError, NotImplementedError, ValueError) as error:
        raise InputError(
            f"{bundle}: expected a face landmarker bundle (a zip archive), found {error}; {ADVICE}"
        ) from error
    if len(content) != size:
        raise InputError(f"{bundle}: {name} should have {size} bytes, found {len(content)}; {ADVICE}")
    return content


def load_network(path: Path, part: str) -> cv2.dnn.Net:
    """A network of the bundle, or one with a `.tflite` file of its own, ready for OpenCV's DNN on the CPU.

    Args:
        path: The bundle or the network's file.
        part: Which one; of a bundle its key in `MEMBERS`.

    Raises:
        InputError: Not to be read, or not a network that OpenCV knows.
    """
    single = path.suffix == ".tflite"
    content = read_single(path) if single else read_member(path, part)
    try:
        return cv2.dnn.readNetFromTFLite(np.frombuffer(content, np.uint8))
    except cv2.error as error:
        name = part if single else MEMBERS[part]
        raise InputError(f"{path}: OpenCV {cv2.__version__} cannot read {name} ({error.err}); {ADVICE}") from error


def read_single(path: Path) -> bytes:
    """A network's own file; `InputError` if it is larger than 64 MiB."""
    size = path.stat().st_size
    if size > LARGEST_MEMBER:
        raise InputError(f"{path}: {size} bytes, expected a network of at most {LARGEST_MEMBER}; {ADVICE}")
    return path.read_bytes()


def canonical_face(bundle: Path) -> CanonicalFace:
    """The canonical face of the bundle's geometry metadata (protocol buffer: mesh = 1)."""
    content = read_member(bundle, "geometry")
    try:
        return _parse_geometry(content)
    except (ValueError, IndexError, struct.error) as error:
        raise InputError(f"{bundle}: {MEMBERS['geometry']} is damaged ({error}); {ADVICE}") from error


def _parse_geometry(content: bytes) -> CanonicalFace:
    vertices = np.zeros((0, 5))
    for number, value in _fields(content):
        if number == 1:
            vertices = _parse_vertices(value)
    if vertices.shape != (468, 5) or not np.isfinite(vertices).all():
        raise ValueError(f"{len(vertices)} vertices, expected 468 finite ones")
    centimeter = 0.01
    return CanonicalFace(vertices[:, :3] * centimeter)


def _parse_vertices(content: bytes) -> np.ndarray:
    """Vertices (x, y, z, u, v) of a mesh message: its floats are field 3."""
    return np.array([value for number, value in _fields(content) if number == 3], dtype=np.float64).reshape(-1, 5)


def _fields(content: bytes) -> Iterator[tuple[int, Any]]:
    """Field numbers and values of a protocol buffer message: integers, 32-bit floats and byte strings."""
    position = 0
    while position < len(content):
        tag, position = _varint(content, position)
        kind = tag & 7
        if kind == 0:
            value, position = _varint(content, position)
            yield tag >> 3, value
        elif kind == 2:
            length, position = _varint(content, position)
            yield tag >> 3, content[position : position + length]
            position += length
        elif kind == 5:
            yield tag >> 3, struct.unpack_from("<f", content, position)[0]
            position += 4
        else:
            raise ValueError(f"wire type {kind} at byte {position}")


def _varint(content: bytes, position: int) -> tuple[int, int]:
    """An integer in base 128, least significant first, and the position after it."""
    value = 0
    for shift in range(0, 64, 7):
        byte = content[position]
        position += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, position
    raise ValueError(f"an endless integer at byte {position}")
