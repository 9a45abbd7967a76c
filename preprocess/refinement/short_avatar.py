"""A stiff avatar, trained for a minute: Gaussians on the tracked mesh, without networks that explain errors away.

It is the paper's method without its adjuster. Whatever its Gaussians cannot follow on the mesh shows in the pictures,
and that is what corrects the tracking.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from ggavatar.core import Camera, Drive, Frame, Rendering
from ggavatar.data.capture import Tracking
from ggavatar.data.scene import Scene
from ggavatar.head.model import HeadModel
from ggavatar.losses.terms import log_scale_regularizer, position_regularizer
from ggavatar.methods import ggavatar
from ggavatar.optim.seeding import seeded
from ggavatar.render.backends import pick
from preprocess.refinement.drawing import Leaves, camera_of, drive_of
from preprocess.refinement.objective import misfit, total_weight
from preprocess.refinement.pictures import Pictures

SAMPLES = 16
"""Pictures that initial colors are read from."""
SEED = 42
CONFIG = ggavatar.Config(
    **{
        **ggavatar.SHORT_TRAINING,
        "initialization": False,
        "adjuster": False,
        "pose_on": "neck",
        "perceptual_weight": 0.0,
        "density_start": 120_000,
    }
)
"""One Gaussian for each triangle of the tracked mesh, which its torso does not leave; no networks."""


@dataclass(frozen=True)
class EpochResult:
    """What one pass over the pictures found.

    Attributes:
        misfit: Mean of `objective.misfit` before each step.
        gradients: Of the misfit with respect to the arrays of the tracking, by name; zero in rows without a picture.
    """

    misfit: float
    gradients: dict[str, np.ndarray]


class ShortAvatar:
    """The avatar in training, and the drawing of tracked frames.

    Attributes:
        head: The head model.
        pictures: That it is trained on.
        avatar: The Gaussians.
    """

    def __init__(self, head: HeadModel, tracking: Tracking, pictures: Pictures, steps: int) -> None:
        """The avatar before its first step.

        Args:
            head: The head model that the tracking belongs to.
            tracking: As tracked.
            pictures: To train on.
            steps: Length of the whole training.
        """
        self.head, self.pictures = head, pictures
        self._rasterize, self._background = pick("cpu"), torch.ones(3)
        posed = [self._posed(tracking, row, None) for row in pictures.rows]
        chosen = np.unique(np.linspace(0, len(posed) - 1, SAMPLES).round().astype(int)).tolist()
        scene = Scene(
            head=head,
            drives=tuple(drive for drive, _ in posed),
            cameras=tuple(camera for _, camera in posed),
            background=self._background,
            steps=steps,
            seed=SEED,
            max_gaussians=len(head.faces),
            samples=tuple(self._sample(posed[place], place) for place in chosen),
            rasterize=self._rasterize,
        )
        self.avatar = ggavatar.build(CONFIG, scene)
        self._epochs = self._steps = 0

    def draw(self, tracking: Tracking, row: int, leaves: Leaves | None = None) -> Rendering:
        """The rendering of a row of a tracking; differentiable in its `leaves`, if they are given."""
        drive, camera = self._posed(tracking, row, leaves)
        return self._rasterize(self.avatar.gaussians(drive), camera, self._background)

    def epoch(self, tracking: Tracking, with_gradients: bool) -> EpochResult:
        """Train on every picture once, in random order, with the tracking as it is.

        Args:
            tracking: Of all frames.
            with_gradients: Also collect the gradients with respect to the tracking, at twice the cost.
        """
        order = torch.randperm(len(self.pictures.rows), generator=seeded(SEED, 1, self._epochs)).tolist()
        self._epochs += 1
        self.avatar.train()
        sums = {name: np.zeros(array.shape) for name, array in Leaves.arrays(tracking).items()}
        total = 0.0
        for place in order:
            row = self.pictures.rows[place]
            leaves = Leaves.of(tracking, row, wanted=with_gradients)
            total += self._step(self.draw(tracking, row, leaves), place)
            if with_gradients:
                for name, gradient in leaves.gradients().items():
                    sums[name][row] = gradient
        return EpochResult(total / len(order), sums)

    def _step(self, rendering: Rendering, place: int) -> float:
        """One update of the Gaussians from the rendering of a picture; returns the misfit."""
        avatar, rows = self.avatar, self.avatar.rows
        colors, coverage, weights = self.pictures.picture(place)
        difference = misfit(rendering, colors, coverage, weights)
        visible, scale = rendering.radii > 0, total_weight(weights)
        position = position_regularizer(rows["means"], visible, CONFIG.position_threshold)
        size = log_scale_regularizer(rows["log_scales"], visible, CONFIG.scale_threshold)
        (difference + scale * (CONFIG.position_weight * position + CONFIG.scale_weight * size)).backward()
        self._steps += 1
        for optimizer in avatar.optimizers():
            optimizer.step()
        avatar.after_backward(rendering, self._steps)
        for optimizer in avatar.optimizers():
            optimizer.zero_grad(set_to_none=True)
        return float(difference.item())

    def _sample(self, posed: tuple[Drive, Camera], place: int) -> Frame:
        colors, coverage, _ = self.pictures.picture(place)
        return Frame(posed[0], posed[1], colors, coverage)

    def _posed(self, tracking: Tracking, row: int, leaves: Leaves | None) -> tuple[Drive, Camera]:
        values = leaves or Leaves.of(tracking, row, wanted=False)
        camera = camera_of(tracking, row, values, self.pictures.full_size, self.pictures.size)
        return drive_of(self.head, tracking, row, values), camera
