"""A toy run for tests of rendering and scoring: a capture of a few small frames and an avatar of two Gaussians."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from ggavatar.core import Camera, Drive, Frame, Gaussians, Rendering
from ggavatar.data.capture import Capture, Tracking
from ggavatar.data.frames import Frames
from ggavatar.data.splits import Split
from ggavatar.geometry.transforms import look_at
from ggavatar.head.model import HeadModel
from ggavatar.render.reference import rasterize
from ggavatar.training.run_folder import Run, RunConfig

WIDTH, HEIGHT, COUNT = 32, 24, 6
JOINTS = ("root", "neck", "jaw", "left_eye", "right_eye")


def head() -> HeadModel:
    """A tetrahedron of 0.2 m with three expressions that shift it along the axes."""
    template = torch.tensor([[-0.1, -0.1, 0.0], [0.1, -0.1, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]])
    weights = torch.zeros(4, 5)
    weights[:, 1] = 1.0
    return HeadModel(
        template=template,
        faces=torch.tensor([[0, 1, 3], [1, 2, 3], [2, 0, 3]]),
        expression_basis=0.05 * torch.eye(3).expand(4, 3, 3),
        pose_basis=torch.zeros(4, 3, 0),
        eyelid_basis=torch.zeros(4, 3, 2),
        joint_regressor=torch.full((5, 4), 0.25),
        skinning_weights=weights,
        parents=(-1, 0, 1, 1, 1),
        joint_names=JOINTS,
        version="toy-1",
    )


class ToyAvatar(nn.Module):
    """One red and one blue Gaussian that move with the head."""

    def __init__(self, model: HeadModel) -> None:
        super().__init__()
        self.head = model
        self.colors = nn.Parameter(torch.tensor([[0.9, 0.1, 0.1], [0.1, 0.1, 0.9]]))

    def gaussians(self, drive: Drive) -> Gaussians:
        """Two spheres of 3 cm at the first and the third vertex."""
        means = self.head.vertices(drive)[[0, 2]]
        quats = torch.tensor([[1.0, 0, 0, 0]]).expand(2, 4)
        return Gaussians(means, quats, torch.full((2, 3), 0.03), torch.full((2,), 0.9), self.colors)

    def losses(self, frame: Frame, rendering: Rendering, step: int) -> dict[str, Tensor]:
        """Not needed for rendering."""
        return {}

    def optimizers(self) -> list[torch.optim.Optimizer]:
        """Not needed for rendering."""
        return []

    def after_backward(self, rendering: Rendering, step: int) -> None:
        """Not needed for rendering."""


def camera() -> Camera:
    """A camera one meter in front of the head, which covers a third of the image width."""
    intrinsics = torch.tensor([[50.0, 0, WIDTH / 2], [0, 50.0, HEIGHT / 2], [0, 0, 1]])
    view = look_at(torch.tensor([0.0, 0.0, 1.0]), torch.zeros(3), torch.tensor([0.0, 1.0, 0.0]))
    return Camera(intrinsics, view, WIDTH, HEIGHT)


def tracking(seed: int = 0, count: int = COUNT) -> Tracking:
    """A tracking that starts at the neutral frame."""
    random = np.random.default_rng(seed)
    phase = np.linspace(0, 3, count)[:, None]
    expression = np.sin(phase * random.uniform(0.5, 1.5, (1, 3)))
    joints = np.zeros((count, 5, 3))
    joints[:, 2, 0] = 0.2 * np.abs(np.sin(2 * phase[:, 0]))
    view = camera()
    return Tracking(
        intrinsics=np.repeat(view.intrinsics.double().numpy()[None], count, 0),
        world_to_camera=np.repeat(view.world_to_camera.double().numpy()[None], count, 0),
        expression=expression,
        joint_rotations=joints,
        eyelids=np.zeros((count, 2)),
        translation=np.zeros((count, 3)),
    )


def write_capture(folder: Path, seed: int = 0, version: str = "toy-1") -> Capture:
    """A capture whose frames 10, 11, … show noise, with a mask that is soft in the middle column."""
    random = np.random.default_rng(seed)
    frames = tuple(range(10, 10 + COUNT))
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[:, : WIDTH // 2] = 255
    mask[:, WIDTH // 2] = 100
    model = head()
    arrays: dict[str, Any] = {name: value.numpy() for name, value in vars(model).items() if isinstance(value, Tensor)}
    arrays |= {"parents": np.array(model.parents), "joint_names": np.array(JOINTS), "version": np.array(version)}
    capture = Capture(
        folder=folder, subject="toy", width=WIDTH, height=HEIGHT, fps=25.0, frames=frames,
        splits={"every-20th": Split(frames[1:-1], (frames[0], frames[-1]))},
        tracking=tracking(seed), head_version=version,
    )  # fmt: skip
    images = ((random.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8), mask) for _ in frames)
    capture.write(images, arrays)
    return Capture.open(folder)


def toy_run(folder: Path) -> Run:
    """A run in `folder/run` with its capture in `folder/capture`."""
    capture = write_capture(folder / "capture")
    (folder / "run").mkdir(parents=True)
    white = torch.ones(3)
    return Run(
        folder=folder / "run", method="toy", avatar=ToyAvatar(head()), capture=capture, head=head(),
        split=capture.splits["every-20th"], background=white, rasterize=rasterize,
        config=RunConfig("toy", str(capture.folder)), provenance={}, step=7, sha256="00",
        reader=Frames(capture, head(), white, "cpu"),
    )  # fmt: skip
