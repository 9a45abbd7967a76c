"""GaussianAvatars' layout. References: the published binding formula, the public description of the teeth."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from ggavatar.core import Gaussians
from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.formats.flame_parameters import FlameParameters, read_flame_parameters, write_flame_parameters
from ggavatar.formats.flame_teeth import FLAME_FACES, FLAME_VERTICES, LOWER_LIP, UPPER_LIP, teeth_faces, with_teeth
from ggavatar.formats.imported_avatar import BoundAvatar, open_gaussians
from ggavatar.formats.imported_run import open_imported_run
from ggavatar.formats.source_options import GaussianFileOptions
from ggavatar.formats.splats.gaussian_ply import full_degree, read_gaussian_ply, write_gaussian_ply
from ggavatar.formats.splats.stored_gaussians import activate, to_stored
from ggavatar.formats.unbinding import binding_of, nearest_faces, unbind
from ggavatar.gaussians.binding import bind_in_torch
from ggavatar.geometry.transforms import quaternion_to_matrix
from ggavatar.geometry.triangles import triangle_frames
from ggavatar.head.files import load_head, save_head
from ggavatar.head.model import HeadModel
from ggavatar.optim.parameters import Column, Rows
from tests.support.gaussian_cloud import cloud, psnr, render

TIMESTEPS = 24


def on_faces(head: HeadModel, count: int = 60) -> torch.Tensor:
    return torch.arange(count) * 7 % len(head.faces)


def test_unbinding_is_the_inverse_of_binding(toy_head: HeadModel) -> None:
    frames = triangle_frames(toy_head.template.double(), toy_head.faces)
    gaussians = cloud()
    double = dataclasses.replace(
        gaussians, means=gaussians.means.double(), quats=gaussians.quats.double(), scales=gaussians.scales.double()
    )
    rows = unbind(double, on_faces(toy_head), frames)
    local = activate(rows)
    placed = bind_in_torch(
        local.means.double(), local.quats.double(), local.scales.double().log(), on_faces(toy_head), frames
    )
    torch.testing.assert_close(placed.means, double.means, atol=1e-6, rtol=0)
    torch.testing.assert_close(placed.scales, double.scales, atol=0, rtol=1e-5)
    torch.testing.assert_close(
        quaternion_to_matrix(placed.quats), quaternion_to_matrix(double.quats), atol=1e-5, rtol=0
    )


def bound_file(folder: Path, capture: Capture) -> tuple[Path, Gaussians]:
    """Gaussians around the toy head as a bound file, and in world space."""
    head = load_head(capture.head_path)
    drive = head.neutral_drive()
    gaussians = cloud()
    rows = unbind(gaussians, on_faces(head), triangle_frames(head.vertices(drive), head.faces))
    write_gaussian_ply(folder / "point_cloud.ply", full_degree(rows))
    return folder / "point_cloud.ply", gaussians


def test_bound_file_gives_back_the_world(toy_capture: Capture, tmp_path: Path) -> None:
    path, gaussians = bound_file(tmp_path, toy_capture)
    head = load_head(toy_capture.head_path)
    avatar = open_gaussians(path, GaussianFileOptions(), toy_capture)
    assert isinstance(avatar, BoundAvatar)
    found = avatar.gaussians(head.neutral_drive())
    torch.testing.assert_close(found.means, gaussians.means, atol=1e-6, rtol=0)
    torch.testing.assert_close(found.scales, gaussians.scales, atol=0, rtol=1e-4)
    assert psnr(render(found), render(gaussians)) > 80
    moved = avatar.gaussians(dataclasses.replace(head.neutral_drive(), translation=torch.tensor([0.0, 0.05, 0.0])))
    torch.testing.assert_close(moved.means, gaussians.means + torch.tensor([0.0, 0.05, 0.0]), atol=1e-6, rtol=0)


def test_run_of_a_file_follows_the_capture(toy_capture: Capture, tmp_path: Path) -> None:
    path, _ = bound_file(tmp_path, toy_capture)
    run = open_imported_run(path, GaussianFileOptions(capture=toy_capture.folder))
    assert run.folder == tmp_path / "point_cloud" and not run.folder.exists()
    assert run.split == toy_capture.splits["every-20th"] and run.step == 0
    first, last = (run.avatar.gaussians(run.reader.drive(toy_capture.frames[row])).means for row in (0, -1))
    assert float((first - last).abs().max()) > 1e-3, "the mouth moves"
    with pytest.raises(InputError, match="--capture DIR"):
        open_imported_run(path, GaussianFileOptions())


def parameters(capture: Capture, shift: float = 0.0) -> FlameParameters:
    tracking = capture.tracking
    return FlameParameters(
        shape=np.zeros(4, np.float32),
        expression=tracking.expression.astype(np.float32),
        joint_rotations=tracking.joint_rotations.astype(np.float32),
        translation=(tracking.translation + shift).astype(np.float32),
    )


def test_parameters_beside_the_file_pose_its_frames(toy_capture: Capture, tmp_path: Path) -> None:
    path, _ = bound_file(tmp_path, toy_capture)
    write_flame_parameters(tmp_path / "flame_param.npz", parameters(toy_capture, 0.5), 50)
    own = open_imported_run(path, GaussianFileOptions(capture=toy_capture.folder))
    theirs = open_imported_run(path, GaussianFileOptions(capture=toy_capture.folder, head_model=toy_capture.head_path))
    for number in toy_capture.frames[::6]:
        drive = own.reader.drive(number)
        shift = theirs.avatar.gaussians(drive).means - own.avatar.gaussians(drive).means
        torch.testing.assert_close(shift, torch.full_like(shift, 0.5), atol=1e-5, rtol=0)
        unseen = dataclasses.replace(drive, frame=None)
        torch.testing.assert_close(theirs.avatar.gaussians(unseen).means, own.avatar.gaussians(drive).means)
    short = parameters(toy_capture)
    short = dataclasses.replace(
        short, **{name: getattr(short, name)[:5] for name in ("expression", "joint_rotations", "translation")}
    )
    write_flame_parameters(tmp_path / "flame_param.npz", short, 50)
    with pytest.raises(InputError, match="5 timesteps"):
        open_imported_run(path, GaussianFileOptions(capture=toy_capture.folder, head_model=toy_capture.head_path))


def test_what_a_bound_file_needs_is_said(toy_capture: Capture, tmp_path: Path) -> None:
    path, _ = bound_file(tmp_path, toy_capture)
    with pytest.raises(InputError, match="--head-model FILE"):
        open_gaussians(path, GaussianFileOptions())
    with pytest.raises(InputError, match="found no such file"):
        open_gaussians(path, GaussianFileOptions(head_model=tmp_path / "no.pkl"))
    rows = read_gaussian_ply(path)
    assert rows.faces is not None
    write_gaussian_ply(tmp_path / "far.ply", dataclasses.replace(rows, faces=rows.faces + 5000))
    with pytest.raises(InputError, match="expected a head of at least"):
        open_gaussians(tmp_path / "far.ply", GaussianFileOptions(), toy_capture)
    head = load_head(toy_capture.head_path)
    save_head(dataclasses.replace(head, version="egg-2"), tmp_path / "other.npz")
    with pytest.raises(InputError, match="differ in meaning"):
        open_gaussians(path, GaussianFileOptions(head_model=tmp_path / "other.npz"), toy_capture)
    write_gaussian_ply(tmp_path / "plain.ply", to_stored(cloud()))
    with pytest.raises(InputError, match="found no binding_0"):
        open_gaussians(tmp_path / "plain.ply", GaussianFileOptions(head_model=tmp_path / "other.npz"))


@pytest.mark.parametrize("value", [-1.0, 0.5, 2.0**25])
def test_bindings_are_whole_numbers(toy_capture: Capture, tmp_path: Path, value: float) -> None:
    path, _ = bound_file(tmp_path, toy_capture)
    content = bytearray(path.read_bytes())
    content[-4:] = np.float32(value).tobytes()
    path.write_bytes(bytes(content))
    with pytest.raises(InputError, match="indices of triangles"):
        read_gaussian_ply(path)


def test_flame_parameters_round_trip_and_their_faults(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    values = FlameParameters(
        shape=random.normal(size=300).astype(np.float32),
        expression=random.normal(size=(TIMESTEPS, 50)).astype(np.float32),
        joint_rotations=random.normal(size=(TIMESTEPS, 5, 3)).astype(np.float32),
        translation=random.normal(size=(TIMESTEPS, 3)).astype(np.float32),
        offset=random.normal(size=(FLAME_VERTICES, 3)).astype(np.float32),
    )
    path = tmp_path / "flame_param.npz"
    write_flame_parameters(path, values, FLAME_VERTICES)
    with np.load(path) as arrays:
        shapes = {name: arrays[name].shape for name in arrays.files}
        plain = dict(arrays)
    assert shapes["dynamic_offset"] == (TIMESTEPS, 5143, 3) and shapes["static_offset"] == (1, 5143, 3)
    assert shapes["expr"] == (TIMESTEPS, 100) and shapes["eyes_pose"] == (TIMESTEPS, 6) and shapes["shape"] == (300,)
    assert path.stat().st_size < 400_000, "zeros take no room"
    found = read_flame_parameters(path)
    assert found.offset is not None and values.offset is not None
    np.testing.assert_array_equal(found.joint_rotations, values.joint_rotations)
    np.testing.assert_array_equal(found.offset[:FLAME_VERTICES], values.offset)
    for change, words in (
        ({"expr": None}, "found no expr"),
        ({"rotation": np.zeros((3, 3), np.float32)}, "'rotation' of shape"),
        ({"translation": np.full((TIMESTEPS, 3), np.nan, np.float32)}, "finite numbers"),
        ({"static_offset": np.zeros((5143, 3), np.float32)}, "static_offset"),
    ):
        changed = {name: value for name, value in {**plain, **change}.items() if value is not None}
        np.savez(tmp_path / "bad.npz", **changed)
        with pytest.raises(InputError, match=words):
            read_flame_parameters(tmp_path / "bad.npz")


def flame_sized(seed: int) -> HeadModel:
    """A head with as many vertices, triangles and joints as FLAME, and lips at a known distance."""
    random = torch.Generator().manual_seed(seed)
    template = torch.rand(FLAME_VERTICES, 3, generator=random) * 0.2
    across = torch.linspace(-0.02, 0.02, 15)
    for rows, height in ((UPPER_LIP, 0.003), (LOWER_LIP, -0.001)):
        template[list(rows)] = torch.stack((across, torch.full((15,), height), 0.05 - across**2), dim=1)
    weights = torch.zeros(FLAME_VERTICES, 5)
    weights[:, 1] = 1
    return HeadModel(
        template=template,
        faces=torch.randint(0, FLAME_VERTICES, (FLAME_FACES, 3), generator=random),
        expression_basis=torch.randn(FLAME_VERTICES, 3, 4, generator=random) * 1e-3,
        pose_basis=torch.zeros(FLAME_VERTICES, 3, 0),
        eyelid_basis=torch.zeros(FLAME_VERTICES, 3, 2),
        joint_regressor=torch.full((5, FLAME_VERTICES), 1 / FLAME_VERTICES),
        skinning_weights=weights,
        parents=(-1, 0, 1, 1, 1),
        joint_names=("root", "neck", "jaw", "left_eye", "right_eye"),
        version="flame2023",
    )


def test_teeth_stand_where_they_are_said_to() -> None:
    mean = flame_sized(0)
    moved = mean.template.clone()
    moved[list(UPPER_LIP), 0] += 0.01
    moved[list(LOWER_LIP), 0] += 0.03
    head = with_teeth(mean, dataclasses.replace(mean, template=moved))
    assert head.template.shape == (5143, 3) and head.faces.shape == (10144, 3)
    teeth = head.template[FLAME_VERTICES:].view(8, 15, 3)
    opening, lips = 0.004, mean.template[[UPPER_LIP[4], LOWER_LIP[4]]].mean(0)
    heights = torch.tensor([2.1, -2.1, 0.1, -0.1, 2.1, 0.1, -2.1, -0.1]) * opening + 0.001
    torch.testing.assert_close(teeth[:, 4, 1], heights)
    depths = lips[2] - opening * torch.tensor([1.5, 1.9, 1.5, 1.9, 2.5, 2.5, 2.9, 2.9])
    torch.testing.assert_close(teeth[:, 4, 2], depths)
    torch.testing.assert_close(teeth[0, :, 0], torch.linspace(-0.02, 0.02, 15) + 0.02, msg="identity: mean of the lips")
    jaw = dataclasses.replace(
        head.neutral_drive(), joint_rotations=torch.tensor([[0.0] * 3] * 2 + [[0.3, 0, 0]] + [[0.0] * 3] * 2)
    )
    strips = (head.vertices(jaw) - head.template)[FLAME_VERTICES:].norm(dim=1).view(8, 15).amax(1)
    assert [bool(moves > 1e-4) for moves in strips] == [False, True, False, True, False, False, True, True]


def test_triangles_of_the_teeth_are_in_their_order() -> None:
    faces = teeth_faces().tolist()
    assert faces[0] == [5023, 5054, 5053] and faces[1] == [5023, 5024, 5054]  # (ur, ue): ADC, ABD
    assert faces[14] == [5030, 5031, 5060] and faces[15] == [5031, 5061, 5060]  # from the eighth cell: ABC, BDC
    assert faces[28] == [5083, 5098, 5099] and faces[56] == [5098, 5053, 5099]  # urb, ueb: ACD; ue, ueb: CAD
    assert faces[84] == [5068, 5069, 5038] and len(faces) == 168  # lr, le: CDA
    assert all(len(set(face)) == 3 and 5023 <= min(face) <= max(face) < 5143 for face in faces)


def test_flame_file_with_teeth_offset_and_identity(tmp_path: Path) -> None:
    """A GaussianAvatars folder as its users have it: FLAME from the user, parameters beside the Gaussians."""
    mean = flame_sized(1)
    basis = np.random.default_rng(0).normal(0, 1e-3, (FLAME_VERTICES, 3, 103)).astype(np.float32)
    np.savez(
        tmp_path / "flame2023.npz",
        v_template=mean.template.numpy(),
        f=mean.faces.numpy(),
        weights=mean.skinning_weights.numpy(),
        posedirs=np.zeros((FLAME_VERTICES, 3, 36), np.float32),
        shapedirs=basis,
        J_regressor=mean.joint_regressor.numpy(),
        kintree_table=np.array([[4294967295, 0, 1, 1, 1], [0, 1, 2, 3, 4]], np.uint32),
    )
    shape = np.array([1.0, -2.0, 0.5], np.float32)
    offset = np.full((5143, 3), 0.002, np.float32)
    zero = FlameParameters(
        shape, np.zeros((1, 100), np.float32), np.zeros((1, 5, 3), np.float32), np.zeros((1, 3), np.float32), offset
    )
    write_flame_parameters(tmp_path / "flame_param.npz", zero, FLAME_VERTICES)
    rows = dataclasses.replace(to_stored(cloud()), faces=np.full(60, 10143))
    write_gaussian_ply(tmp_path / "point_cloud.ply", rows)
    avatar = open_gaussians(tmp_path / "point_cloud.ply", GaussianFileOptions(head_model=tmp_path / "flame2023.npz"))
    assert isinstance(avatar, BoundAvatar)
    expected = mean.template.numpy() + basis[:, :, :3] @ shape + 0.002
    np.testing.assert_allclose(avatar.head.template[:FLAME_VERTICES], expected, atol=1e-6)
    assert avatar.head.template.shape == (5143, 3) and avatar.head.version == "flame2023"
    assert np.isfinite(avatar.gaussians(avatar.head.neutral_drive()).means.numpy()).all()


def test_binding_of_methods_with_and_without_rows(toy_head: HeadModel) -> None:
    holder = torch.nn.Module()
    assert binding_of(holder, 3, 10) is None
    holder.rows = Rows({"means": Column(torch.zeros(3, 3), 0.1)}, {"face": torch.tensor([4, 0, 9])})
    assert binding_of(holder, 3, 10) is not None and binding_of(holder, 4, 10) is None
    assert binding_of(holder, 3, 9) is None, "of another head"
    frames = triangle_frames(toy_head.template, toy_head.faces)
    picks = torch.tensor([0, 5, 17])
    assert torch.equal(nearest_faces(frames.centers[picks] + 1e-4, frames), picks)
