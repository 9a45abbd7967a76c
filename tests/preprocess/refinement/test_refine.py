"""Known errors of a tracking are found again from pictures; also covers `preprocess/refinement/short_avatar.py`."""

from __future__ import annotations

import copy
import dataclasses
import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from preprocess.refinement.corrections import corrections_of
from preprocess.refinement.curvature import mean_information
from preprocess.refinement.drawing import Leaves, camera_of, drive_of
from preprocess.refinement.objective import misfit
from preprocess.refinement.pictures import Pictures, read_pictures
from preprocess.refinement.refine import RefinementOptions, finished, refine
from preprocess.refinement.rigid_steps import stepped
from preprocess.refinement.short_avatar import ShortAvatar
from preprocess.refinement.solve import regularity, smooth_step
from tests.support.synthetic_clip import as_tracking, ball_head, moving_record

COUNT = 48
CORNERS = np.array([[0.0, 0.0], [96.0, 0.0], [0.0, 96.0], [96.0, 96.0]])
"""Of the pictures, which are face all over."""


@pytest.fixture(scope="module")
def painted():
    """The ball in 48 frames, painted with waves of color: its exact avatar, tracking, and the pictures it draws."""
    head, record = ball_head(), moving_record(COUNT)
    tracking = as_tracking(dataclasses.replace(record, expression=0.3 * record.expression, eyelids=0 * record.eyelids))
    blank = np.full((COUNT, 96, 96, 3), 255, np.uint8)
    empty = Pictures(tuple(range(COUNT)), blank, blank[..., 0], np.ones(blank.shape[:3], bool), (96, 96))
    avatar = ShortAvatar(head, tracking, empty, 20 * COUNT)
    rows, middles = avatar.avatar.rows, head.template[head.faces].mean(1)
    with torch.no_grad():
        waves = torch.sin(middles @ (130.0 * torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.3], [0.4, -0.3, 1.0]])))
        rows["sh"].copy_(0.5 * waves[:, None])
        rows["opacity_logits"].fill_(4.0)
        rows["log_scales"].fill_(math.log(0.55))  # larger ones would be shrunk in training
        drawn = [avatar.draw(tracking, row) for row in range(COUNT)]
    levels = []
    for each in drawn:
        person_alone = (each.image - (1 - each.alpha)) / each.alpha.clamp_min(1 / 255)  # pictures have a background
        parts = person_alone, each.alpha[..., 0]
        levels.append([(part * 255).round().clamp(0, 255).byte().numpy() for part in parts])
    avatar.pictures = read_pictures(range(COUNT), lambda row: levels[row], 96, lambda row: CORNERS)
    return avatar, tracking


@pytest.fixture(scope="module")
def person(painted):
    """Head, true tracking and pictures of the painted ball."""
    avatar, tracking = painted
    return avatar.head, tracking, avatar.pictures


def perturbed(tracking):
    """Head poses that are off by a smooth course of degrees and millimeters."""
    time = np.arange(COUNT) / 25
    steps = np.zeros((COUNT, 6))
    steps[:, 0] = np.radians(2.0) * np.sin(2.1 * time)
    steps[:, 1] = np.radians(2.5) * np.cos(1.3 * time + 1)
    steps[:, 3] = 0.003 * np.sin(1.7 * time)
    poses = stepped(tracking.world_to_camera, np.zeros((COUNT, 3)), steps)
    return dataclasses.replace(tracking, world_to_camera=poses)


def pose_errors(tracking, truth):
    """Angles to the true rotations without their common part, degrees."""
    apart = Rotation.from_matrix(
        truth.world_to_camera[:, :3, :3].transpose(0, 2, 1) @ tracking.world_to_camera[:, :3, :3]
    )
    return np.degrees((apart * apart.mean().inv()).magnitude())


def test_known_errors_are_found_by_an_avatar_that_knows_the_person(painted):
    """Joint steps against the very avatar that made the pictures; the errors are known exactly."""
    avatar, truth = copy.deepcopy(painted[0]), painted[1]
    wrong = perturbed(truth)
    corrections = corrections_of(avatar.head, wrong)
    values = np.zeros((COUNT, corrections.count))
    picture = mean_information(avatar, wrong, corrections, values, range(0, COUNT, 8))
    known = regularity(picture, corrections.per_number("prior"), corrections.per_number("cutoff"), 25.0)
    for _ in range(4):
        gradients = avatar.epoch(corrections.moved(wrong, values), with_gradients=True).gradients
        slopes = corrections.pulled_back(wrong, values, gradients)
        values = values + smooth_step(values, np.tile(picture, (COUNT, 1, 1)), slopes, known)
    before, after = (float(np.median(pose_errors(each, truth))) for each in (wrong, corrections.moved(wrong, values)))
    assert before > 1.2 and after < 0.6 * before


def test_avatar_and_tracking_find_each_other(person):
    """Even where the avatar only ever sees the wrong poses, half of the error goes."""
    head, truth, pictures = person
    wrong = perturbed(truth)
    found = refine(head, wrong, pictures, 25.0, RefinementOptions(epochs=6))
    before, after = (float(np.median(pose_errors(each, truth))) for each in (wrong, found.tracking))
    assert before > 1.2 and after < 0.65 * before
    assert found.misfits[-1] < 0.8 * found.misfits[-6]
    assert found.report["pictures"] == COUNT and found.report["head_degrees"] > 0.3


def test_it_is_repeatable_and_leaves_the_rest_alone(person):
    head, truth, pictures = person
    short = RefinementOptions(warm_steps=COUNT, epochs=1)
    first, second = (refine(head, truth, pictures, 25.0, short).tracking.arrays() for _ in range(2))
    for name, array in first.items():
        np.testing.assert_array_equal(array, second[name])
    for name in ("intrinsics", "translation"):
        np.testing.assert_array_equal(first[name], getattr(truth, name))


def test_frames_between_pictures_move_too(person):
    head, truth, pictures = person
    arrays = pictures.rows, pictures.colors, pictures.coverage, pictures.face
    some = Pictures(*(part[::2] for part in arrays), pictures.full_size)
    calls = []
    short = RefinementOptions(warm_steps=COUNT // 2, epochs=2)
    wrong = perturbed(truth)
    found = refine(head, wrong, some, 25.0, short, lambda done, total: calls.append((done, total)))
    moved = np.abs(found.tracking.world_to_camera - wrong.world_to_camera).max(axis=(1, 2))
    assert (moved[1::2] > 0.1 * np.median(moved[::2])).all()
    assert calls == [(1, 3), (2, 3), (3, 3)]


def test_lids_stay_in_the_trackers_range(person):
    _, truth, _ = person
    odd = dataclasses.replace(truth, eyelids=np.tile([-0.2, 0.5], (COUNT, 1)))
    moved = dataclasses.replace(odd, eyelids=odd.eyelids + np.array([-1.0, 1.0]))
    np.testing.assert_array_equal(finished(moved, odd).eyelids[0], [-0.2, 1.0])


def test_an_epoch_trains_the_avatar_and_finds_gradients_only_where_wanted(person):
    head, truth, pictures = person
    avatar = ShortAvatar(head, truth, pictures, 4 * COUNT)
    before = [value.detach().clone() for value in avatar.avatar.parameters()]
    first = avatar.epoch(truth, with_gradients=False)
    assert not any(gradient.any() for gradient in first.gradients.values())
    assert any(not torch.equal(*pair) for pair in zip(before, avatar.avatar.parameters(), strict=True))
    second = avatar.epoch(truth, with_gradients=True)
    assert second.misfit < first.misfit
    assert second.gradients["world_to_camera"].any(axis=(1, 2)).all() and second.gradients["expression"].any()


def in_double(avatar, head):
    """A copy of the avatar in double precision."""
    model = copy.deepcopy(avatar).double()
    model.head = head
    model.poses = dataclasses.replace(avatar.poses, reference=avatar.poses.reference.double())
    return model


def test_gradients_of_a_picture_against_differences_in_float64(painted):
    """Pitch and shifts of the head through mesh, Gaussians and the reference rasterizer.

    Steps are long enough to even out that Gaussians end where their opacity falls below 1/255. Yaw is left out: large
    opaque Gaussians change places in depth, where differences jump and derivatives do not.
    """
    from ggavatar.render.reference import rasterize

    avatar, tracking = painted[0], perturbed(painted[1])
    tracking = dataclasses.replace(tracking, torso_to_camera=painted[1].world_to_camera.copy())
    exact = avatar.head.to("cpu", torch.float64)
    model = in_double(avatar.avatar, exact)
    colors, coverage, weights = (part.double() for part in avatar.pictures.picture(7))
    corrections = corrections_of(avatar.head, tracking)
    values = np.zeros((COUNT, corrections.count))

    def cost(leaves, at):
        drive = drive_of(exact, at, 7, leaves)
        camera = camera_of(at, 7, leaves, avatar.pictures.full_size, avatar.pictures.size)
        drawn = rasterize(model.gaussians(drive), camera, torch.ones(3, dtype=torch.float64))
        return misfit(drawn, colors, coverage, weights)

    leaves = Leaves.of(tracking, 7, wanted=True, dtype=torch.float64)
    cost(leaves, tracking).backward()
    gradients = {name: np.zeros(array.shape) for name, array in Leaves.arrays(tracking).items()}
    for name, gradient in leaves.gradients().items():
        gradients[name][7] = gradient
    found = corrections.pulled_back(tracking, values, gradients)[7]
    for column in (0, 3, 4):
        costs = []
        for sign in (1, -1):
            at = values.copy()
            at[7, column] = sign * 0.05
            moved = corrections.moved(tracking, at)
            with torch.no_grad():
                costs.append(float(cost(Leaves.of(moved, 7, False, torch.float64), moved)))
        assert found[column] == pytest.approx((costs[0] - costs[1]) / 0.1, rel=0.1, abs=0.1)
