"""The doctor's landmark error against landmarks put at known distances from where the head has them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.head.files import load_head, save_head
from ggavatar.head.model import HeadModel
from preprocess.doctor.quality import landmark_error
from preprocess.tracking.geometry.projection import posed_vertices, project
from tests.support.synthetic_clip import as_tracking, ball_head, moving_record

FRAMES = 5


@pytest.fixture
def head() -> HeadModel:
    """Twelve landmarks at random places on triangles."""
    generator, plain = np.random.default_rng(3), ball_head()
    corners = plain.faces[torch.from_numpy(generator.integers(0, len(plain.faces), 12))]
    weights = torch.from_numpy(generator.dirichlet([1.0, 1.0, 1.0], 12)).float()
    return dataclasses.replace(plain, regions={"landmarks": corners.ravel()}, landmark_weights=weights)


def capture_of(head: HeadModel, shift: float) -> Capture:
    """A capture whose landmarks are `shift` px right of where the head has them; two more belong to nothing."""
    record = moving_record(FRAMES)
    tracking = as_tracking(record)
    corners, weights = head.regions["landmarks"].reshape(-1, 3), head.landmark_weights
    assert weights is not None
    seen = np.full((FRAMES, 14, 2), 1e3)
    for row in range(FRAMES):
        points = np.einsum("lk,lkc->lc", weights.numpy(), posed_vertices(head, tracking, row)[corners.numpy()])
        seen[row, :12] = project(points, tracking.intrinsics[row], tracking.world_to_camera[row])[0] + [shift, 0.0]
    seen[2] = np.nan
    tracking = dataclasses.replace(tracking, landmarks=seen)
    return Capture(Path("nowhere"), "ball", 96, 96, 25.0, tuple(range(FRAMES)), {}, tracking, head.version)


@pytest.mark.parametrize("shift", [0.0, 4.0])
def test_distance_is_measured_on_the_triangles(head: HeadModel, shift: float, tmp_path: Path) -> None:
    save_head(head, tmp_path / "head.npz")
    error = landmark_error(capture_of(head, shift), load_head(tmp_path / "head.npz"))
    assert error == pytest.approx(shift, abs=1e-3)


def test_a_vertex_for_each_landmark_will_do(head: HeadModel) -> None:
    exact = dataclasses.replace(head, landmark_weights=torch.eye(3)[torch.zeros(12, dtype=torch.int64)])
    vertices = dataclasses.replace(
        exact, regions={"landmarks": head.regions["landmarks"].reshape(-1, 3)[:, 0]}, landmark_weights=None
    )
    assert landmark_error(capture_of(exact, 2.0), vertices) == pytest.approx(2.0, abs=1e-3)


def test_heads_without_landmarks_are_not_measured(head: HeadModel) -> None:
    capture = capture_of(head, 0.0)
    assert landmark_error(capture, ball_head()) is None
    unseen = dataclasses.replace(capture, tracking=dataclasses.replace(capture.tracking, landmarks=None))
    assert landmark_error(unseen, head) is None


def test_weights_that_do_not_fit_are_refused(head: HeadModel, tmp_path: Path) -> None:
    assert head.landmark_weights is not None
    save_head(dataclasses.replace(head, landmark_weights=head.landmark_weights[:5]), tmp_path / "head.npz")
    with pytest.raises(InputError, match="landmark_weights"):
        load_head(tmp_path / "head.npz")
