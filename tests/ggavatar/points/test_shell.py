"""Points on and off the skin: shares of the triangles, offsets of their regions, and what is left out.

References: areas and barycentric coordinates in closed form, a sphere, whose normals are its radii.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from scipy.spatial import KDTree

from ggavatar.geometry.uv_sampling import SurfaceSamples, face_areas
from ggavatar.head.model import HeadModel
from ggavatar.points.shell import Shell, ShellRanges, sample_shell, triangles_of

RANGES = ShellRanges(face=(-0.005, 0.015), rest=(0.0, 0.06))


@pytest.fixture
def head(toy_head: HeadModel) -> HeadModel:
    """The egg with a face in front, and a tongue in its front of all."""
    z = toy_head.template[:, 2]
    regions = {"face": (z > 0.02).nonzero().squeeze(-1), "tongue": (z > 0.07).nonzero().squeeze(-1)}
    return dataclasses.replace(toy_head, regions=regions)


def drawn(head: HeadModel, on: int = 4_000, off: int = 3_000) -> tuple[Shell, Shell]:
    room = face_areas(head.template, head.faces)
    shell = sample_shell(head, room, (on, off), RANGES, torch.Generator().manual_seed(3))
    assert len(shell.face) == on + off
    return Shell(*(values[:on] for values in shell)), Shell(*(values[on:] for values in shell))


def test_points_on_the_skin_have_the_shares_of_the_areas_and_are_uniform(head: HeadModel) -> None:
    on, _ = drawn(head)
    share = face_areas(head.template, head.faces)
    share = 4_000 * share / share.sum()
    assert ((torch.bincount(on.face, minlength=len(share)) - share).abs() < 1.001).all()
    assert not on.offsets.any() and (on.weights >= 0).all()
    assert torch.allclose(on.weights.sum(1), torch.ones(4_000), atol=1e-6)
    # uniform in a triangle: E b = 1/3, E b² = 1/6, whichever the corner
    assert torch.allclose(on.weights.mean(0), torch.full((3,), 1 / 3), atol=0.01)
    assert torch.allclose(on.weights.square().mean(0), torch.full((3,), 1 / 6), atol=0.01)


def test_offsets_are_uniform_in_the_ranges_of_their_region(head: HeadModel) -> None:
    _, off = drawn(head)
    in_face = triangles_of(head, ("face",))[off.face]
    for rows, (low, high) in ((in_face, (-0.005, 0.015)), (~in_face, (0.0, 0.06))):
        offsets = off.offsets[rows]
        assert len(offsets) > 300 and offsets.min() >= low and offsets.max() <= high
        assert float(offsets.mean()) == pytest.approx((low + high) / 2, abs=0.05 * (high - low))
        assert float(offsets.std()) == pytest.approx((high - low) / 12**0.5, rel=0.08)


def test_nothing_is_placed_off_the_inside_of_the_mouth(head: HeadModel) -> None:
    on, off = drawn(head)
    interior = triangles_of(head, ("tongue",), touching=True)
    assert 0 < int(interior.sum()) < len(interior)
    assert interior[on.face].any() and not interior[off.face].any()


def test_a_head_that_is_all_interior_or_without_a_face_gets_its_points_too(head: HeadModel) -> None:
    everything = torch.arange(len(head.template))
    assert len(drawn(dataclasses.replace(head, regions={"tongue": everything}), 10, 30)[1].face) == 30
    _, off = drawn(dataclasses.replace(head, regions={}), 10, 300)
    assert float(off.offsets.max()) > 0.05


def test_places_are_along_the_smooth_normals(head: HeadModel) -> None:
    """On a sphere the normals of vertices are its radii; between vertices they are blended, not those of triangles."""
    sphere = dataclasses.replace(head, template=torch.nn.functional.normalize(head.template, dim=1))
    rows = 500
    shell = Shell(
        torch.arange(rows) % len(head.faces),
        torch.rand(rows, 3, generator=torch.Generator().manual_seed(0)).softmax(1),
        torch.linspace(-0.1, 0.3, rows),
    )
    skin = SurfaceSamples(shell.face, shell.weights).points(sphere.template, head.faces)
    away = shell.points(sphere) - skin
    assert torch.allclose(away.norm(dim=1), shell.offsets.abs(), atol=1e-6)
    far = shell.offsets.abs() > 0.02
    cosine = (away * skin).sum(1) / (away.norm(dim=1) * skin.norm(dim=1)).clamp_min(1e-9) * shell.offsets.sign()
    assert float(cosine[far].min()) > 0.99
    flat = torch.linalg.cross(
        *(sphere.template[head.faces[shell.face]][:, 1:] - sphere.template[head.faces[shell.face]][:, :1]).unbind(1)
    )
    flat = torch.nn.functional.normalize(flat, dim=1) * shell.offsets[:, None]
    assert float((away - flat).norm(dim=1)[far].max()) > 0.02


def test_points_off_the_skin_are_clear_of_other_skin(head: HeadModel) -> None:
    """Two eggs 4 cm apart: a point off one may not be at the other."""
    apart = head.template + torch.tensor([0.2, 0.0, 0.0])
    names = ("expression_basis", "pose_basis", "eyelid_basis", "skinning_weights")
    two = dataclasses.replace(
        head,
        template=torch.cat((head.template, apart)),
        faces=torch.cat((head.faces, head.faces + len(head.template))),
        joint_regressor=torch.cat((head.joint_regressor, head.joint_regressor * 0), dim=1),
        regions={},
        **{name: getattr(head, name).repeat(2, *[1] * (getattr(head, name).dim() - 1)) for name in names},
    )
    _, off = drawn(two, 10, 2_000)
    nearest = KDTree(two.template.numpy()).query(off.points(two).numpy())[0]
    assert (nearest >= 0.5 * np.abs(off.offsets.numpy()) - 1e-6).all()
    unlucky = off.points(two)[off.face < len(head.faces)]
    assert len(unlucky) > 500 and float(unlucky[:, 0].max()) < 0.2 - 0.02


def test_shells_are_the_same_for_the_same_seed(head: HeadModel) -> None:
    first, second = drawn(head), drawn(head)
    assert all(
        torch.equal(a, b) for one, other in zip(first, second, strict=True) for a, b in zip(one, other, strict=True)
    )
