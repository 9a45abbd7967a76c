"""Avatars with random parameters in place of a training, heads with everything a head can have, and runs of them."""

from __future__ import annotations

import dataclasses
from typing import Any

import torch

from ggavatar.core import Drive
from ggavatar.data.capture import Capture
from ggavatar.geometry.transforms import axis_angle_to_matrix, rigid
from ggavatar.head.files import load_head
from ggavatar.head.model import HeadModel
from ggavatar.render.reference import rasterize
from ggavatar.training.plan import TrainingPlan
from ggavatar.training.registry import load
from ggavatar.training.run_folder import Run, RunConfig, make_scene


def untrained(method: str, capture: Capture, steps_done: int, **settings: Any) -> Any:
    """An avatar with random offsets, colors and rotations, as if after some steps."""
    chosen = load(method)
    config = RunConfig(method, str(capture.folder), training=TrainingPlan(steps=100))
    scene, reader = make_scene(config, capture, capture.splits["every-20th"], "cpu")
    values = chosen.config("default", [f"{name}={value}" for name, value in settings.items()])
    avatar = chosen.build(values, scene).eval()
    generator = torch.Generator().manual_seed(3)
    with torch.no_grad():
        for name, value in avatar.named_parameters():
            scale = 0.02 if "last_" in name else 0.1
            if "field" not in name:
                value += scale * torch.randn(value.shape, generator=generator)
        for name, buffer in avatar.named_buffers():
            if name.endswith("steps_done"):
                buffer.fill_(steps_done)
    return avatar, reader


def with_everything(head: HeadModel, seed: int = 5) -> HeadModel:
    """The head with pose correctives, lids, a root that holds a part of it, and two more joints (7 in all)."""
    random = torch.Generator().manual_seed(seed)
    count = len(head.template)
    weights = torch.rand(count, 7, generator=random) ** 3
    return dataclasses.replace(
        head,
        pose_basis=2e-3 * torch.randn(count, 3, 54, generator=random),
        eyelid_basis=1e-2 * torch.randn(count, 3, 2, generator=random),
        joint_regressor=torch.softmax(3 * torch.rand(7, count, generator=random), 1),
        skinning_weights=weights / weights.sum(1, keepdim=True),
        parents=(-1, 0, 1, 1, 1, 0, 5),
        joint_names=(*head.joint_names, "cervical", "torso"),
    )


def random_drives(head: HeadModel, count: int, root_still: bool) -> list[Drive]:
    random = torch.Generator().manual_seed(9)

    def numbers(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=random)

    drives = []
    for _ in range(count):
        joints = 0.3 * numbers(len(head.parents), 3)
        if root_still:
            joints[:2] = 0
        pose = rigid(axis_angle_to_matrix(0.4 * numbers(3)), 0.1 * numbers(3) + torch.tensor([0, 0, 1.0]))
        torso = rigid(axis_angle_to_matrix(0.4 * numbers(3)), 0.1 * numbers(3) + torch.tensor([0, 0, 1.0]))
        drives.append(
            Drive(numbers(head.expression_basis.shape[2]), joints, numbers(2), 0.05 * numbers(3), pose, None, torso)
        )
    return drives


def run_of(avatar: Any, reader: Any, capture: Capture) -> Run:
    """A run that was never trained."""
    return Run(
        folder=capture.folder, method="any", avatar=avatar, capture=capture, head=load_head(capture.head_path),
        split=capture.splits["every-20th"],
        background=torch.ones(3), rasterize=rasterize, config=RunConfig("any", str(capture.folder)), provenance={},
        step=1, sha256="00", reader=reader,
    )  # fmt: skip
