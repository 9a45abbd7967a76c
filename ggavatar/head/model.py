"""One linear-blend-skinned head model; FLAME, the procedural head and tracked heads differ in their arrays only."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field

import torch
from jaxtyping import Float, Int
from torch import Tensor

from ggavatar.core import Drive
from ggavatar.geometry.transforms import axis_angle_to_matrix, matrix_to_rotation_6d
from ggavatar.jit import device_kernels
from ggavatar.jit.constants import constant

POSED_BY = ("template", "expression_basis", "pose_basis", "eyelid_basis", "joint_regressor", "skinning_weights")
"""Arrays of a head that decide where its vertices are."""


@dataclass(frozen=True)
class HeadModel:
    """A head model with its identity folded into the template: the content of `head.npz` (docs/capture-format.md).

    Attributes:
        template: Neutral vertices, m; +Y up, face towards +Z, +X the subject's left.
        faces: Vertex indices, counter-clockwise from outside.
        expression_basis: Displacement per unit of each expression coefficient, m.
        pose_basis: Displacement per entry of vec(R_j − I), row-major, joints from 1 on in order, m; P is 0 or
            9·(J − 1).
        eyelid_basis: Displacement of the closed left and right eyelid, m, added after skinning (metrical-tracker).
        joint_regressor: Joint positions from shaped vertices.
        skinning_weights: Rows sum to 1.
        parents: Parent of every joint; −1 for the root, and a parent precedes its children.
        joint_names: For FLAME root, neck, jaw, left_eye, right_eye; further joints may follow.
        version: Tag of the parameter space ("flame2020", "flame2023", "procedural-1", …); coefficients of different
            tags are not interchangeable.
        regions: Named vertex sets, e.g. face, lips, mouth, eyes, scalp, ears, neck, shoulders; they may overlap.
        uv: Texture coordinates of every corner of every face in [0, 1], v upward.
        landmark_weights: Barycentric weights of landmarks; the region `landmarks` lists the corners of their triangles.
        expression_names: What each expression coefficient means (`ggavatar.head.expression_axes`); empty if unknown.
    """

    template: Float[Tensor, "V 3"]
    faces: Int[Tensor, "F 3"]
    expression_basis: Float[Tensor, "V 3 E"]
    pose_basis: Float[Tensor, "V 3 P"]
    eyelid_basis: Float[Tensor, "V 3 2"]
    joint_regressor: Float[Tensor, "J V"]
    skinning_weights: Float[Tensor, "V J"]
    parents: tuple[int, ...]
    joint_names: tuple[str, ...]
    version: str
    regions: Mapping[str, Int[Tensor, " R"]] = field(default_factory=dict)
    uv: Float[Tensor, "F 3 2"] | None = None
    landmark_weights: Float[Tensor, "L 3"] | None = None
    expression_names: tuple[str, ...] = ()

    def to(self, device: torch.device | str, dtype: torch.dtype | None = None) -> HeadModel:
        """The same head on another device and, for its floating-point arrays, in another dtype."""

        def moved(value: Tensor) -> Tensor:
            return value.to(device, dtype if value.is_floating_point() else None)

        changes: dict = {
            f.name: moved(getattr(self, f.name))
            for f in dataclasses.fields(self)
            if isinstance(getattr(self, f.name), Tensor)
        }
        changes["regions"] = {name: moved(rows) for name, rows in self.regions.items()}
        return dataclasses.replace(self, **changes)

    def joint_index(self, name: str) -> int:
        """Index of a joint by name; `ValueError` if the head has no such joint."""
        if name not in self.joint_names:
            raise ValueError(f"expected a joint of {self.joint_names}, got {name!r}")
        return self.joint_names.index(name)

    def neutral_drive(self) -> Drive:
        """The drive of the neutral head: all parameters zero, head pose the identity."""
        like = self.template
        return Drive(
            expression=like.new_zeros(self.expression_basis.shape[2]),
            joint_rotations=like.new_zeros(len(self.parents), 3),
            eyelids=like.new_zeros(2),
            translation=like.new_zeros(3),
            head_to_camera=torch.eye(4, dtype=like.dtype, device=like.device),
        )

    def neutral(self) -> Float[Tensor, "V 3"]:
        """Vertices with all facial parameters zero (docs/paper.md, A13), m."""
        return self.template

    def vertices(self, drive: Drive) -> Float[Tensor, "V 3"]:
        """Vertices of the posed head, m; differentiable in every field of `drive` and in every array of the head.

        The order is that of FLAME's published code: expression → joints → pose correctives → skinning → eyelids →
        translation. Joints are regressed from the template with expressions, where the paper (Li et al. 2017, Eq. 1–4)
        has them depend on the identity alone. Eyelid displacements rotate with the neck, so that they stay rigid with
        the head; with an unrotated neck this equals metrical-tracker's addition after skinning.
        """
        if self._has_kernels_for(drive):
            from ggavatar.head import posing_triton

            return posing_triton.vertices(self, drive)
        shaped = self.template + (self.expression_basis.flatten(0, 1) @ drive.expression).view_as(self.template)
        joints = self.joint_regressor @ shaped
        rotations = axis_angle_to_matrix(drive.joint_rotations)
        if self.pose_basis.shape[2]:
            identity = torch.eye(3, dtype=rotations.dtype, device=rotations.device)
            feature = (rotations[1:] - identity).flatten()
            shaped = shaped + (self.pose_basis.flatten(0, 1) @ feature).view_as(shaped)
        linear, offset = self._joint_transforms(rotations, joints)
        blend = self.skinning_weights
        matrices = (blend @ linear.flatten(1)).view(-1, 3, 3)
        posed = (matrices @ shaped[:, :, None]).squeeze(-1) + blend @ offset
        lids = (self.eyelid_basis.flatten(0, 1) @ drive.eyelids).view_as(posed)
        return posed + lids @ linear[self.lid_carrier].T + drive.translation

    @property
    def lid_carrier(self) -> int:
        """The joint that eyelid displacements rotate with."""
        return self.joint_index("neck") if "neck" in self.joint_names else 0

    @property
    def moving_joints(self) -> tuple[int, ...]:
        """The joints that move the face: all but root and neck."""
        return tuple(index for index, name in enumerate(self.joint_names) if name not in ("root", "neck"))

    def _has_kernels_for(self, drive: Drive) -> bool:
        """Whether kernels pose the head: on CUDA, where nobody asks for a gradient."""
        tensors = (*(getattr(self, name) for name in POSED_BY), drive.expression, drive.joint_rotations)
        tensors = (*tensors, drive.eyelids, drive.translation)
        if not device_kernels.run_on(*tensors):
            return False
        wants_gradient = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors)
        return not wants_gradient and all(tensor.is_contiguous() for tensor in tensors)

    def joint_transforms(self, drive: Drive) -> tuple[Float[Tensor, "J 3 3"], Float[Tensor, "J 3"]]:
        """Rotation and offset (m) of every joint: x ↦ R x + o transforms a vertex that is bound to this joint alone."""
        shaped = self.template + (self.expression_basis.flatten(0, 1) @ drive.expression).view_as(self.template)
        return self._joint_transforms(axis_angle_to_matrix(drive.joint_rotations), self.joint_regressor @ shaped)

    def _joint_transforms(self, rotations: Tensor, joints: Tensor) -> tuple[Tensor, Tensor]:
        """World rotation [J, 3, 3] and offset [J, 3] of every joint."""
        linear: list[Tensor] = []
        position: list[Tensor] = []
        for index, parent in enumerate(self.parents):
            if parent < 0:
                linear.append(rotations[index])
                position.append(joints[index])
            else:
                linear.append(linear[parent] @ rotations[index])
                position.append(position[parent] + linear[parent] @ (joints[index] - joints[parent]))
        stacked = torch.stack(linear)
        return stacked, torch.stack(position) - (stacked @ joints[:, :, None]).squeeze(-1)

    def condition(self, drive: Drive) -> Float[Tensor, " C"]:
        """ψ and θ as one vector: expression, every joint but root and neck as 6D rotation, eyelids.

        FLAME with 100 expressions gives the 120 numbers of metrical-tracker and FlashAvatar (docs/paper.md, A12). The
        rigid pose is not included.
        """
        if self._has_kernels_for(drive):
            from ggavatar.head import posing_triton

            return posing_triton.condition(self, drive)
        chosen = constant(self.moving_joints, torch.int64, drive.joint_rotations.device)
        rotations = matrix_to_rotation_6d(axis_angle_to_matrix(drive.joint_rotations[chosen]))
        return torch.cat((drive.expression, rotations.flatten(), drive.eyelids))
