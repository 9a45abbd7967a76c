"""The skinned head against a per-vertex loop written from Li et al. 2017, and against what must not change."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from scipy.spatial.transform import Rotation

from ggavatar.core import Drive
from ggavatar.head.model import HeadModel

VERTICES, EXPRESSIONS = 40, 6
NAMES, PARENTS = ("root", "neck", "jaw", "left_eye", "right_eye"), (-1, 0, 1, 1, 1)


def random_head(pose_correctives: bool = True) -> HeadModel:
    generator = torch.Generator().manual_seed(3)

    def draw(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    return HeadModel(
        template=draw(VERTICES, 3) * 0.1,
        faces=torch.randint(0, VERTICES, (60, 3), generator=generator),
        expression_basis=draw(VERTICES, 3, EXPRESSIONS) * 0.01,
        pose_basis=draw(VERTICES, 3, 36 if pose_correctives else 0) * 0.01,
        eyelid_basis=draw(VERTICES, 3, 2) * 0.01,
        joint_regressor=draw(5, VERTICES).softmax(-1),
        skinning_weights=draw(VERTICES, 5).softmax(-1),
        parents=PARENTS,
        joint_names=NAMES,
        version="random",
    )


def random_drive(scale: float = 1.0) -> Drive:
    generator = torch.Generator().manual_seed(4)

    def draw(*shape: int) -> torch.Tensor:
        return scale * torch.randn(*shape, generator=generator, dtype=torch.float64)

    return Drive(draw(EXPRESSIONS), 0.4 * draw(5, 3), draw(2).abs(), 0.1 * draw(3), torch.eye(4, dtype=torch.float64))


def skin_by_loops(head: HeadModel, drive: Drive) -> torch.Tensor:
    """Linear blend skinning with 4×4 matrices, vertex by vertex."""
    shaped = torch.stack([head.template[v] + head.expression_basis[v] @ drive.expression for v in range(VERTICES)])
    joints = torch.stack([sum(head.joint_regressor[j, v] * shaped[v] for v in range(VERTICES)) for j in range(5)])
    turns = [torch.from_numpy(Rotation.from_rotvec(axis.numpy()).as_matrix()) for axis in drive.joint_rotations]
    if head.pose_basis.shape[2]:
        feature = torch.cat([(turn - torch.eye(3)).reshape(-1) for turn in turns[1:]])
        shaped = torch.stack([shaped[v] + head.pose_basis[v] @ feature for v in range(VERTICES)])
    world: list[torch.Tensor] = []
    for j, parent in enumerate(PARENTS):
        local = torch.eye(4, dtype=torch.float64)
        local[:3, :3] = turns[j]
        local[:3, 3] = joints[j] - (joints[parent] if parent >= 0 else 0)
        world.append(local if parent < 0 else world[parent] @ local)
    posed = []
    for v in range(VERTICES):
        moved = torch.zeros(3, dtype=torch.float64)
        for j in range(5):
            at_rest = torch.cat((shaped[v] - joints[j], torch.ones(1, dtype=torch.float64)))
            moved += head.skinning_weights[v, j] * (world[j] @ at_rest)[:3]
        lids = head.eyelid_basis[v] @ drive.eyelids
        posed.append(moved + world[1][:3, :3] @ lids + drive.translation)
    return torch.stack(posed)


@pytest.mark.parametrize("pose_correctives", [True, False])
def test_vertices_against_loops(pose_correctives: bool) -> None:
    head, drive = random_head(pose_correctives), random_drive()
    assert torch.allclose(head.vertices(drive), skin_by_loops(head, drive), atol=1e-12)


def test_neutral_drive_gives_the_template() -> None:
    head = random_head()
    assert torch.allclose(head.vertices(head.neutral_drive()), head.neutral(), atol=1e-12)


def test_rigid_root_motion_moves_all_vertices_alike() -> None:
    head, drive = random_head(pose_correctives=False), random_drive()
    still = dataclasses.replace(drive, joint_rotations=drive.joint_rotations.index_fill(0, torch.tensor([0]), 0.0))
    before, after = head.vertices(still) - still.translation, head.vertices(drive) - drive.translation
    apart = [(points[:, None] - points[None]).norm(dim=-1) for points in (before, after)]
    assert torch.allclose(apart[0], apart[1], atol=1e-12) and not torch.allclose(before, after, atol=1e-3)


def test_condition_is_neutral_at_the_neutral_drive() -> None:
    """Expression, jaw and two eyes in 6D, lids: 120 for FLAME with 100 expressions (A12)."""
    head = random_head()
    condition = head.condition(head.neutral_drive())
    identity = [1.0, 0, 0, 0, 1, 0]
    assert condition.tolist() == [0.0] * EXPRESSIONS + identity * 3 + [0.0, 0.0]
    assert len(condition) - EXPRESSIONS + 100 == 120


def test_condition_holds_expression_rotations_and_lids() -> None:
    """With scipy's rotations, whose first two rows are the 6D of PyTorch3D."""
    head, drive = random_head(), random_drive()
    turns = [Rotation.from_rotvec(axis.numpy()).as_matrix()[:2].ravel() for axis in drive.joint_rotations[2:]]
    parts = [drive.expression, *(torch.from_numpy(turn) for turn in turns), drive.eyelids]
    assert torch.allclose(head.condition(drive), torch.cat(parts), atol=1e-12)


def test_condition_ignores_rigid_pose() -> None:
    head, drive = random_head(), random_drive()
    turned = dataclasses.replace(
        drive, joint_rotations=drive.joint_rotations + torch.tensor([[1.0], [1], [0], [0], [0]])
    )
    assert torch.equal(head.condition(drive), head.condition(turned))


def test_gradients_reach_the_drive() -> None:
    head, drive = random_head(), random_drive(0.5)

    def vertices(expression: torch.Tensor, rotations: torch.Tensor, lids: torch.Tensor) -> torch.Tensor:
        return head.vertices(dataclasses.replace(drive, expression=expression, joint_rotations=rotations, eyelids=lids))

    inputs = tuple(value.clone().requires_grad_() for value in (drive.expression, drive.joint_rotations, drive.eyelids))
    assert torch.autograd.gradcheck(vertices, inputs)


def test_moving_to_another_dtype_keeps_integers() -> None:
    head = random_head().to("cpu", torch.float32)
    assert head.template.dtype == torch.float32 and head.faces.dtype == torch.int64


def test_unknown_joint_names_those_there() -> None:
    with pytest.raises(ValueError, match="left_eye"):
        random_head().joint_index("tail")
