"""Versions 1 to 4 of .spz, packed from integers by the description; expected values in closed form."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest

from ggavatar.errors import InputError
from ggavatar.formats.splats.spz import write_spz
from ggavatar.formats.splats.spz_reader import UNSTATED_AXES_NOTE, read_spz
from ggavatar.formats.splats.stored_gaussians import StoredGaussians, rotate_180_about_x, to_stored
from tests.support.gaussian_cloud import cloud
from tests.support.splat_files import SPZ_CODES, spz

HALF = np.sqrt(0.5) / 511


def read(folder: Path, content: bytes, axes: str = "auto") -> StoredGaussians:
    (folder / "a.spz").write_bytes(content)
    return read_spz(folder / "a.spz", axes)


def codes(version: int) -> dict[str, list]:
    """The codes of a version, with positions and rotations as it has them."""
    older = {"rotations": [[128, 128, 128], [255, 127, 127], [0, 127, 191]]} if version < 3 else {}
    return (
        SPZ_CODES | older | ({"positions": [[1, -0.5, 0.25], [0, 100, -100], [0.1, 0.2, -0.3]]} if version == 1 else {})
    )


@pytest.mark.parametrize("version", [1, 2, 3, 4])
@pytest.mark.parametrize("degree", [0, 1])
def test_values(tmp_path: Path, version: int, degree: int) -> None:
    given = codes(version) if degree else {**codes(version), "harmonics": []}
    rows = read(tmp_path, spz(version, given, degree))
    assert rows.notes == (UNSTATED_AXES_NOTE,) and rows.degree == degree
    want = np.array(given["positions"]) if version == 1 else np.array(given["positions"]) / 4096
    np.testing.assert_array_equal(rows.means, want.astype(np.float16 if version == 1 else np.float32))
    np.testing.assert_allclose(rows.log_scales, np.array(given["scales"]) / 16 - 10)
    np.testing.assert_allclose(rows.sh_dc, (np.array(given["colors"]) / 255 - 0.5) / 0.15, atol=1e-6)
    np.testing.assert_allclose(1 / (1 + np.exp(-rows.opacity_logits)), [0, 1, 0.2], atol=1e-6)
    if degree:
        steps = np.array(given["harmonics"]).reshape(3, 3, 3)
        np.testing.assert_array_equal(rows.sh_rest, ((steps - 128) / 128).astype(np.float32))
    if version < 3:
        xyz = np.array(given["rotations"]) / 127.5 - 1
        wxyz = np.c_[np.sqrt((1 - (xyz**2).sum(1)).clip(0)), xyz]
        wxyz /= np.linalg.norm(wxyz, axis=1, keepdims=True)
    else:
        second = [511 * HALF, 0, -100 * HALF]
        third = [200 * HALF, -200 * HALF, 300 * HALF]
        wxyz = np.array(
            [
                [1, 0, 0, 0],
                [np.sqrt(1 - sum(v * v for v in second)), *second],
                [third[2], third[0], np.sqrt(1 - sum(v * v for v in third)), third[1]],
            ]
        )
    np.testing.assert_allclose(rows.quats, wxyz, atol=1e-6)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_our_own_files(tmp_path: Path, degree: int) -> None:
    """Reference: the steps that the writer rounds to."""
    rows = to_stored(cloud(degree=degree))
    write_spz(tmp_path / "a.spz", rows)
    found = read_spz(tmp_path / "a.spz")
    np.testing.assert_allclose(found.means, rows.means, atol=0.5 / 4096 + 1e-7)
    np.testing.assert_allclose(found.log_scales, rows.log_scales, atol=0.5 / 16 + 1e-5)
    np.testing.assert_allclose(np.abs((found.quats * rows.quats).sum(1)), 1, atol=1e-5)
    write_spz(tmp_path / "b.spz", found)
    again = read_spz(tmp_path / "b.spz")
    for name in ("means", "sh_dc", "sh_rest", "log_scales"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name), "what is rounded stays")


def test_harmonics_of_degree_4_are_cut(tmp_path: Path) -> None:
    values = np.random.default_rng(0).integers(0, 256, (3, 72))
    rows = read(tmp_path, spz(4, codes(4) | {"harmonics": values}, 4))
    assert rows.degree == 3 and "degree 4" in rows.notes[0]
    np.testing.assert_array_equal(rows.sh_rest.reshape(3, 45), ((values[:, :45] - 128) / 128).astype(np.float32))


@pytest.mark.parametrize("version", [3, 4])
def test_axes(tmp_path: Path, version: int) -> None:
    """Adobe's extension: 4 is right, up, back, as ours; 6 is right, down, front; 9 has another order of axes."""
    plain = read(tmp_path, spz(version, codes(version), 1))
    same = read(tmp_path, spz(version, codes(version), 1, axes=4))
    np.testing.assert_array_equal(same.means, plain.means)
    assert same.notes == () and "--axes viewer" in plain.notes[0]
    unknown = read(tmp_path, spz(version, codes(version), 1, axes=0))
    assert unknown.notes == plain.notes
    turned, asked = read(tmp_path, spz(version, codes(version), 1, axes=6)), rotate_180_about_x(plain)
    np.testing.assert_array_equal(turned.means, asked.means)
    np.testing.assert_array_equal(turned.sh_rest, asked.sh_rest)
    from ggavatar.geometry.transforms import quaternion_to_matrix

    half_turn = np.diag([1.0, -1.0, -1.0])
    import torch

    first, second = (quaternion_to_matrix(torch.from_numpy(rows.quats)).numpy() for rows in (plain, turned))
    spread = np.diag([1.0, 4.0, 9.0])
    np.testing.assert_allclose(
        second @ spread @ second.transpose(0, 2, 1),
        half_turn @ first @ spread @ first.transpose(0, 2, 1) @ half_turn,
        atol=1e-5,
    )
    np.testing.assert_array_equal(read(tmp_path, spz(version, codes(version), 1), "viewer").means, asked.means)
    with pytest.raises(InputError, match="found 9"):
        read(tmp_path, spz(version, codes(version), 1, axes=9))


def huge(version: int) -> bytes:
    """A header that claims 50 million Gaussians, and little behind it."""
    content = spz(version, codes(version), 1)
    head = content if version == 4 else gzip.decompress(content)
    head = head[:8] + struct.pack("<I", 50_000_000) + head[12:]
    return head if version == 4 else gzip.compress(head)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"NGSP", "NGSP"),
        (gzip.compress(b"something else altogether"), "NGSP"),
        (gzip.compress(struct.pack("<4sIIBBBB", b"NGSP", 5, 1, 0, 12, 0, 0)), "version 1 to 4"),
        (gzip.compress(struct.pack("<4sIIBBBB", b"NGSP", 3, 0, 0, 12, 0, 0)), "1 to 50000000"),
        (gzip.compress(struct.pack("<4sIIBBBB", b"NGSP", 4, 1, 0, 12, 0, 0)), "in a gzip stream"),
        (gzip.compress(struct.pack("<4sIIBBBB", b"NGSP", 3, 9, 0, 12, 0, 0)), "expected 180 bytes"),
        (huge(3), "too small"),
        (huge(4), "too small"),
        (spz(3, codes(3), 1)[:-30], "bytes of Gaussians|damaged"),
        (spz(3, codes(3), 1)[:-8] + b"\0\0\0\0\0\0\0\0", "damaged"),
        (spz(4, codes(4), 1)[:-9], "copy the file again"),
        (spz(4, codes(4), 1)[:60], "no table"),
    ],
    ids=range(12),  # the contents hold the time of day, and processes must collect the same names
)
def test_what_is_wrong_is_said(tmp_path: Path, content: bytes, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read(tmp_path, content)
