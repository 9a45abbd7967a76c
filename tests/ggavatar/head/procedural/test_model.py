"""The procedural head against topology (Euler, closed edges), FLAME's extents and a float64 rigid reference.

Also covers `ggavatar/head/procedural/expression.py`, `ggavatar/head/procedural/identity.py`,
`ggavatar/head/procedural/regions.py`, `ggavatar/head/procedural/rig.py`, `ggavatar/head/procedural/skin.py`,
`ggavatar/head/procedural/uv.py`.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from ggavatar.errors import InputError
from ggavatar.geometry.transforms import axis_angle_to_matrix
from ggavatar.head.model import HeadModel
from ggavatar.head.procedural.model import procedural_head, procedural_names
from ggavatar.head.procedural.surface import EYE_CENTER, EYE_RADIUS
from tests.support.procedural_identity import identity_basis


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return procedural_head()


def driven(head: HeadModel, *, jaw: float = 0.0, lids: float = 0.0, **expression: float) -> np.ndarray:
    drive = head.neutral_drive()
    coefficients, rotations = drive.expression.clone(), drive.joint_rotations.clone()
    rotations[head.joint_index("jaw"), 0] = jaw
    for name, value in expression.items():
        coefficients[procedural_names()[0].index(name)] = value
    changed = dataclasses.replace(
        drive, expression=coefficients, joint_rotations=rotations, eyelids=torch.tensor([lids, lids])
    )
    return head.vertices(changed).numpy()


def edge_uses(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    edges = np.concatenate((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]))
    return np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)


def test_extents_are_those_of_flame(head):
    low, high = head.template.amin(0), head.template.amax(0)
    assert 0.10 < high[0] < 0.16 and torch.allclose(high[0], -low[0], atol=2e-3)
    assert -0.22 < low[1] < -0.17 and 0.12 < high[1] < 0.14
    assert 0.07 < high[2] < 0.08 and -0.14 < low[2] < -0.11
    assert 8_000 <= len(head.faces) <= 12_000


def test_every_edge_has_two_faces_that_run_along_it_in_opposite_directions_except_on_named_boundaries(head):
    faces = head.faces.numpy()
    directed = np.concatenate((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]))
    assert len(np.unique(directed, axis=0)) == len(directed), "an edge is used twice in the same direction"
    edges, uses = edge_uses(faces)
    assert uses.max() == 2
    loose = np.unique(edges[uses == 1])
    allowed = [head.regions[name].numpy() for name in ("shoulders", "ears", "skin", "teeth")]
    assert np.isin(loose, np.concatenate(allowed)).all()
    closed = [name for name in ("left_eyeball", "right_eyeball", "tongue") if np.isin(loose, head.regions[name]).any()]
    assert closed == []


def test_closed_pieces_are_spheres_with_outward_faces(head):
    for name in ("left_eyeball", "right_eyeball", "tongue"):
        rows = head.regions[name].numpy()
        faces = head.faces.numpy()[np.isin(head.faces.numpy(), rows).all(axis=1)]
        edges, _ = edge_uses(faces)
        assert len(rows) - len(edges) + len(faces) == 2, name
        corners = head.template.numpy().astype(np.float64)[faces]
        assert np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() > 0, name


def test_the_skin_faces_outwards(head):
    faces = head.faces.numpy()
    face = head.regions["face"].numpy()
    chosen = faces[np.isin(faces, face).all(axis=1)]
    corners = head.template.numpy()[chosen]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outwards = corners.mean(axis=1) - (0, 0, -0.03)
    assert ((normals * outwards).sum(axis=1) > 0).mean() > 0.95


def test_no_triangle_is_a_needle_in_the_face(head):
    corners = head.template.numpy()[head.faces.numpy()[np.isin(head.faces, head.regions["face"]).all(1)]]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    quality = 4 * np.sqrt(3) * area / (sides**2).sum(axis=1)
    assert np.median(quality) > 0.75
    assert area.min() > 1e-10


def test_weights_and_regressor(head):
    weights = head.skinning_weights
    assert torch.allclose(weights.sum(1), torch.ones(len(weights)), atol=1e-5) and weights.min() >= 0
    joints = head.joint_regressor.double() @ head.template.double()
    assert torch.allclose(joints[3], torch.tensor(EYE_CENTER, dtype=torch.float64), atol=2e-4)
    assert torch.allclose(joints[4] * torch.tensor([-1.0, 1, 1]), joints[3], atol=2e-4)
    assert (weights[head.regions["lower_teeth"], 2] > 0.99).all()
    assert (weights[head.regions["upper_teeth"], 2] == 0).all()


@pytest.mark.parametrize(
    "name", ["face", "lips", "mouth", "eyes", "left_eyeball", "scalp", "ears", "neck", "shoulders"]
)
def test_regions_are_where_their_names_say(head, name):
    rows = head.regions[name]
    assert len(rows) > 20 and rows.min() >= 0 and rows.max() < len(head.template)
    middle = head.template[rows].mean(0)
    heights = {"scalp": (0.02, 0.12), "neck": (-0.14, -0.06), "shoulders": (-0.2, -0.14), "lips": (-0.06, -0.03)}
    low, high = heights.get(name, (-0.06, 0.06))
    assert low < middle[1] < high


def test_uv_stays_in_the_unit_square_and_skin_texels_are_not_shared(head):
    assert head.uv is not None and head.uv.min() >= 0 and head.uv.max() <= 1
    corners = head.uv.numpy()[np.isin(head.faces, head.regions["face"]).all(1)]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    assert (np.sign(area) == np.sign(np.median(area))).mean() > 0.97


def test_neutral_drive_gives_the_template(head):
    assert torch.allclose(head.vertices(head.neutral_drive()), head.template, atol=1e-7)


def test_a_turned_root_moves_everything_rigidly(head):
    rotation = torch.tensor([0.2, -0.4, 0.1])
    drive = dataclasses.replace(
        head.neutral_drive(), joint_rotations=torch.cat((rotation[None], torch.zeros(4, 3))), eyelids=torch.zeros(2)
    )
    pivot = (head.joint_regressor.double() @ head.template.double())[0]
    expected = (head.template.double() - pivot) @ axis_angle_to_matrix(rotation.double()).T + pivot
    assert torch.allclose(head.vertices(drive).double(), expected, atol=1e-6)


def test_every_expression_moves_something_and_sides_mirror(head):
    names = procedural_names()[0]
    assert len(names) >= 30 and len(set(names)) == len(names) == head.expression_basis.shape[2]
    moved = head.expression_basis.norm(dim=1).amax(0)
    assert (moved > 0.001).all() and (moved < 0.025).all()
    smile = [head.expression_basis[:, :, names.index(f"smile_{side}")] for side in ("left", "right")]
    for displacement, sign in zip(smile, (1.0, -1.0), strict=True):
        assert head.template[displacement.norm(dim=1).argmax(), 0] * sign > 0.01


def test_expressions_leave_eyes_and_teeth_alone(head):
    fixed = torch.cat([head.regions[name] for name in ("left_eyeball", "right_eyeball", "teeth", "ears")])
    assert head.expression_basis[fixed].abs().max() == 0


def test_lips_part_with_the_jaw_and_are_closed_at_rest(head):
    loop = head.regions["lip_margin"].numpy()
    upper, lower = loop[len(loop) // 4], loop[-len(loop) // 4]
    assert np.linalg.norm(driven(head)[upper] - driven(head)[lower]) < 0.0005
    assert driven(head, jaw=0.25)[upper, 1] - driven(head, jaw=0.25)[lower, 1] > 0.010
    corners = loop[[0, len(loop) // 2]]
    assert np.abs(driven(head, jaw=0.25)[corners, 0] - driven(head)[corners, 0]).max() < 0.002


def test_lids_close_over_the_eyeballs(head):
    closed = driven(head, lids=1.0)
    for name, sign in (("left_lid_margin", 1), ("right_lid_margin", -1)):
        loop = head.regions[name].numpy()
        half = len(loop) // 2
        upper, lower = closed[loop[1:half]], closed[loop[:half:-1]]
        apart = np.linalg.norm(upper - lower, axis=1)
        open_ = np.linalg.norm(head.template[loop[1:half]] - head.template[loop[:half:-1].copy()], axis=1)
        assert apart.max() < 0.0025 and np.median(apart) < 0.0008 < 0.006 < open_.max()
        center = np.asarray(EYE_CENTER) * (sign, 1, 1)
        assert np.linalg.norm(upper - center, axis=1).min() > EYE_RADIUS


def test_identity_folds_into_the_template_linearly():
    basis, names = identity_basis(), procedural_names()[1]
    assert basis.shape[2] == len(names) == len(set(names))
    coefficients = np.linspace(-1, 1, len(names))
    folded = procedural_head(coefficients.tolist()).template
    expected = procedural_head().template + basis @ torch.tensor(coefficients, dtype=torch.float32)
    assert torch.allclose(folded, expected, atol=1e-6)
    assert (basis.norm(dim=1).amax(0) > 0.0004).all()


def test_eyeballs_stay_round_under_identity():
    wide = procedural_head([2.0] * 8)
    points = wide.template[wide.regions["left_eyeball"]]
    radius = (points - (points.amax(0) + points.amin(0)) / 2).norm(dim=1)
    assert radius.max() / radius.min() < 1.08


def test_seed_decides_the_triangles():
    procedural_head(seed=0)
    assert torch.equal(procedural_head(seed=0).faces, procedural_head(seed=0).faces)
    assert procedural_head(seed=1).template.shape != procedural_head().template.shape or not torch.equal(
        procedural_head(seed=1).template, procedural_head().template
    )


@pytest.mark.parametrize("bad", [[0.0] * 200, [float("nan")]])
def test_bad_identity_is_refused(bad):
    with pytest.raises(InputError, match="identity coefficients"):
        procedural_head(np.asarray(bad))
