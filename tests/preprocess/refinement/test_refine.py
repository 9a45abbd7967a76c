"""Known errors of a tracking are found again from pictures; also covers `preprocess/refinement/short_avatar.py`."""

from __future__ import annotations

import copy
import dataclasses

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
def person():
    """The ball in 48 frames, painted with a color for each triangle, and the pictures that its own Gaussians make."""
    head, record = ball_head(), moving_record(COUNT)
    tracking = as_tracking(dataclasses.replace(record, expression=0.3 * record.expression, eyelids=0 * record.eyelids))
    blank = np.full((COUNT, 96, 96, 3), 255, np.uint8)
    empty = Pictures(tuple(range(COUNT)), blank, blank[..., 0], np.ones(blank.shape[:3], bool), (96, 96))
    painted = ShortAvatar(head, tracking, empty, 1)
    rows, generator = painted.avatar.rows, torch.Generator().manual_seed(0)
    with torch.no_grad():
        rows["sh"].copy_(torch.randn(rows["sh"].shape, generator=generator))
        rows["opacity_logits"].fill_(4.0)
        drawn = [painted.draw(tracking, row) for row in range(COUNT)]
    levels = [[(part * 255).round().clamp(0, 255).byte().numpy() for part in (d.image, d.alpha[..., 0])] for d in drawn]
    return head, tracking, read_pictures(range(COUNT), lambda row: levels[row], 96, lambda row: CORNERS)


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


def test_known_errors_are_found_by_an_avatar_that_knows_the_person(person):
    """Three joint steps against an avatar that was trained on the true poses; the errors are known exactly."""
    head, truth, pictures = person
    avatar = ShortAvatar(head, truth, pictures, 13 * COUNT)
    for _ in range(9):
        avatar.epoch(truth, with_gradients=False)
    wrong = perturbed(truth)
    corrections = corrections_of(head, wrong)
    values = np.zeros((COUNT, corrections.count))
    picture = mean_information(avatar, wrong, corrections, values, range(0, COUNT, 8))
    known = regularity(picture, corrections.per_number("prior"), corrections.per_number("cutoff"), 25.0)
    for _ in range(3):
        gradients = avatar.epoch(corrections.moved(wrong, values), with_gradients=True).gradients
        slopes = corrections.pulled_back(wrong, values, gradients)
        values = values + smooth_step(values, np.tile(picture, (COUNT, 1, 1)), slopes, known)
    before, after = (float(np.median(pose_errors(each, truth))) for each in (wrong, corrections.moved(wrong, values)))
    assert before > 1.2 and after < 0.35 * before


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


def test_gradients_of_a_picture_against_differences_in_float64(person):
    """Head pose, expression, jaw and a held torso through mesh, Gaussians and the reference rasterizer.

    Steps are long enough to even out that Gaussians end where their opacity falls below 1/255.
    """
    from ggavatar.render.reference import rasterize

    head, truth, pictures = person
    truth = dataclasses.replace(truth, torso_to_camera=truth.world_to_camera.copy())
    avatar = ShortAvatar(head, truth, pictures, 4 * COUNT)
    avatar.epoch(truth, with_gradients=False)
    exact = head.to("cpu", torch.float64)
    model = in_double(avatar.avatar, exact)
    colors, coverage, weights = (part.double() for part in pictures.picture(7))
    corrections = corrections_of(head, truth)
    values = np.zeros((COUNT, corrections.count))

    def cost(leaves, tracking):
        drive = drive_of(exact, tracking, 7, leaves)
        camera = camera_of(tracking, 7, leaves, pictures.full_size, pictures.size)
        drawn = rasterize(model.gaussians(drive), camera, torch.ones(3, dtype=torch.float64))
        return misfit(drawn, colors, coverage, weights)

    leaves = Leaves.of(truth, 7, wanted=True, dtype=torch.float64)
    cost(leaves, truth).backward()
    gradients = {name: np.zeros(array.shape) for name, array in Leaves.arrays(truth).items()}
    for name, gradient in leaves.gradients().items():
        gradients[name][7] = gradient
    found = corrections.pulled_back(truth, values, gradients)[7]
    for column in (0, 1, 4, 5, 6, 8):
        costs = []
        for sign in (1, -1):
            at = values.copy()
            at[7, column] = sign * 0.02
            moved = corrections.moved(truth, at)
            with torch.no_grad():
                costs.append(float(cost(Leaves.of(moved, 7, False, torch.float64), moved)))
        assert found[column] == pytest.approx((costs[0] - costs[1]) / 0.04, rel=0.05, abs=0.02)
