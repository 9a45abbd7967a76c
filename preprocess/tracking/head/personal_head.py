"""The subject's head model: the generic head deformed to the tracked face, with expression axes learned from the clip.

`similarity_transform` is kept beside libraries: `skimage.transform.SimilarityTransform` agrees to 1e-15 but not to the
last bit, takes twice as long (237 against 119 µs for 468 points), and has no method for all versions we support
(`estimate` is deprecated since 0.26, `from_estimate` is missing before); `trimesh.registration.procrustes` takes the
scale from the extents, which is not the least-squares one (7e-4 off under 2 mm of noise).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from ggavatar.head.expression_axes import tracked_names
from ggavatar.head.model import HeadModel
from preprocess.tracking.geometry import landmark_topology as topology
from preprocess.tracking.geometry.landmark_embedding import at_landmarks, lip_loop
from preprocess.tracking.geometry.surface_extension import SurfaceExtension
from preprocess.tracking.head.generic_head import JOINT_NAMES, PARENTS, GenericHead

VERSION = "tracked-2"
NECK_UNIT = 0.01
"""Length of the neck per unit of the last expression axis, m."""
LID_GAP = 0.0022
"""Distance of a lid's margin from the eyeball, m."""
EYEBALL_RADIUS = 0.0120
"""Of the generic head, m."""
LID_CLOSURE_HEIGHT = 0.25
"""Where closed lids meet, from the lower (0) to the upper lid (1)."""
_SECOND_RING = (
    (topology.RIGHT_UPPER_LID[1:-1], (247, 30, 29, 27, 28, 56, 190)),
    (topology.RIGHT_LOWER_LID[1:-1], (25, 110, 24, 23, 22, 26, 112)),
    (topology.LEFT_UPPER_LID[1:-1], (467, 260, 259, 257, 258, 286, 414)),
    (topology.LEFT_LOWER_LID[1:-1], (255, 339, 254, 253, 252, 256, 341)),
)
_LID_PAIRS = ((topology.LEFT_UPPER_LID, topology.LEFT_LOWER_LID), (topology.RIGHT_UPPER_LID, topology.RIGHT_LOWER_LID))


@dataclass(frozen=True)
class PersonalShape:
    """The generic head in the subject's shape.

    Attributes:
        vertices: Template, m.
        joints: Joint positions, m.
        eyes: Centers of the left and the right eyeball, m.
        eye_radius: Of the eyeballs, m.
    """

    vertices: Float[np.ndarray, "V 3"]
    joints: Float[np.ndarray, "J 3"]
    eyes: Float[np.ndarray, "2 3"]
    eye_radius: float


def fit_shape(generic: GenericHead, neutral: Float[np.ndarray, "468 3"]) -> PersonalShape:
    """Deform the generic head so that its landmarks lie at the neutral ones.

    Eyeballs, ears, teeth and tongue are moved rigidly.

    Args:
        generic: Generic head.
        neutral: Landmarks of the neutral face, m.
    """
    scale, rotation, translation = similarity_transform(generic.landmarks @ generic.vertices, neutral)
    vertices = scale * generic.vertices @ rotation.T + translation
    joints = scale * generic.joints @ rotation.T + translation
    extension = SurfaceExtension(generic.soft, generic.landmarks, np.zeros(len(vertices)))
    moved = vertices + extension(neutral - generic.landmarks @ vertices)
    for name in ("left_ear", "right_ear"):
        rows = generic.regions[name]
        near = _nearest(vertices[generic.regions["skin"]], vertices[rows].mean(axis=0), 60)
        moved[rows] = vertices[rows] + (moved - vertices)[generic.regions["skin"][near]].mean(axis=0)
    lips = lip_loop(generic.head)
    inside = np.concatenate([generic.regions[name] for name in ("teeth", "tongue")])
    moved[inside] = vertices[inside] + (moved - vertices)[lips].mean(axis=0)
    moved[generic.regions["torso"]] = vertices[generic.regions["torso"]]
    radius = EYEBALL_RADIUS * scale
    eyes = np.zeros((2, 3))
    for index, side in enumerate(("left", "right")):
        rows = generic.regions[f"{side}_eyeball"]
        joint = JOINT_NAMES.index(f"{side}_eye")
        eyes[index] = _eye_center(moved[generic.regions[f"{side}_lid_margin"]], joints[joint], radius + LID_GAP)
        moved[rows] = vertices[rows] + eyes[index] - joints[joint]
        joints[joint] = eyes[index]
    return PersonalShape(moved, joints, eyes, float(radius))


def move_eyes(shape: PersonalShape, generic: GenericHead, eyes: Float[np.ndarray, "2 3"]) -> PersonalShape:
    """The shape with its eyeballs and their joints moved to the centers `eyes`, m."""
    vertices, joints = shape.vertices.copy(), shape.joints.copy()
    for index, side in enumerate(("left", "right")):
        vertices[generic.regions[f"{side}_eyeball"]] += eyes[index] - shape.eyes[index]
        joints[JOINT_NAMES.index(f"{side}_eye")] = eyes[index]
    return PersonalShape(vertices, joints, eyes, shape.eye_radius)


def similarity_transform(
    source: Float[np.ndarray, "N 3"], target: Float[np.ndarray, "N 3"]
) -> tuple[float, np.ndarray, np.ndarray]:
    """Least-squares scale, rotation and translation from one point set to another (Umeyama 1991)."""
    center_source, center_target = source.mean(axis=0), target.mean(axis=0)
    left, values, right = np.linalg.svd((target - center_target).T @ (source - center_source))
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = (left * signs) @ right
    scale = float((values * signs).sum() / ((source - center_source) ** 2).sum())
    return scale, rotation, center_target - scale * rotation @ center_source


def _nearest(points: np.ndarray, center: np.ndarray, count: int) -> np.ndarray:
    return np.argsort(((points - center) ** 2).sum(axis=1))[:count]


def _eye_center(margin: np.ndarray, start: np.ndarray, radius: float) -> np.ndarray:
    """Center of a sphere of known radius that touches a lid margin, with a prior at the generic eye's center."""
    center = start.copy()
    for _ in range(10):
        arms = center - margin
        distance = np.linalg.norm(arms, axis=1)
        jacobian = arms / distance[:, None]
        normal = jacobian.T @ jacobian + 0.05 * len(margin) * np.diag([1.0, 1.0, 0.2])
        prior = 0.05 * len(margin) * np.array([1.0, 1.0, 0.2]) * (start - center)
        center = center + np.linalg.solve(normal, jacobian.T @ (radius - distance) + prior)
    return center


def lid_axes(neutral: Float[np.ndarray, "468 3"], shape: PersonalShape) -> Float[np.ndarray, "468 3 2"]:
    """Displacement of the landmarks that closes the left and the right lid, m; margins meet on the eyeball."""
    axes = np.zeros((len(neutral), 3, 2))
    for side, (upper, lower) in enumerate(_LID_PAIRS):
        line = neutral[lower] + LID_CLOSURE_HEIGHT * (neutral[upper] - neutral[lower])
        center = shape.eyes[side]
        arms = line - center
        distance = 0.5 * np.linalg.norm(neutral[upper] - center, axis=1) + 0.5 * np.linalg.norm(
            neutral[lower] - center, axis=1
        )
        line = center + arms * (distance / np.linalg.norm(arms, axis=1))[:, None]
        for margin in (upper, lower):
            axes[margin[1:-1], :, side] = (line - neutral[margin])[1:-1]
    for margin, ring in _SECOND_RING:
        axes[list(ring)] = 0.5 * axes[margin]
    return axes


def assemble_head(
    generic: GenericHead,
    shape: PersonalShape,
    named: Float[np.ndarray, "468 3 A"],
    personal: Float[np.ndarray, "468 3 K"],
    lids: Float[np.ndarray, "468 3 2"],
) -> HeadModel:
    """Assemble the head model; its expression axes are the named ones, the personal ones, then the neck's length.

    Args:
        generic: The generic head.
        shape: The subject's shape.
        named: Displacement of the landmarks per unit of each named axis, m.
        personal: Displacement of the landmarks per unit of each of the subject's own axes, m.
        lids: Displacement of the landmarks that closes the left and the right lid, m.
    """
    anchor_weights = np.zeros(len(shape.vertices))
    for name in ("scalp", "ears", "neck", "shoulders", "torso"):
        anchor_weights[generic.regions[name]] = 10.0
    extend = SurfaceExtension(generic.soft, generic.landmarks, anchor_weights)
    count = named.shape[2]
    generic_axes = generic.axes[:, :, :count]
    learned = generic_axes + extend(named - at_landmarks(generic.landmarks, generic_axes))
    basis = np.concatenate((learned, extend(personal), _neck_axis(generic, shape)), axis=2)
    regions = generic.regions | {"landmarks": generic.embedding.corners.ravel()}
    return HeadModel(
        template=_tensor(shape.vertices),
        faces=torch.tensor(generic.faces, dtype=torch.int64),
        expression_basis=_tensor(basis),
        pose_basis=torch.zeros(len(basis), 3, 0),
        eyelid_basis=_tensor(extend(lids)),
        joint_regressor=_tensor(_joint_regressor(generic, shape)),
        skinning_weights=_tensor(generic.weights),
        parents=PARENTS,
        joint_names=JOINT_NAMES,
        version=VERSION,
        regions={name: torch.tensor(rows, dtype=torch.int64) for name, rows in regions.items()},
        uv=_tensor(generic.uv),
        landmark_weights=_tensor(generic.embedding.weights),
        expression_names=tracked_names(personal.shape[2]),
    )


def _neck_axis(generic: GenericHead, shape: PersonalShape) -> Float[np.ndarray, "V 3 1"]:
    """Displacement per unit of the neck's length: the torso moves along the neck, vertices between them in part.

    It is an expression axis because joints only rotate; without it, shoulders would follow every nod.
    """
    upper, lower = (shape.joints[JOINT_NAMES.index(name)] for name in ("cervical", "torso"))
    arm = lower - upper
    along = np.clip((shape.vertices - upper) @ arm / (arm @ arm), 0.0, 1.0)
    share = generic.weights[:, JOINT_NAMES.index("torso")] + generic.weights[:, JOINT_NAMES.index("cervical")] * along
    return (NECK_UNIT * share[:, None] * arm / np.linalg.norm(arm))[:, :, None]


def _joint_regressor(generic: GenericHead, shape: PersonalShape) -> np.ndarray:
    """Regressor that gives every joint exactly, from vertices that no expression moves.

    Weights are those nearest to a plain mean in least squares.
    """
    support = {
        "jaw": "ears",
        "left_eye": "left_eyeball",
        "right_eye": "right_eyeball",
        "neck": "ears",
        "cervical": "ears",
    }
    regressor = np.zeros((len(JOINT_NAMES), len(shape.vertices)))
    for joint, name in enumerate(JOINT_NAMES):
        rows = generic.regions[support.get(name, "torso")]
        mean = np.full(len(rows), 1 / len(rows))
        constraints = np.vstack((np.ones(len(rows)), shape.vertices[rows].T))
        missing = np.append(1.0, shape.joints[joint]) - constraints @ mean
        regressor[joint, rows] = mean + constraints.T @ np.linalg.solve(constraints @ constraints.T, missing)
    return regressor


def _tensor(values: np.ndarray) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float32)
