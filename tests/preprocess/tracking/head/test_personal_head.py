"""The subject's head model: landmark positions, closing lids, and an outline that follows the masks."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ggavatar.data.capture import Tracking
from ggavatar.head.expression_axes import TRACKED_AXES
from ggavatar.head.model import HeadModel
from ggavatar.landmarks.bundle import CanonicalFace
from preprocess.tracking.geometry import landmark_topology as topology
from preprocess.tracking.geometry.projection import posed_vertices, project, silhouette
from preprocess.tracking.head.generic_head import JOINT_NAMES, GenericHead, generic_head
from preprocess.tracking.head.personal_head import NECK_UNIT, PersonalShape, assemble_head, fit_shape, lid_axes
from preprocess.tracking.head.silhouette_fit import OutlineMasks, fit_silhouette, silhouette_overlap

pytestmark = pytest.mark.weights

Person = tuple[HeadModel, PersonalShape]


@pytest.fixture(scope="module")
def generic(canonical: CanonicalFace) -> GenericHead:
    return generic_head(canonical)


@pytest.fixture(scope="module")
def neutral(generic: GenericHead) -> np.ndarray:
    """Landmarks of a synthetic person: the generic ones, longer, with a broad nose."""
    points = generic.landmarks @ generic.vertices
    points[:, 1] *= 1.08
    points[:, 0] *= 1 + 0.1 * np.exp(-(((points[:, 2] - 0.06) / 0.02) ** 2))
    return points


@pytest.fixture(scope="module")
def person(generic: GenericHead, neutral: np.ndarray) -> Person:
    shape = fit_shape(generic, neutral)
    named = (generic.landmarks @ generic.axes.reshape(len(generic.vertices), -1)).reshape(468, 3, -1)
    return assemble_head(generic, shape, named, np.zeros((468, 3, 2)), lid_axes(neutral, shape)), shape


def test_landmarks_lie_on_the_generic_face_where_the_canonical_ones_do(
    generic: GenericHead, canonical: CanonicalFace
) -> None:
    placed = generic.landmarks @ generic.vertices
    apart = np.linalg.norm(placed - canonical.vertices, axis=1)
    assert np.median(apart) < 0.008 and apart.max() < 0.02
    mouth, eyes = generic.regions["mouth"], generic.regions["eyes"]
    assert np.isin(generic.embedding.corners[topology.UPPER_LIP_MARGIN], mouth).any(axis=1).all()
    assert np.isin(generic.embedding.corners[topology.LEFT_UPPER_LID], eyes).any(axis=1).all()


def test_template_passes_through_neutral_landmarks(generic: GenericHead, neutral: np.ndarray, person: Person) -> None:
    head, _ = person
    missed = np.linalg.norm(generic.landmarks @ head.template.numpy() - neutral, axis=1)
    assert np.median(missed) < 0.0005 and np.percentile(missed, 95) < 0.002
    assert head.version == "tracked-2"
    assert head.expression_basis.shape[2] == len(TRACKED_AXES) + 2 + 1, "named, personal, the neck's length"
    np.testing.assert_allclose(head.skinning_weights.sum(dim=1).numpy(), 1, atol=1e-5)


def test_joints_are_where_the_shape_says_and_no_facial_expression_moves_them(person: Person) -> None:
    head, shape = person
    rest = (head.joint_regressor @ head.template).numpy()
    np.testing.assert_allclose(rest, shape.joints, atol=1e-5)
    moved = torch.einsum("jv,vxe->jxe", head.joint_regressor, head.expression_basis)
    assert float(moved[..., :-1].abs().max()) < 2e-4


def test_a_longer_neck_lowers_only_the_torso_and_its_joint(generic: GenericHead, person: Person) -> None:
    head, shape = person
    arm = shape.joints[JOINT_NAMES.index("torso")] - shape.joints[JOINT_NAMES.index("cervical")]
    down = NECK_UNIT * arm / np.linalg.norm(arm)
    axis = head.expression_basis[:, :, -1].numpy()
    torso_alone = head.skinning_weights[:, head.joint_index("torso")].numpy() > 0.999
    assert torso_alone.sum() > 100
    np.testing.assert_allclose(axis[torso_alone], np.tile(down, (torso_alone.sum(), 1)), atol=1e-5)
    assert np.abs(axis[generic.regions["face"]]).max() < 0.02 * NECK_UNIT, "the chin's underside belongs to both"
    moved = head.joint_regressor.numpy() @ axis
    np.testing.assert_allclose(moved[head.joint_index("torso")], down, atol=0.05 * NECK_UNIT)
    for name in ("neck", "jaw", "left_eye", "right_eye", "cervical"):
        assert np.abs(moved[head.joint_index(name)]).max() < 2e-4, name


def test_closed_lids_meet(generic: GenericHead, person: Person) -> None:
    head, _ = person
    drive = dataclasses.replace(head.neutral_drive(), eyelids=torch.ones(2))
    for lids, side in (
        ((topology.LEFT_UPPER_LID, topology.LEFT_LOWER_LID), 0),
        ((topology.RIGHT_UPPER_LID, topology.RIGHT_LOWER_LID), 1),
    ):
        upper, lower = (
            generic.landmarks @ vertices for vertices in (head.vertices(drive).numpy(), head.template.numpy())
        )
        closed = np.linalg.norm(upper[lids[0]] - upper[lids[1]], axis=1)[2:-2]
        opened = np.linalg.norm(lower[lids[0]] - lower[lids[1]], axis=1)[2:-2]
        assert (closed < 0.3 * opened).all(), side


def test_torso_joint_leaves_the_head_alone(generic: GenericHead, person: Person) -> None:
    head, _ = person
    turns = torch.zeros(len(head.parents), 3)
    turns[head.joint_index("cervical"), 0], turns[head.joint_index("torso"), 1] = 0.2, 0.1
    moved = (head.vertices(dataclasses.replace(head.neutral_drive(), joint_rotations=turns)) - head.template).norm(
        dim=1
    )
    assert float(moved[generic.regions["face"]].max()) < 0.002
    assert float(moved[generic.regions["torso"]].min()) > 0.005


def test_outline_follows_the_masks_and_the_face_stays(generic: GenericHead, person: Person) -> None:
    head, _ = person
    rows, size = np.arange(4), 192
    pose = np.tile(np.eye(4), (4, 1, 1))
    yaw = Rotation.from_euler("y", [[-25], [-8], [8], [25]], degrees=True)
    pose[:, :3, :3] = (Rotation.from_euler("x", 180, degrees=True) * yaw).as_matrix()
    pose[:, 2, 3] = 1.0
    intrinsics = np.tile([[300.0, 0, 96], [0, 300, 80], [0, 0, 1]], (4, 1, 1))
    joints = np.zeros((4, len(head.parents), 3))
    expression = np.zeros((4, head.expression_basis.shape[2]))
    tracking = Tracking(intrinsics, pose, expression, joints, np.zeros((4, 2)), np.zeros((4, 3)))
    hairy = head.template.clone()
    scalp = generic.regions["scalp"]
    hairy[scalp] *= 1.15
    masks = []
    for row in rows:
        vertices = posed_vertices(dataclasses.replace(head, template=hairy), tracking, int(row))
        pixels, depths = project(vertices, intrinsics[row], pose[row])
        masks.append(silhouette(pixels, depths, generic.faces, (size, size)).astype(np.uint8) * 255)
    outlines = OutlineMasks(rows, np.stack(masks), 1.0)
    template = fit_silhouette(head, generic, tracking, outlines)
    fitted = dataclasses.replace(head, template=torch.tensor(template, dtype=torch.float32))
    before, after = silhouette_overlap(head, tracking, outlines), silhouette_overlap(fitted, tracking, outlines)
    assert 1 - after < 0.5 * (1 - before)
    face = generic.regions["face"]
    assert np.median(np.linalg.norm(template[face] - head.template.numpy()[face], axis=1)) < 0.002
