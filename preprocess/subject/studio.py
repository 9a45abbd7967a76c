"""Draws one frame of an embedded subject."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy import ndarray

from ggavatar.head.procedural import procedural_head
from preprocess.subject import room
from preprocess.subject.mesh_renderer import project, rasterize, vertex_normals
from preprocess.subject.motion import Motion


class Studio:
    """A person, a performance and a camera; `draw` may be called from several threads."""

    def __init__(self, identity: int, motion: Motion, size: int, background: str) -> None:
        self.identity = np.zeros(22)
        self.head = procedural_head(self.identity)
        self._motion, self._size = motion, size
        self._faces = self.head.faces.numpy()
        colors = np.full((len(self.head.template), 3), (0.82, 0.66, 0.58))
        for name, color in (("lips", (0.75, 0.45, 0.44)), ("teeth", (0.92, 0.9, 0.86)), ("tongue", (0.7, 0.35, 0.35)), ("mouth_bag", (0.35, 0.12, 0.12))):
            colors[self.head.regions[name]] = color
        colors[self.head.regions["scalp"]] = (0.2, 0.13, 0.1)
        for name in ("left_eyeball", "right_eyeball"):
            rows = self.head.regions[name]
            depth = (self.head.template[rows] - self.head.template[rows].mean(0))[:, 2]
            colors[rows] = 0.95
            colors[rows[depth > 0.0107]] = (0.2, 0.3, 0.4)
        self._colors = colors

    def vertices(self, index: int) -> Float[ndarray, "V 3"]:
        """Tracked vertices in head space, m."""
        motion = self._motion
        drive = self.head.neutral_drive()
        rotations = torch.zeros(5, 3)
        rotations[2] = torch.from_numpy(motion.jaw[index])
        rotations[3:] = torch.from_numpy(motion.eyes[index])
        drive = dataclasses.replace(
            drive,
            expression=torch.from_numpy(motion.expression[index]).float(),
            joint_rotations=rotations,
            eyelids=torch.from_numpy(motion.eyelids[index]).float(),
        )
        return self.head.vertices(drive).numpy().astype(np.float64)

    def draw(self, index: int) -> tuple[UInt8[ndarray, "H W 3"], Float[ndarray, "H W"]]:
        """The frame on its background, 8 bit sRGB, and the coverage of the person."""
        size, pose = self._size, self._motion.head_to_room[index]
        points = self.vertices(index) @ pose[:3, :3].T + pose[:3, 3]
        seen = rasterize(project(points, room.intrinsics(2 * size), room.room_to_camera()), self._faces, 2 * size, 2 * size)
        normals = vertex_normals(points, self._faces)
        light = np.clip(normals @ (0.5, 0.6, 0.62), 0, 1)[:, None] * 0.8 + 0.25
        shaded = np.clip(self._colors * light, 0, 1)
        corners = self._faces[np.maximum(seen.face, 0)]
        weights = np.concatenate((1 - seen.weights.sum(-1, keepdims=True), seen.weights), axis=-1)
        color = np.einsum("hwk,hwkc->hwc", weights, shaded[corners])
        alpha = (seen.face >= 0).astype(float)
        image = np.where(alpha[..., None] > 0, color, (0.62, 0.66, 0.68))
        image = image.reshape(size, 2, size, 2, 3).mean(axis=(1, 3))
        return np.round(image * 255).astype(np.uint8), alpha.reshape(size, 2, size, 2).mean(axis=(1, 3))
