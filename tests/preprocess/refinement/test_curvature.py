"""Information of pictures against the closed form of a drawing that is linear in the corrections."""

from __future__ import annotations

import numpy as np
import torch

from ggavatar.core import Rendering
from preprocess.refinement.corrections import Corrections
from preprocess.refinement.curvature import mean_information
from preprocess.refinement.objective import CORRELATED, NOISE
from preprocess.refinement.pictures import Pictures
from preprocess.refinement.short_avatar import ShortAvatar


class Shift(Corrections):
    """Two corrections that add to x and y of the head's translation in the camera."""

    count = 2

    def __init__(self):
        """Nothing that other corrections need."""

    def at(self, row):
        return self

    def moved(self, tracking, values):
        views = tracking.world_to_camera.copy()
        views[:, :2, 3] += values
        return type(tracking)(**{**tracking.arrays(), "world_to_camera": views})


class LinearDrawing(ShortAvatar):
    """Colors are 0.5 + 0.002 · (a x + b y) for patterns a and b of the pixels."""

    def __init__(self, pictures, patterns):
        self.pictures, self.patterns = pictures, patterns

    def draw(self, tracking, row, leaves=None):
        x, y = tracking.world_to_camera[row, :2, 3]
        color = 0.5 + 0.002 * (self.patterns[0] * x + self.patterns[1] * y)
        image = torch.tensor(color, dtype=torch.float32)[..., None].expand(-1, -1, 3)
        return Rendering(image, torch.ones(4, 4, 1), torch.zeros(4, 4, 1), torch.zeros(0, 2), torch.zeros(0))


def test_information_is_that_of_the_linear_model(ball_tracking):
    still = type(ball_tracking)(
        **{**ball_tracking.arrays(), "world_to_camera": np.tile(np.eye(4), (24, 1, 1))},
    )
    patterns = np.random.default_rng(0).normal(size=(2, 4, 4))
    grey = np.full((2, 4, 4, 3), 255 / 2).round().astype(np.uint8)
    pictures = Pictures((0, 9), grey, np.full((2, 4, 4), 255, np.uint8), np.ones((2, 4, 4), bool), (4, 4))
    found = mean_information(LinearDrawing(pictures, patterns), still, Shift(), np.zeros((24, 2)), [0, 1])
    slopes = 0.002 * patterns.reshape(2, -1) / NOISE
    np.testing.assert_allclose(found, 3 * slopes @ slopes.T / CORRELATED, rtol=0.02)
