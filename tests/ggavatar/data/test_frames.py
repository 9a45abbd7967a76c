"""Frames: compositing and resampling against numpy, order, bounded memory, reading ahead.

Also covers `ggavatar/jit/dispatch.py`.
"""

from __future__ import annotations

import dataclasses
from itertools import islice

import numpy as np
import pytest
import torch

from ggavatar.data.capture import Capture
from ggavatar.data.frames import Frames, drives_and_cameras, evenly_spaced, head_pose, random_order
from ggavatar.errors import InputError
from ggavatar.head.model import HeadModel


def open_frames(capture: Capture, head: HeadModel, budget_mib: int = 64) -> Frames:
    return Frames(capture, head, torch.tensor([0.2, 0.4, 1.0]), "cpu", budget_mib)


def test_composite_is_straight_alpha_over_the_background(toy_capture: Capture, toy_head: HeadModel) -> None:
    number = toy_capture.frames[4]
    frame = open_frames(toy_capture, toy_head).frame(number)
    alpha = toy_capture.mask(number)[..., None] / 255.0
    expected = toy_capture.image(number) / 255.0 * alpha + np.array([0.2, 0.4, 1.0]) * (1 - alpha)
    assert np.abs(frame.image.numpy() - expected).max() <= 0.5 / 255 + 1e-6
    assert np.allclose(frame.alpha.numpy(), alpha) and frame.drive.frame == number


def test_smaller_frames_are_area_means_and_their_cameras_agree(toy_capture: Capture, toy_head: HeadModel) -> None:
    number = toy_capture.frames[2]
    frames = open_frames(toy_capture, toy_head)
    full, half = frames.frame(number), frames.frame(number, 24, 24)
    means = full.image.view(24, 2, 24, 2, 3).mean((1, 3))
    assert (half.image - means).abs().max() <= 1 / 255 + 1e-6
    assert torch.allclose(half.camera.intrinsics[:2], full.camera.intrinsics[:2] / 2)
    assert (half.camera.width, half.camera.height) == (24, 24)


def test_stream_keeps_order_and_equals_single_frames(toy_capture: Capture, toy_head: HeadModel) -> None:
    frames = open_frames(toy_capture, toy_head)
    requests = [(number, 24, 24) for number in toy_capture.frames[:9]]
    for request, frame in zip(requests, frames.stream(requests), strict=True):
        assert frame.drive.frame == request[0]
        assert torch.equal(frame.image, frames.frame(*request).image)


def test_memory_stays_within_its_budget(toy_capture: Capture, toy_head: HeadModel) -> None:
    """A frame takes 48 · 48 · 4 bytes: 1 MiB holds them all, nothing holds none, and sizes do not pile up."""
    none, all_of_them = open_frames(toy_capture, toy_head, 0), open_frames(toy_capture, toy_head, 1)
    requests = [(number, 48, 48) for number in toy_capture.frames]
    for frames in (none, all_of_them):
        assert len(list(frames.stream(requests))) == len(requests)
    assert not none._kept and len(all_of_them._kept) == len(requests)
    all_of_them._room = 0
    list(all_of_them.stream([(number, 24, 24) for number in toy_capture.frames]))
    assert {key[1] for key in all_of_them._kept} == {24}


def test_abandoned_stream_ends_its_thread(toy_capture: Capture, toy_head: HeadModel) -> None:
    import threading

    before = set(threading.enumerate())
    stream = open_frames(toy_capture, toy_head).stream((number, 48, 48) for number in toy_capture.frames)
    next(stream)
    stream.close()
    assert set(threading.enumerate()) <= before


def test_damaged_frame_is_named(toy_capture: Capture, toy_head: HeadModel, tmp_path: object) -> None:
    import shutil
    from pathlib import Path

    folder = Path(str(tmp_path)) / "copy"
    shutil.copytree(toy_capture.folder, folder)
    copy = dataclasses.replace(toy_capture, folder=folder)
    path = folder / "images" / f"{copy.frames[3]:06d}.png"
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(InputError, match=path.name):
        list(open_frames(copy, toy_head).stream([(number, 48, 48) for number in copy.frames[:5]]))


def test_order_is_a_permutation_each_epoch_and_can_begin_anywhere() -> None:
    numbers = [5, 6, 7, 8, 9]
    order = list(islice(random_order(numbers, 42, 1), 20))
    epochs = [order[start : start + 5] for start in range(0, 20, 5)]
    assert all(sorted(epoch) == numbers for epoch in epochs) and len({tuple(epoch) for epoch in epochs}) > 1
    for first in (2, 5, 6, 13):
        assert list(islice(random_order(numbers, 42, first), 21 - first)) == order[first - 1 :]


def test_spaced_takes_first_and_last() -> None:
    assert evenly_spaced(range(100), 4) == [0, 33, 66, 99]
    assert evenly_spaced([3, 4], 9) == [3, 4]


def test_head_pose_moves_the_skull_as_skinning_does(toy_head: HeadModel) -> None:
    rotations = torch.zeros(5, 3)
    rotations[0], rotations[1] = torch.tensor([0.1, 0.2, 0.0]), torch.tensor([0.0, -0.4, 0.3])
    shift = torch.tensor([0.01, 0.02, 0.03])
    drive = dataclasses.replace(toy_head.neutral_drive(), joint_rotations=rotations, translation=shift)
    weights = torch.zeros_like(toy_head.skinning_weights)
    weights[:, 1] = 1.0
    skull = dataclasses.replace(toy_head, skinning_weights=weights)
    motion = head_pose(skull, rotations, shift)
    assert torch.allclose(skull.vertices(drive), skull.template @ motion[:3, :3].T + motion[:3, 3], atol=1e-6)


def test_drives_have_the_torso_of_their_own_frame(toy_capture: Capture, toy_head: HeadModel) -> None:
    assert all(drive.torso_to_camera is None for drive in drives_and_cameras(toy_capture, toy_head, "cpu")[0])
    torso = toy_capture.tracking.world_to_camera.copy()
    torso[:, 0, 3] = np.arange(len(torso))
    followed = dataclasses.replace(
        toy_capture, tracking=dataclasses.replace(toy_capture.tracking, torso_to_camera=torso)
    )
    drives, _ = drives_and_cameras(followed, toy_head, "cpu")
    seen = [drive.torso_to_camera[0, 3].item() for drive in drives if drive.torso_to_camera is not None]
    assert seen == list(range(len(torso)))
