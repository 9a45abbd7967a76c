"""Splat files. References: plyfile, decoders written from the public descriptions, the renderer, splat-transform."""

from __future__ import annotations

import dataclasses
import gzip
import itertools
import struct
from pathlib import Path

import numpy as np
import plyfile
import pytest
import torch

from ggavatar.core import Gaussians
from ggavatar.errors import InputError
from ggavatar.formats.gaussian_files import read_gaussians
from ggavatar.formats.source_options import GaussianReadingOptions
from ggavatar.formats.splats.file_kinds import SPLAT_RECORD, file_kind, looks_like_splat
from ggavatar.formats.splats.gaussian_ply import full_degree, read_gaussian_ply, write_gaussian_ply
from ggavatar.formats.splats.splat import read_splat as read_splat_file
from ggavatar.formats.splats.splat import write_splat
from ggavatar.formats.splats.spz import write_spz
from ggavatar.formats.splats.stored_gaussians import SH_SIGNS_180_ABOUT_X, activate, rotate_180_about_x, to_stored
from ggavatar.gaussians.initial_colors import SH_C0
from ggavatar.geometry.transforms import quaternion_to_matrix
from ggavatar.render.harmonics import sh_basis
from tests.support.gaussian_cloud import cloud, psnr, render
from tests.support.npm_programs import splat_transform, transform

HALF_TURN = torch.diag(torch.tensor([1.0, -1.0, -1.0]))
WRITERS = {"ply": write_gaussian_ply, "splat": write_splat, "spz": write_spz}


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("viewer_axes", [True, False])
def test_ply_round_trip_draws_the_same(tmp_path: Path, degree: int, viewer_axes: bool) -> None:
    gaussians = cloud(degree=degree)
    write_gaussian_ply(tmp_path / "a.ply", to_stored(gaussians), viewer_axes)
    found = activate(read_gaussian_ply(tmp_path / "a.ply"))
    assert found.colors.shape == gaussians.colors.shape
    image = render(gaussians)
    assert float(image.std()) > 0.05, "nothing to see"
    assert float((render(found) - image).abs().max()) < 1e-5
    assert not list(tmp_path.glob("*.part")) and not list(tmp_path.glob(".*"))


def test_ply_is_what_other_programs_expect(tmp_path: Path) -> None:
    gaussians = cloud()
    write_gaussian_ply(tmp_path / "a.ply", to_stored(gaussians))
    vertex = plyfile.PlyData.read(tmp_path / "a.ply")["vertex"]
    names = [item.name for item in vertex.properties]
    expected = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{k}" for k in range(45))]
    assert names == [*expected, "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    means = np.stack([vertex[axis] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(means, gaussians.means @ HALF_TURN, atol=1e-7)
    np.testing.assert_allclose(1 / (1 + np.exp(-vertex["opacity"])), gaussians.opacities, atol=1e-6)
    np.testing.assert_allclose(np.exp(vertex["scale_1"]), gaussians.scales[:, 1], rtol=1e-5)
    red, green = (gaussians.colors[:, 1:, channel].numpy() * SH_SIGNS_180_ABOUT_X for channel in (0, 1))
    np.testing.assert_allclose(np.stack([vertex[f"f_rest_{k}"] for k in range(15)], axis=1), red)
    np.testing.assert_allclose(np.stack([vertex[f"f_rest_{k}"] for k in range(15, 30)], axis=1), green)
    turned_quats = torch.from_numpy(np.stack([vertex[f"rot_{k}"] for k in range(4)], axis=1))
    want = HALF_TURN @ quaternion_to_matrix(gaussians.quats)
    torch.testing.assert_close(quaternion_to_matrix(turned_quats), want, atol=1e-5, rtol=0)


def test_names_decide_not_positions(tmp_path: Path) -> None:
    """A file of another writer: another order, doubles, an additional property, no normals."""
    rows = to_stored(cloud(degree=1))
    write_gaussian_ply(tmp_path / "a.ply", rows, viewer_axes=False)
    vertex = plyfile.PlyData.read(tmp_path / "a.ply")["vertex"].data
    names = [name for name in reversed(vertex.dtype.names) if not name.startswith("n")]
    shuffled = np.zeros(len(vertex), [("confidence", "u1"), *((name, "<f8") for name in names)])
    for name in names:
        shuffled[name] = vertex[name]
    element = plyfile.PlyElement.describe(shuffled, "vertex")
    plyfile.PlyData([element], byte_order="<", comments=["by another"]).write(tmp_path / "b.ply")
    found = read_gaussian_ply(tmp_path / "b.ply")
    for field in ("means", "sh_dc", "sh_rest", "opacity_logits", "log_scales", "quats"):
        np.testing.assert_array_equal(getattr(found, field), getattr(rows, field))


def test_axes_can_be_said_where_a_file_does_not(tmp_path: Path) -> None:
    rows = to_stored(cloud())
    write_gaussian_ply(tmp_path / "world.ply", rotate_180_about_x(rows), viewer_axes=False)
    assert psnr(render(activate(read_gaussian_ply(tmp_path / "world.ply", "viewer"))), render(cloud())) > 80
    assert psnr(render(activate(read_gaussian_ply(tmp_path / "world.ply"))), render(cloud())) < 30


def test_harmonics_change_signs_under_half_a_turn() -> None:
    directions = torch.nn.functional.normalize(torch.randn(50, 3, dtype=torch.float64), dim=1)
    signs = torch.from_numpy(np.concatenate(([1.0], SH_SIGNS_180_ABOUT_X)))
    torch.testing.assert_close(sh_basis(directions @ HALF_TURN.double(), 3), sh_basis(directions, 3) * signs)


def test_only_the_degree_in_use_is_stored() -> None:
    rows = to_stored(dataclasses.replace(cloud(), sh_degree=1))
    assert rows.degree == 1 and rows.sh_rest.shape[1] == 3
    assert full_degree(rows).sh_rest.shape[1] == 15 and not full_degree(rows).sh_rest[:, 3:].any()
    plain = to_stored(dataclasses.replace(cloud(), colors=torch.full((60, 3), 0.25)))
    np.testing.assert_allclose(0.5 + SH_C0 * plain.sh_dc, 0.25, atol=1e-6)


def test_opacities_and_scales_at_their_ends_stay_finite() -> None:
    edge = Gaussians(torch.zeros(2, 3), torch.eye(2, 4), torch.zeros(2, 3), torch.tensor([0.0, 1.0]), torch.ones(2, 3))
    rows = to_stored(edge)
    assert np.isfinite(rows.opacity_logits).all() and np.isfinite(rows.log_scales).all()
    np.testing.assert_allclose(activate(rows).opacities, [0, 1], atol=2e-6)


def read_splat(path: Path) -> Gaussians:
    """An independent decoder: 32 bytes per record."""
    raw = np.frombuffer(path.read_bytes(), np.uint8).reshape(-1, 32)
    floats = raw[:, :24].copy().view("<f4")
    return Gaussians(
        means=torch.from_numpy(floats[:, :3].copy()) @ HALF_TURN,
        quats=torch.from_numpy((raw[:, 28:].astype(np.float32) - 128) / 128),
        scales=torch.from_numpy(floats[:, 3:].copy()),
        opacities=torch.from_numpy(raw[:, 27].astype(np.float32) / 255),
        colors=torch.from_numpy(raw[:, 24:27].astype(np.float32) / 255),
    )


def test_splat_records(tmp_path: Path) -> None:
    gaussians = cloud(degree=0)
    write_splat(tmp_path / "a.splat", to_stored(gaussians))
    assert (tmp_path / "a.splat").stat().st_size == 32 * 60
    found = read_splat(tmp_path / "a.splat")
    importance = found.scales.prod(1) * found.opacities
    assert bool((importance[:-1] >= importance[1:] * 0.98).all()), "most important first"
    order = torch.argsort(-(gaussians.scales.prod(1) * gaussians.opacities), stable=True)
    torch.testing.assert_close(found.scales, gaussians.scales[order], rtol=1e-5, atol=0)
    torch.testing.assert_close(found.means, gaussians.means[order], rtol=0, atol=1e-7)
    want = (0.5 + SH_C0 * gaussians.colors[order, 0]).clamp(0, 1)
    assert float((found.colors - want).abs().max()) <= 0.5 / 255 + 1e-6
    half_turn = torch.tensor([0.0, 1.0, 0.0, 0.0])
    undone = dataclasses.replace(found, quats=turned_back(found.quats, half_turn))
    assert psnr(render(undone), render(gaussians)) > 40


def turned_back(quats: torch.Tensor, half_turn: torch.Tensor) -> torch.Tensor:
    from ggavatar.geometry.transforms import quaternion_multiply

    return quaternion_multiply(half_turn.expand_as(quats), quats)


def read_spz(path: Path) -> Gaussians:
    """An independent decoder of version 3, written from the public description of the format."""
    data = gzip.decompress(path.read_bytes())
    magic, version, count, degree, bits, flags, reserved = struct.unpack("<IIIBBBB", data[:16])
    assert (magic, version, flags, reserved) == (0x5053474E, 3, 0, 0)
    harmonics = (degree + 1) ** 2 - 1
    sizes = [9, 1, 3, 3, 4, 3 * harmonics]
    bounds = np.cumsum([16, *(size * count for size in sizes)])
    assert bounds[-1] == len(data)
    blocks = [np.frombuffer(data[a:b], np.uint8).reshape(count, -1) for a, b in itertools.pairwise(bounds)]
    low, middle, high = (blocks[0].reshape(count, 3, 3)[..., k].astype(np.int64) for k in range(3))
    steps = low + (middle << 8) + (high << 16)
    means = np.where(steps >= 1 << 23, steps - (1 << 24), steps) / (1 << bits)
    quats = np.zeros((count, 4))
    for row, word in enumerate(blocks[4].copy().view("<u4")[:, 0].tolist()):
        largest, total = word >> 30, 0.0
        for index in (3, 2, 1, 0):
            if index != largest:
                value = (word & 511) / 511 * np.sqrt(0.5) * (-1 if word & 512 else 1)
                quats[row, index], total, word = value, total + value * value, word >> 10
        quats[row, largest] = np.sqrt(max(0.0, 1 - total))
    colors = np.zeros((count, harmonics + 1, 3))
    colors[:, 0] = (blocks[2] / 255 - 0.5) / 0.15
    colors[:, 1:] = ((blocks[5].astype(float) - 128) / 128).reshape(count, harmonics, 3)
    arrays = means, quats[:, [3, 0, 1, 2]], np.exp(blocks[3] / 16.0 - 10), blocks[1][:, 0] / 255, colors
    return Gaussians(*(torch.from_numpy(np.ascontiguousarray(array, np.float32)) for array in arrays))


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_spz_version_3(tmp_path: Path, degree: int) -> None:
    gaussians = cloud(degree=degree)
    write_spz(tmp_path / "a.spz", to_stored(gaussians))
    found = read_spz(tmp_path / "a.spz")
    assert float((found.means - gaussians.means).abs().max()) <= 0.5 / 4096 + 1e-7
    assert float((found.scales.log() - gaussians.scales.log()).abs().max()) <= 0.5 / 16 + 1e-5
    assert float((found.opacities - gaussians.opacities).abs().max()) <= 0.5 / 255 + 1e-6
    assert float((found.colors[:, :1] - gaussians.colors[:, :1]).abs().max()) <= 0.5 / 255 / 0.15 + 1e-5
    bound = 4.5 / 128 if degree == 1 else 8.5 / 128
    if degree:
        assert float((found.colors[:, 1:] - gaussians.colors[:, 1:]).abs().max()) <= bound
    turns = quaternion_to_matrix(found.quats) - quaternion_to_matrix(gaussians.quats)
    assert float(turns.abs().max()) < 6e-3
    assert psnr(render(found), render(gaussians)) > 35
    write_spz(tmp_path / "b.spz", to_stored(gaussians))
    assert (tmp_path / "a.spz").read_bytes() == (tmp_path / "b.spz").read_bytes()


@pytest.fixture(scope="module", name="command")
def splat_transform_command() -> list[str]:
    return splat_transform()


@pytest.mark.parametrize(
    ("kind", "degree", "least"), [("ply", 3, 80), ("splat", 0, 38), ("spz", 3, 35), ("spz", 0, 35)]
)
def test_an_independent_program_reads_what_we_write(
    tmp_path: Path, command: list[str], kind: str, degree: int, least: float
) -> None:
    gaussians = cloud(degree=degree)
    WRITERS[kind](tmp_path / f"ours.{kind}", to_stored(gaussians))
    transform(command, tmp_path / f"ours.{kind}", tmp_path / "theirs.ply")
    # splat-transform 2 turned .spz into the axes of PLY, version 3 copies its numbers.
    images = [
        render(activate(read_gaussian_ply(tmp_path / "theirs.ply", axes)))
        for axes in (("viewer", "world") if kind == "spz" else ("viewer",))
    ]
    assert max(psnr(image, render(gaussians)) for image in images) > least
    found = read_gaussian_ply(tmp_path / "theirs.ply")
    assert len(found) == 60 and found.degree == degree


@pytest.mark.parametrize("degree", [0, 3])
@pytest.mark.parametrize("name", ["a.compressed.ply", "a.splat", "a.spz", "a3.spz", "a.sog", "meta.json"])
def test_we_read_what_an_independent_program_writes_as_it_does(
    tmp_path: Path, command: list[str], degree: int, name: str
) -> None:
    """Reference: the same file read by splat-transform. Logits of the bytes 0 and 255 are where it clips them."""
    write_gaussian_ply(tmp_path / "from.ply", to_stored(cloud(600, degree)), viewer_axes=False)
    old = ("--spz-version", 3) if name == "a3.spz" else ()
    transform(command, *old, tmp_path / "from.ply", tmp_path / name)
    assert file_kind(tmp_path / name) == {"ply": "ply", "splat": "splat", "spz": "spz"}.get(name.split(".")[-1], "sog")
    transform(command, tmp_path / name, tmp_path / "theirs.ply")
    ours = read_gaussians(tmp_path / name, GaussianReadingOptions(axes="world"))
    theirs = read_gaussian_ply(tmp_path / "theirs.ply")
    assert len(ours) == len(theirs) == 600 and ours.degree == theirs.degree == (0 if name == "a.splat" else degree)
    for field in ("means", "sh_dc", "sh_rest", "log_scales"):
        np.testing.assert_allclose(getattr(ours, field), getattr(theirs, field), atol=1e-5, err_msg=field)
    opacities = [1 / (1 + np.exp(-rows.opacity_logits)) for rows in (ours, theirs)]
    np.testing.assert_allclose(opacities[0], opacities[1], atol=1e-5)
    unit = [rows.quats / np.linalg.norm(rows.quats, axis=1, keepdims=True) for rows in (ours, theirs)]
    np.testing.assert_allclose(np.abs((unit[0] * unit[1]).sum(1)), 1, atol=1e-4)
    assert not [note for note in ours.notes if "dropped" in note]


def test_reading_a_splat_of_ours(tmp_path: Path) -> None:
    """Reference: the decoder above."""
    write_splat(tmp_path / "a.splat", to_stored(cloud(degree=0)))
    assert looks_like_splat(tmp_path / "a.splat")
    rows, want = read_splat_file(tmp_path / "a.splat"), read_splat(tmp_path / "a.splat")
    found = activate(rows)
    torch.testing.assert_close(found.means, want.means)
    torch.testing.assert_close(found.scales, want.scales)
    torch.testing.assert_close(found.opacities, want.opacities, atol=1e-6, rtol=0)
    np.testing.assert_allclose(0.5 + SH_C0 * rows.sh_dc, want.colors, atol=1e-6)
    assert psnr(render(found), render(cloud(degree=0))) > 40
    world = read_splat_file(tmp_path / "a.splat", "world")
    np.testing.assert_allclose(world.quats, want.quats, atol=1e-6)
    assert "--axes world" in rows.notes[-1] and world.notes == ()


def test_splat_rows_that_are_none(tmp_path: Path) -> None:
    records = np.zeros(200, SPLAT_RECORD)
    records["mean"], records["scale"], records["quat"] = 0.1, 0.01, (255, 128, 128, 128)
    records["color"] = (255, 0, 128, 255)
    records["mean"][3, 1] = np.nan
    records["scale"][0, 0] = 0
    (tmp_path / "a.splat").write_bytes(records.tobytes())
    rows = read_splat_file(tmp_path / "a.splat")
    assert len(rows) == 199 and rows.notes[0] == "dropped 1 of 200 Gaussians: 1 with NaN or infinity"
    np.testing.assert_allclose(np.exp(rows.log_scales[0]), [1e-9, 0.01, 0.01], rtol=1e-4)
    for content, words in ((records.tobytes()[:-1], "truncated"), (b"", "found 0 bytes")):
        (tmp_path / "a.splat").write_bytes(content)
        with pytest.raises(InputError, match=words):
            read_splat_file(tmp_path / "a.splat")
