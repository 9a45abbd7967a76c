"""A few smooth corrections of a tracked head's depth, which no landmark tells and which all poses depend on.

A face that is too flat, or leans, in the model makes a tracker turn it too much, or about a leaning axis: the pictures
fit nearly as well, and poses alone leave such a valley only slowly. Here depth moves together with the poses that keep
the projected face where it is.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int

from ggavatar.data.capture import Tracking
from ggavatar.geometry.transforms import skew
from ggavatar.head.model import HeadModel
from preprocess.refinement.corrections import Block
from preprocess.refinement.rigid_steps import RIGID
from preprocess.tracking.head.personal_head import VERSION
from preprocess.tracking.head.silhouette_fit import vertex_normals
from preprocess.tracking.torso.torso import FACE_DEPTH

RADIUS = 0.08
"""Length on which the corrections vary, m."""
UNIT = 0.002
"""Change of depth at that distance from the center, m."""
PRIOR = 2.0
"""Standard deviation of a correction, in units."""
POINTS = 400
"""Vertices of the face that stand for it."""


@dataclass(frozen=True)
class ShapeModes:
    """Corrections of depth: shears, scale and curvatures.

    Attributes:
        modes: Displacement of the template per unit, m.
        points: Vertices of the face.
        normals: Of the template at these points.
    """

    modes: Float[np.ndarray, "G V 3"]
    points: Int[np.ndarray, " N"]
    normals: Float[np.ndarray, "N 3"]

    @staticmethod
    def of(head: HeadModel) -> ShapeModes | None:
        """The corrections of a head that our tracker made; None for another, whose shape is what its file says."""
        return depth_modes(head) if head.version == VERSION else None

    def head(self, head: HeadModel, values: Float[np.ndarray, " G"]) -> HeadModel:
        """The head with its template corrected."""
        change = np.einsum("g,gvx->vx", values, self.modes)
        return dataclasses.replace(head, template=head.template + torch.from_numpy(change).to(head.template))

    def pulled_back(self, gradient: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, " G"]:
        """Gradient with respect to the corrections from that with respect to the template."""
        return np.einsum("gvx,vx->g", self.modes, gradient)


def depth_modes(head: HeadModel) -> ShapeModes:
    """Depth that changes with x, y, z, x², xy and y² about the middle of the face; the torso keeps its shape."""
    template = head.template.double().numpy()
    torso = np.zeros(len(template))
    for name in ("root", "torso", "cervical"):
        if name in head.joint_names:
            torso += head.skinning_weights[:, head.joint_index(name)].double().numpy()
    depth = np.where(torso < 0.01, template[:, 2], -np.inf)
    front = np.flatnonzero(depth > depth.max() - FACE_DEPTH)
    x, y, z = ((template - template[front].mean(axis=0)) / RADIUS).clip(-2, 2).T
    amounts = np.stack((x, y, z, x * x, x * y, y * y))
    amounts[3:] -= amounts[3:, front].mean(axis=1, keepdims=True)
    modes = np.zeros((len(amounts), *template.shape))
    modes[:, :, 2] = UNIT * amounts * np.clip(1 - torso, 0, 1)
    points = front[:: max(1, len(front) // POINTS)]
    return ShapeModes(modes, points, vertex_normals(template, head.faces.numpy())[points])


@dataclass(frozen=True)
class Compensation:
    """How poses follow the shape so that the projected face stays.

    Attributes:
        poses: Head steps of every frame per unit of shape, in the units of the head's block.
        information: That remains about the shape once poses follow it, by frame, times an unknown factor.
        scale: That factor's inverse: information of a pose as counted by `information`, across the image.
    """

    poses: Float[np.ndarray, "T 6 G"]
    information: Float[np.ndarray, "T G G"]
    scale: float


def compensation(modes: ShapeModes, head: HeadModel, tracking: Tracking, block: Block) -> Compensation:
    """Least squares on the projected points of the face, each as far as it is seen from the front."""
    points = head.template.double().numpy()[modes.points]
    turns, shifts = tracking.world_to_camera[:, :3, :3], tracking.world_to_camera[:, :3, 3]
    seen = points @ turns.transpose(0, 2, 1) + shifts[:, None]
    focal = tracking.intrinsics[:, 0, 0]
    projected = np.zeros((*seen.shape[:2], 2, 3))
    projected[..., 0, 0] = projected[..., 1, 1] = focal[:, None] / seen[..., 2]
    projected[..., 2] = -projected[..., 0, :1] * seen[..., :2] / seen[..., 2:]
    by_head = projected @ turns[:, None]
    arms = skew(torch.from_numpy(points)).numpy()
    by_pose = np.concatenate((-by_head @ arms, projected), axis=-1) * np.asarray(block.units)
    by_shape = np.einsum("tnij,gnj->tnig", by_head, modes.modes[:, modes.points])
    facing = -np.einsum("tij,nj,tni->tn", turns, modes.normals, seen) / np.linalg.norm(seen, axis=-1)
    weights = np.maximum(facing, 0.0)[..., None, None]
    pose = np.einsum("tnia,tnib->tab", weights * by_pose, by_pose)
    cross = np.einsum("tnia,tnig->tag", weights * by_pose, by_shape)
    shape = np.einsum("tnig,tnih->tgh", weights * by_shape, by_shape)
    ridge = 1e-4 * np.trace(pose, axis1=1, axis2=2)[:, None, None] / RIGID * np.eye(RIGID)
    follow = -np.linalg.solve(pose + ridge, cross)
    left = shape + cross.transpose(0, 2, 1) @ follow
    return Compensation(follow, left, float((pose[:, 3, 3] + pose[:, 4, 4]).mean()))


def shape_step(
    found: Compensation,
    values: Float[np.ndarray, " G"],
    gradient: Float[np.ndarray, " G"],
    pose_gradient: Float[np.ndarray, "T 6"],
    pose_information: Float[np.ndarray, "6 6"],
    rows: Sequence[int],
) -> tuple[Float[np.ndarray, " G"], Float[np.ndarray, "T 6"]]:
    """The Newton step of the shape along the valley, and the head steps that go with it.

    Args:
        found: How poses follow.
        values: Shape corrections now.
        gradient: Of the misfit with respect to them.
        pose_gradient: Of the misfit with respect to the head steps.
        pose_information: Mean information of a picture about the head steps; it gives the pictures' scale.
        rows: Frames with a picture.
    """
    picked = list(rows)
    along = gradient + np.einsum("tag,ta->g", found.poses[picked], pose_gradient[picked])
    factor = (pose_information[3, 3] + pose_information[4, 4]) / found.scale
    curvature = factor * found.information[picked].sum(axis=0) + np.eye(len(values)) / PRIOR**2
    step = -np.linalg.solve(curvature, along + values / PRIOR**2)
    return step, found.poses @ step
