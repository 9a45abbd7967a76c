"""Live performances against the transfer of recorded ones, and poses against a face projected by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from evaluate.motion.driving_sequence import DrivingSequence
from evaluate.motion.expression_transfer import carry_over
from evaluate.motion.face import Face, face_of
from evaluate.motion.facial_codes import facial_layout
from evaluate.motion.live import (
    LiveTransfer,
    Look,
    LookFilter,
    assumed_intrinsics,
    look_of,
    mean_look,
)
from evaluate.motion.transfer import TransferOptions
from ggavatar.errors import InputError
from ggavatar.landmarks.average_face import average_face
from tests.support.toy_run import head, tracking, write_capture

SIZE = (640, 480)
ROTATION = Rotation.from_rotvec([3.0, 0.1, 0.05])
PLACE = np.array([0.05, -0.03, 0.6])


def target(tmp_path_factory: pytest.TempPathFactory) -> DrivingSequence:
    from evaluate.motion.driving_sequence import driving_sequence_of

    sequence = driving_sequence_of(write_capture(tmp_path_factory.mktemp("live") / "capture"))
    random = np.random.default_rng(0)
    scores = np.clip(0.2 + 0.5 * sequence.joint_rotations[:, 2, :1] + 0.02 * random.random((6, 52)), 0, 1)
    return dataclasses.replace(sequence, scores=scores)


@pytest.fixture(scope="module")
def sequence(tmp_path_factory: pytest.TempPathFactory) -> DrivingSequence:
    return target(tmp_path_factory)


def look(score: float = 0.2, turn: float = 0.0, aside: float = 0.0) -> Look:
    rotation = Rotation.from_rotvec([0, turn, 0]) * ROTATION
    return Look(np.full(51, score), rotation.as_rotvec(), PLACE + np.array([aside, 0, 0]))


def test_poses_are_found_from_landmarks() -> None:
    seen = average_face().vertices @ ROTATION.as_matrix().T + PLACE
    pixels = (seen @ assumed_intrinsics(*SIZE).T)[:, :2] / seen[:, 2:]
    points = np.concatenate((pixels, pixels[:10]))
    found = look_of(np.arange(52) / 52, points, SIZE)
    assert found is not None
    assert (Rotation.from_rotvec(found.rotation) * ROTATION.inv()).magnitude() < 1e-4
    np.testing.assert_allclose(found.translation, PLACE, atol=1e-4)
    np.testing.assert_allclose(found.scores, np.arange(1, 52) / 52)


def test_landmarks_that_no_pose_explains_are_none() -> None:
    assert look_of(np.zeros(52), np.full((478, 2), 5.0), SIZE) is None


def test_an_open_mouth_does_not_nod() -> None:
    face = average_face().vertices.copy()
    face[face[:, 1] < -0.04] += [0, -0.015, 0]
    seen = face @ ROTATION.as_matrix().T + PLACE
    pixels = (seen @ assumed_intrinsics(*SIZE).T)[:, :2] / seen[:, 2:]
    found = look_of(np.zeros(52), np.concatenate((pixels, pixels[:10])), SIZE)
    assert found is not None and (Rotation.from_rotvec(found.rotation) * ROTATION.inv()).magnitude() < 1e-3


def test_at_rest_the_avatar_is_at_rest_and_faces_its_camera(sequence: DrivingSequence) -> None:
    transfer = LiveTransfer(sequence, head())
    drive, camera = transfer(look(), look(), SIZE)
    assert sequence.cameras is not None
    np.testing.assert_allclose(drive.expression, face_of(sequence).rest[:3], atol=0.15)  # as near as scores tell
    np.testing.assert_allclose(camera.world_to_camera, sequence.cameras.world_to_camera[0], atol=1e-5)
    assert drive.frame is None and (camera.width, camera.height) == sequence.cameras.size


def test_codes_are_those_of_a_recording(sequence: DrivingSequence) -> None:
    transfer = LiveTransfer(sequence, head(), TransferOptions(margin=None))
    drive, _ = transfer(look(0.35), look(0.2), SIZE)
    known, layout = face_of(sequence), facial_layout(sequence)
    empty = dataclasses.replace(layout, names=(), shared=(), expressions=(), joints=())
    driver = Face(
        empty, np.zeros((1, 0)), np.full((1, 51), 0.35), None, np.zeros((0, 0)), np.zeros(0), np.full(51, 0.2)
    )  # fmt: skip
    expected = carry_over(driver, known)[0]
    np.testing.assert_allclose(drive.expression.numpy(), expected[: drive.expression.numel()], atol=1e-5)
    assert not np.allclose(expected, known.rest)


def test_turns_and_places_are_carried_over_as_changes(sequence: DrivingSequence) -> None:
    transfer = LiveTransfer(sequence, head())
    assert sequence.cameras is not None
    _, camera = transfer(look(turn=0.2, aside=0.06), look(), SIZE)
    rest = torch.from_numpy(sequence.cameras.world_to_camera[0])
    turn = camera.world_to_camera.double()[:3, :3] @ rest[:3, :3].T
    np.testing.assert_allclose(turn, Rotation.from_rotvec([0, 0.2, 0]).as_matrix(), atol=1e-5)
    # The same part of the width of the picture at the head's distance: 0.6 m, or 1 m with a lens of 50 px for 32.
    widths = (0.6 * SIZE[0] / assumed_intrinsics(*SIZE)[0, 0], float(rest[2, 3]) * 32 / 50)
    assert float(camera.world_to_camera[0, 3] - rest[0, 3]) == pytest.approx(0.06 * widths[1] / widths[0], rel=1e-4)


def test_scores_beyond_all_measure_stay_near_training(sequence: DrivingSequence) -> None:
    transfer = LiveTransfer(sequence, head())
    drive, _ = transfer(look(1.0), look(0.0), SIZE)
    low, high = sequence.expression.min(0), sequence.expression.max(0)
    width = 3.0 * np.maximum(high - low, np.median(high - low))
    assert ((drive.expression.numpy() > low - width - 1e-4) & (drive.expression.numpy() < high + width + 1e-4)).all()


def test_an_avatar_whose_face_was_not_measured_is_a_sentence(sequence: DrivingSequence) -> None:
    with pytest.raises(InputError, match="ggavatar-render --drive"):
        LiveTransfer(dataclasses.replace(sequence, scores=None), head())
    assert tracking().expression.shape[1] == 3


def test_the_mean_of_looks_is_the_middle_one() -> None:
    found = mean_look([look(0.1, -0.2, -0.1), look(0.3, 0.2, 0.1)])
    np.testing.assert_allclose(found.scores, 0.2)
    np.testing.assert_allclose(found.translation, PLACE)
    assert (Rotation.from_rotvec(found.rotation) * ROTATION.inv()).magnitude() < 1e-6


def test_looks_are_steadied_and_follow_a_turn_past_the_wrap() -> None:
    smooth, random = LookFilter(), np.random.default_rng(1)
    shaken = []
    for index in range(80):
        noisy = dataclasses.replace(look(), scores=0.2 + 0.05 * random.standard_normal(51))
        steady = smooth(noisy, 1 / 25)
        if index > 20:
            shaken.append(steady.scores)
    assert np.std(shaken) < 0.6 * 0.05
    half_turn = Rotation.from_rotvec([0, 0, 0.3]) * Rotation.from_rotvec([np.pi, 0, 0])  # on the wrap of its vector
    for _ in range(60):
        steady = smooth(dataclasses.replace(look(), rotation=half_turn.as_rotvec()), 1 / 25)
    assert (Rotation.from_rotvec(steady.rotation) * half_turn.inv()).magnitude() < 0.02
