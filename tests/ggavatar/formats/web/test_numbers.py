"""The page's arithmetic in node against ours in torch.

Also covers `formats/web/page/` (algebra, head, triangles, adjuster, placement, depth_sort, avatar, container, drives).
"""

from __future__ import annotations

import dataclasses
import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ggavatar.core import Drive
from ggavatar.data.capture import Capture
from ggavatar.formats.web.clips import Clip, clip_arrays
from ggavatar.formats.web.container import pack
from ggavatar.formats.web.description import describe
from ggavatar.formats.web.tensors import Tensors, avatar_tensors, rounded
from ggavatar.gaussians.bound_parts import BoundParts, posed
from ggavatar.gaussians.initial_colors import SH_C0
from ggavatar.head.head_pose import HeadPoses
from tests.support.page_modules import run_modules
from tests.support.untrained_avatars import random_drives, run_of, untrained, with_everything

POSE = """
const file = unpack(new Uint8Array(fs.readFileSync(values.path)).buffer);
const avatar = new Avatar(file);
const [clip] = clipsOf(file);
return clip.frames.map((_, row) => {
  const drive = clipDrive(clip, row);
  return { placed: [...avatar.pose(drive)], stride: avatar.stride, order: [...avatar.order(drive.world_to_camera)],
           vertices: [...avatar.head.posed] };
});
"""


def packed(parts: BoundParts, drives: list[Drive], reader: Any, exact: bool) -> Tensors:
    """All tensors with one clip, of cameras that equal the head poses."""
    tensors = avatar_tensors(parts, exact)
    cameras = [dataclasses.replace(reader.camera(3), world_to_camera=drive.head_to_camera) for drive in drives]
    clip = Clip("random", 25.0, tuple(range(len(drives))), tuple(drives), tuple(cameras))
    for name, array in clip_arrays(clip, parts.poses.reference).items():
        tensors.put(f"clip.0.{name}", array, 16)
    return tensors


@pytest.mark.parametrize(
    ("method", "settings", "changes"),
    [
        ("ggavatar_plus", {}, {}),
        ("ggavatar", {"sh_degree": 3, "sh_iterations": 1000}, {}),
        ("ggavatar_without_lbs", {"pose_on": "neck"}, {}),
        ("gaussian_avatars", {}, {"holds_torso": False}),
    ],
)
def test_gaussians_and_order_are_those_of_torch(
    method: str, settings: dict[str, Any], changes: dict[str, Any], toy_capture: Capture, tmp_path: Path
) -> None:
    avatar, reader = untrained(method, toy_capture, 100, **settings)
    parts = dataclasses.replace(avatar.bound_parts(), **changes)
    seven = with_everything(parts.head)
    adjuster = parts.adjuster
    if adjuster is not None:  # two more joints are twelve more inputs
        (weight, bias), *rest = adjuster.latent_layers
        more = torch.randn(len(weight), 12, generator=torch.Generator().manual_seed(1)) * 0.1
        at = seven.expression_basis.shape[2] + 18
        first = torch.cat((weight[:, :at], more, weight[:, at:]), dim=1)
        adjuster = dataclasses.replace(adjuster, latent_layers=((first, bias), *rest))
    drives = random_drives(seven, 3, root_still=parts.holds_torso)
    poses = HeadPoses.of(seven, drives)
    parts = dataclasses.replace(parts, head=seven, poses=poses, adjuster=adjuster)
    tensors = packed(parts, drives, reader, exact=True)
    clips = [{"name": "random", "fps": 25.0, "frames": [0, 1, 2]}]
    run = run_of(avatar, reader, toy_capture)
    description = describe(run, parts, drives) | {"title": "t", "clips": clips, "embed": None}
    (tmp_path / "avatar.bin").write_bytes(gzip.decompress(pack(tensors, description)))
    values = {"path": str(tmp_path / "avatar.bin")}
    found = run_modules(POSE, "container", "avatar", "drives", folder=tmp_path, values=values)
    for drive, frame in zip(drives, found, strict=True):
        expected = posed(parts, drive)
        rows = np.array(frame["placed"]).reshape(len(parts.face), frame["stride"])
        assert np.abs(rows[:, :3] - expected.means.numpy()).max() < 2e-6  # m
        np.testing.assert_allclose(rows[:, 3:6], expected.scales.numpy(), rtol=2e-4)
        assert np.abs((rows[:, 8:12] * expected.quats.numpy()).sum(1)).min() > 1 - 1e-5
        if parts.adjuster is not None and len(parts.adjuster.last_bias) > 10:
            change = (expected.colors - parts.harmonics)[:, 0].numpy()
            np.testing.assert_allclose(rows[:, 12:15], change, atol=1e-5)
            assert np.abs(change).max() > 1e-3 / SH_C0
        depths = (expected.means @ drive.head_to_camera[2, :3] + drive.head_to_camera[2, 3]).numpy()
        assert sorted(frame["order"]) == list(range(len(rows)))
        steps = np.ptp(depths) / 65535
        assert np.diff(depths[frame["order"]]).min() > -2 * steps, "near to far, within the steps of the sort"


def test_algebra_is_that_of_scipy(tmp_path: Path) -> None:
    random = np.random.default_rng(2)
    vectors = [*random.normal(size=(20, 3)), *(1e-6 * random.normal(size=(3, 3))), np.zeros(3)]
    vectors += [np.pi * axis for axis in np.eye(3)] + [3.1 * np.array([0.6, 0, 0.8])]
    script = """
    return values.map((v) => {
      const r = rotation(...v);
      const m = rigid(r, 1, 2, 3);
      return { r, back: axisAngle(r), square: multiply(r, r), whole: compose(m, inverse(m)),
               fixed: applied(turnAbout(r, [1, 2, 3]), [1, 2, 3]),
               straight: straightened(rigid(r.map((x) => 0.8 * x), 4, 5, 6)) };
    });
    """
    values = [list(map(float, vector)) for vector in vectors]
    for vector, found in zip(vectors, run_modules(script, "algebra", folder=tmp_path, values=values), strict=True):
        wanted = Rotation.from_rotvec(vector)
        np.testing.assert_allclose(np.reshape(found["r"], (3, 3)), wanted.as_matrix(), atol=1e-9)
        assert (Rotation.from_rotvec(found["back"]) * wanted.inv()).magnitude() < 1e-6
        np.testing.assert_allclose(np.reshape(found["square"], (3, 3)), (wanted * wanted).as_matrix(), atol=1e-9)
        np.testing.assert_allclose(np.reshape(found["whole"], (3, 4)), np.eye(3, 4), atol=1e-9)
        np.testing.assert_allclose(found["fixed"], [1, 2, 3], atol=1e-9)
        straight = np.reshape(found["straight"], (3, 4))
        np.testing.assert_allclose(straight[:, :3], wanted.as_matrix(), atol=1e-9)
        assert list(straight[:, 3]) == [4, 5, 6]


def test_a_triangle_without_area_has_valid_axes(tmp_path: Path) -> None:
    script = """
    const vertices = [0, 0, 0, 1, 0, 0, 2, 0, 0, 1, 0, 0];
    const frames = new Float32Array(3 * FRAME);
    triangleFrames(vertices, [0, 1, 2, 0, 0, 0, 0, 1, 3], frames);
    return [...frames];
    """
    frames = np.reshape(run_modules(script, "triangles", folder=tmp_path), (3, 17))
    for frame in frames:
        matrix = frame[3:12].reshape(3, 3)
        np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-6)
        assert np.linalg.det(matrix) > 0 and np.isfinite(frame).all()
    np.testing.assert_allclose(frames[0, 12], 0.5)


def test_rounded_parts_are_what_the_page_reads(toy_capture: Capture, tmp_path: Path) -> None:
    avatar, reader = untrained("ggavatar_plus", toy_capture, 100)
    parts = avatar.bound_parts()
    drives = [dataclasses.replace(reader.drive(number), frame=None) for number in toy_capture.frames[:3]]
    tensors = packed(parts, drives, reader, exact=False)
    run = run_of(avatar, reader, toy_capture)
    clips = [{"name": "random", "fps": 25.0, "frames": [0, 1, 2]}]
    description = describe(run, parts, drives) | {"title": "t", "clips": clips, "embed": None}
    (tmp_path / "avatar.bin").write_bytes(gzip.decompress(pack(tensors, description)))
    values = {"path": str(tmp_path / "avatar.bin")}
    found = run_modules(POSE, "container", "avatar", "drives", folder=tmp_path, values=values)
    small = rounded(parts, tensors)
    for drive, frame in zip(drives, found, strict=True):
        rows = np.array(frame["placed"]).reshape(len(parts.face), frame["stride"])
        assert np.abs(rows[:, :3] - posed(small, drive).means.numpy()).max() < 2e-5  # the clip has 16 bits
