"""Damaged and hostile PLY files: an InputError that names the file, or sound Gaussians; never much memory.

What sound files may look like is in `test_gaussian_ply.py`.
"""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ggavatar.errors import InputError
from ggavatar.formats.splats.gaussian_ply import read_gaussian_ply, write_gaussian_ply
from ggavatar.formats.splats.ply import MAX_ROWS, Header, read_header
from ggavatar.formats.splats.stored_gaussians import StoredGaussians, to_stored
from tests.support.gaussian_cloud import cloud

FUZZING = settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
MEBIBYTE = 1 << 20


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("sound") / "a.ply"
    write_gaussian_ply(path, to_stored(cloud(5, 1)))
    return path.read_bytes()


def outcome(folder: Path, content: bytes) -> StoredGaussians | None:
    """The Gaussians, or None where the file was refused with a message that names it."""
    path = folder / "hostile.ply"
    path.write_bytes(content)
    tracemalloc.start()
    try:
        return read_gaussian_ply(path)
    except InputError as error:
        assert "hostile.ply" in str(error) and len(str(error)) < 1000
        return None
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 4 * MEBIBYTE


def is_sound(rows: StoredGaussians) -> bool:
    arrays = (rows.means, rows.sh_dc, rows.sh_rest, rows.opacity_logits, rows.log_scales, rows.quats)
    return all(np.isfinite(array).all() for array in arrays) and len(rows) > 0


@FUZZING
@given(data=st.data())
def test_cut_off(sound: bytes, tmp_path: Path, data: st.DataObject) -> None:
    length = data.draw(st.integers(0, len(sound) - 1))
    assert outcome(tmp_path, sound[:length]) is None
    longer = outcome(tmp_path, sound + sound[:length] + b"x")
    assert longer is not None and longer.notes == (f"{length + 1} bytes behind its last row are ignored",)


@FUZZING
@given(data=st.data())
def test_flipped_bits(sound: bytes, tmp_path: Path, data: st.DataObject) -> None:
    changed = bytearray(sound)
    for position in data.draw(st.lists(st.integers(0, 8 * len(sound) - 1), min_size=1, max_size=20)):
        changed[position // 8] ^= 1 << position % 8
    found = outcome(tmp_path, bytes(changed))
    assert found is None or is_sound(found)


@FUZZING
@given(count=st.one_of(st.integers(6), st.integers(-(10**6), 0), st.integers(MAX_ROWS - 2, 10**40)))
def test_absurd_counts(sound: bytes, tmp_path: Path, count: int) -> None:
    assert outcome(tmp_path, sound.replace(b"vertex 5\n", b"vertex %d\n" % count)) is None


WORDS = st.sampled_from(
    (
        *("ply", "format", "binary_little_endian", "ascii", "1.0", "element", "vertex", "face", "property", "float"),
        *("list", "double", "x", "y", "opacity", "comment", "end_header", "9" * 30, "", "\x00", "-1", "0", "3"),
    )
)


@FUZZING
@given(lines=st.lists(st.lists(WORDS, max_size=5).map(" ".join), max_size=12), body=st.binary(max_size=200))
def test_nonsense_heads(tmp_path: Path, lines: list[str], body: bytes) -> None:
    head = "\n".join(["ply", "format binary_little_endian 1.0", *lines, "end_header", ""])
    assert outcome(tmp_path, head.encode() + body) is None


@FUZZING
@given(content=st.binary(max_size=400))
def test_noise(tmp_path: Path, content: bytes) -> None:
    assert outcome(tmp_path, content) is None


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (b"binary_little_endian", b"ascii", "lines of 26 numbers|truncated"),
        (b"binary_little_endian", b"binary_big_endian", "broken"),
        (b"binary_little_endian", b"binary_middle_endian", "binary_little_endian"),
        (b"property float x\n", b"property list uchar int x\n", "with lists"),
        (b"property float y\n", b"property float x\n", "each name once"),
        (b"property float x\n", b"property float q\n", "found no x"),
        (b"f_rest_8\n", b"f_rest_9\n", "f_rest_0"),
        (b"element vertex 5", b"element points 5", "elements: points"),
        (b"element vertex 5", b"element vertex 1000000000000", "1 to 50000000 rows"),
        (b"property float nx\n", b"element face 3\n", "no f_dc_0"),
        (b"property float nx\n", b"element vertex 3\n", "each name once"),
        (b"float opacity", b"double opacity", "truncated"),
    ],
)
def test_what_is_wrong_is_said(sound: bytes, tmp_path: Path, old: bytes, new: bytes, words: str) -> None:
    assert old in sound
    (tmp_path / "a.ply").write_bytes(sound.replace(old, new))
    with pytest.raises(InputError, match=words):
        read_gaussian_ply(tmp_path / "a.ply")


def poisoned(sound: bytes, column: int, value: float) -> bytes:
    start = sound.index(b"end_header\n") + len(b"end_header\n") + 4 * column
    return sound[:start] + np.float32(value).tobytes() + sound[start + 4 :]


def test_numbers_no_gaussian_has(sound: bytes, tmp_path: Path) -> None:
    header_names = list(_header(tmp_path, sound).elements["vertex"].properties)
    cases = {("x", 1e9): "positions", ("x", np.nan): "NaN", ("scale_1", 50.0): "scales", ("f_rest_3", np.inf): "NaN"}
    cases |= {("f_dc_0", 1e6): "colors", ("opacity", np.nan): "NaN"}
    for (name, value), words in cases.items():
        (tmp_path / "a.ply").write_bytes(poisoned(sound, header_names.index(name), value))
        with pytest.raises(InputError, match=words):
            read_gaussian_ply(tmp_path / "a.ply")
    (tmp_path / "a.ply").write_bytes(poisoned(sound, header_names.index("opacity"), -np.inf))
    assert is_sound(read_gaussian_ply(tmp_path / "a.ply")), "logits of the bytes 0 and 255 are infinite"


def _header(folder: Path, content: bytes) -> Header:
    (folder / "h.ply").write_bytes(content)
    return read_header(folder / "h.ply")


def test_folders_and_nothing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_header(tmp_path / "none.ply")
    with pytest.raises(InputError, match="a folder"):
        read_header(tmp_path)
