"""Compressed PLY, one Gaussian at a time. Also covers `ggavatar/formats/splats/quaternion_packing.py`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ggavatar.errors import InputError
from ggavatar.formats.splats.gaussian_ply import read_gaussian_ply
from ggavatar.formats.splats.quaternion_packing import quats_from_smallest
from ggavatar.formats.splats.stored_gaussians import rotate_180_about_x
from tests.support.splat_files import compressed_ply, ply

SH_C0 = 0.28209479177387814


def lerp(chunk: dict[str, np.ndarray], row: int, name: str, unit: float) -> float:
    low, high = float(chunk[f"min_{name}"][row // 256]), float(chunk[f"max_{name}"][row // 256])
    return low * (1 - unit) + high * unit


@pytest.mark.parametrize("with_colors", [True, False])
def test_values(tmp_path: Path, with_colors: bool) -> None:
    elements, content = compressed_ply(with_colors=with_colors)
    (tmp_path / "a.ply").write_bytes(content)
    rows = read_gaussian_ply(tmp_path / "a.ply", "world")
    chunk, vertex, sh = elements["chunk"], elements["vertex"], elements["sh"]
    opaque = [row for row in range(300) if 0 < int(vertex["packed_color"][row]) & 255 < 255]
    for row in [0, 255, 256, 299, *opaque[:20]]:
        position, scale = int(vertex["packed_position"][row]), int(vertex["packed_scale"][row])
        for axis, shift, bits in (("x", 21, 11), ("y", 11, 10), ("z", 0, 11)):
            limit, index = (1 << bits) - 1, "xyz".index(axis)
            mean = lerp(chunk, row, axis, (position >> shift & limit) / limit)
            assert rows.means[row, index] == pytest.approx(mean, abs=1e-6)
            log_scale = lerp(chunk, row, f"scale_{axis}", (scale >> shift & limit) / limit)
            assert rows.log_scales[row, index] == pytest.approx(log_scale, abs=1e-5)
        color = int(vertex["packed_color"][row])
        for index, shift in enumerate((24, 16, 8)):
            unit = (color >> shift & 255) / 255
            rgb = lerp(chunk, row, "rgb"[index], unit) if with_colors else unit
            assert 0.5 + SH_C0 * rows.sh_dc[row, index] == pytest.approx(rgb, abs=1e-6)
        if 0 < color & 255 < 255:
            assert 1 / (1 + np.exp(-rows.opacity_logits[row])) == pytest.approx((color & 255) / 255, abs=1e-6)
        for channel in range(3):
            for index in range(3):
                byte = int(sh[f"f_rest_{3 * channel + index}"][row])
                unit = 0 if byte == 0 else 1 if byte == 255 else (byte + 0.5) / 256
                assert rows.sh_rest[row, index, channel] == pytest.approx((unit - 0.5) * 8, abs=1e-6)
        word = int(vertex["packed_rotation"][row])
        others = [((word >> shift & 1023) / 1023 - 0.5) * np.sqrt(2) for shift in (20, 10, 0)]
        length = max(1.0, float(np.linalg.norm(others)))
        quat = [value / length for value in others]
        quat.insert(word >> 30, np.sqrt(max(0.0, 1 - sum(value * value for value in quat))))
        np.testing.assert_allclose(rows.quats[row], quat, atol=1e-6)


def test_axes_are_those_of_viewers(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(compressed_ply()[1])
    found, raw = (read_gaussian_ply(tmp_path / "a.ply", axes) for axes in ("auto", "world"))
    np.testing.assert_array_equal(found.means, rotate_180_about_x(raw).means)
    assert "--axes world" in found.notes[-1] and not any("--axes" in note for note in raw.notes)


def test_flags_of_plain_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(compressed_ply()[1])
    with pytest.raises(InputError, match="omit --scales"):
        read_gaussian_ply(tmp_path / "a.ply", scales="linear")


def test_smallest_three_of_any_rotation() -> None:
    """Dropping the largest component, made positive, and putting it back is the identity."""
    quats = np.random.default_rng(0).normal(size=(1000, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    largest = np.abs(quats).argmax(axis=1)
    quats *= np.sign(quats[np.arange(1000), largest])[:, None]
    others = np.stack([np.delete(quat, index) for quat, index in zip(quats, largest, strict=True)])
    np.testing.assert_allclose(quats_from_smallest(others, largest), quats, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda e: e | {"chunk": {name: values[:1] for name, values in e["chunk"].items()}}, "expected 2 chunks"),
        (lambda e: e | {"sh": {name: values[:9] for name, values in e["sh"].items()}}, "9, 24 or 45 harmonics"),
        (lambda e: {"vertex": e["vertex"]}, "element 'chunk'"),
        (lambda e: e | {"chunk": {"min_x": e["chunk"]["min_x"]}}, "found no"),
        (lambda e: e | {"vertex": e["vertex"] | {"packed_color": np.zeros(300, "f4")}}, "packed_color as uint"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, change: object, words: str) -> None:
    (tmp_path / "a.ply").write_bytes(ply(change(compressed_ply()[0])))
    with pytest.raises(InputError, match=words):
        read_gaussian_ply(tmp_path / "a.ply")
