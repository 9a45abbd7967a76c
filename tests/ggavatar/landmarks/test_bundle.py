"""The bundle is read as data: archives that lie, lack parts or are damaged end in a message that names the file."""

from __future__ import annotations

import io
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

from ggavatar.errors import InputError
from ggavatar.landmarks.bundle import MEMBERS, canonical_face, load_network, read_member


def geometry(vertices: int = 468) -> bytes:
    """A geometry message as the bundle holds it: mesh (vertices 3, indices 4) in field 1, weights in field 2."""
    mesh = b"".join(b"\x1d" + struct.pack("<f", float(number)) for number in range(5 * vertices))
    mesh += b"".join(b"\x20" + bytes([index]) for index in (0, 1, 2, 2, 1, 3))
    head, length = b"\x0a", len(mesh)
    size = bytearray()
    while length > 127:
        size.append(length & 127 | 128)
        length >>= 7
    size.append(length)
    weight = b"\x08\x04" + b"\x15" + struct.pack("<f", 0.5)
    return head + bytes(size) + mesh + b"\x12" + bytes([len(weight)]) + weight


def archive(path: Path, contents: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as written:
        for name, data in contents.items():
            written.writestr(name, data)
    return path


def test_geometry_is_parsed(tmp_path: Path) -> None:
    face = canonical_face(archive(tmp_path / "a.task", {MEMBERS["geometry"]: geometry()}))
    np.testing.assert_allclose(face.vertices[1], np.array([5, 6, 7]) * 0.01)
    assert face.vertices.shape == (468, 3)


def test_lies_and_damage_are_refused(tmp_path: Path) -> None:
    plain = tmp_path / "plain.task"
    plain.write_bytes(b"not an archive")
    with pytest.raises(InputError, match=r"plain\.task"):
        read_member(plain, "landmarks")
    with pytest.raises(InputError, match="bundle with face_landmarks_detector"):
        read_member(archive(tmp_path / "empty.task", {"other": b""}), "landmarks")
    bomb = archive(tmp_path / "bomb.task", {MEMBERS["landmarks"]: bytes(70 << 20)})
    with pytest.raises(InputError, match="found 73400320"):
        read_member(bomb, "landmarks")
    with pytest.raises(InputError, match="cannot read"):
        load_network(archive(tmp_path / "junk.task", {MEMBERS["landmarks"]: b"\x00" * 64}), "landmarks")
    with pytest.raises(InputError, match="100 vertices"):
        canonical_face(archive(tmp_path / "few.task", {MEMBERS["geometry"]: geometry(100)}))


def test_a_hundred_mutations_of_the_geometry_never_leave_a_traceback(tmp_path: Path) -> None:
    generator = np.random.default_rng(0)
    whole, refused = geometry(), 0
    for _ in range(100):
        data = bytearray(whole[: generator.integers(1, len(whole))] if generator.random() < 0.3 else whole)
        for place in generator.integers(0, len(data), 8):
            data[place] = generator.integers(0, 256)
        try:
            face = canonical_face(archive(tmp_path / "mutated.task", {MEMBERS["geometry"]: bytes(data)}))
            assert face.vertices.shape == (468, 3)
        except InputError as error:
            refused += "mutated.task" in str(error)
    assert refused > 10


def test_a_truncated_archive_is_refused(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as written:
        written.writestr(MEMBERS["geometry"], geometry())
    content = buffer.getvalue()
    for share in (0.2, 0.9):
        path = tmp_path / "cut.task"
        path.write_bytes(content[: int(share * len(content))])
        with pytest.raises(InputError, match=r"cut\.task"):
            canonical_face(path)
