"""What is drawn of a run. Reference: the rasterizer called by hand, and the frames of the capture.

Also covers `evaluate/viewer/tiles.py`.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from evaluate.figures.error_map import error_colors
from evaluate.viewer.orbit import resting_place
from evaluate.viewer.posing import Turn
from evaluate.viewer.run_scene import AVATAR, BESIDE, ERROR, ERROR_LIMIT, RunScene
from evaluate.viewer.tiles import side_by_side, tile_size
from ggavatar.pictures.quantization import to_8_bit
from tests.support.toy_run import HEIGHT, WIDTH, ToyAvatar, head, toy_run


@pytest.fixture
def scene(tmp_path: Path) -> RunScene:
    return RunScene(toy_run(tmp_path))


def rendered(scene: RunScene, number: int) -> np.ndarray:
    run = scene.run
    with torch.no_grad():
        gaussians = run.avatar.gaussians(run.reader.drive(number))
        return to_8_bit(run.rasterize(gaussians, run.reader.camera(number), run.background).image.numpy())


def drawn(scene: RunScene, size: tuple[int, int] = (WIDTH, HEIGHT), now: float = 0.0) -> np.ndarray:
    with torch.no_grad():
        return scene.picture(resting_place(scene.controls.pivot, *size), size, now)


def test_a_view_at_rest_shows_the_frame(scene: RunScene) -> None:
    first = scene.run.split.test[0]
    np.testing.assert_array_equal(drawn(scene), rendered(scene, first))
    scene.update(lambda shown: dataclasses.replace(shown, clip=shown.clip.at(1)))
    np.testing.assert_array_equal(drawn(scene), rendered(scene, scene.run.split.test[1]))
    scene.count()
    assert scene.gaussians == 2


def test_the_moment_changes_with_what_is_seen_only(scene: RunScene) -> None:
    before = scene.moment(0.0)
    assert scene.moment(50.0) == before and not scene.plays()
    scene.update(lambda shown: dataclasses.replace(shown, clip=dataclasses.replace(shown.clip, fps=2.0).playing(0.0)))
    assert scene.plays() and before != scene.moment(0.0) == scene.moment(0.4) != scene.moment(0.6)
    drive = scene.controls.rest
    for change in ({"mode": BESIDE}, {"drive": drive}, {"turn": Turn(0.1)}, {"free": True}):
        last = scene.moment(0.0)
        scene.update(lambda shown, change=change: dataclasses.replace(shown, **change))
        assert scene.moment(0.0) != last


def test_the_video_beside_and_the_error(scene: RunScene) -> None:
    number = scene.run.split.test[0]
    truth = to_8_bit(scene.run.reader.frame(number).image.numpy())
    own = rendered(scene, number)
    scene.update(lambda shown: dataclasses.replace(shown, mode=ERROR))
    found = drawn(scene, (3 * WIDTH, HEIGHT))
    error = np.abs(own.astype(np.float32) - truth).mean(axis=2) / 255
    np.testing.assert_array_equal(found, np.hstack([own, truth, error_colors(error, ERROR_LIMIT)]))
    scene.update(lambda shown: dataclasses.replace(shown, mode=BESIDE))
    np.testing.assert_array_equal(drawn(scene, (2 * WIDTH, HEIGHT)), np.hstack([own, truth]))


def test_the_error_is_never_that_of_a_free_view_or_of_a_slider(scene: RunScene) -> None:
    scene.update(lambda shown: dataclasses.replace(shown, mode=BESIDE, drive=scene.controls.rest))
    place = dataclasses.replace(resting_place(scene.controls.pivot, 64, 24), position=(0.5, 0.0, 0.9))
    with torch.no_grad():
        found = scene.picture(place, (2 * WIDTH, HEIGHT), 0.0)
    np.testing.assert_array_equal(found[:, :WIDTH], rendered(scene, scene.run.split.test[0]))


def test_a_turned_view_and_a_turned_head_look_different(scene: RunScene) -> None:
    front = drawn(scene)
    turned = dataclasses.replace(resting_place(scene.controls.pivot, WIDTH, HEIGHT), position=(0.2, 0.0, 0.9))
    with torch.no_grad():
        assert (scene.picture(turned, (WIDTH, HEIGHT), 0.0) != front).any()
    scene.update(lambda shown: dataclasses.replace(shown, turn=Turn(yaw=0.3)))
    assert (drawn(scene) != front).any()


def test_a_newer_avatar_takes_the_place_of_the_old(scene: RunScene) -> None:
    before, moment = drawn(scene), scene.moment(0.0)
    newer = ToyAvatar(head())
    with torch.no_grad():
        newer.colors.zero_()
    scene.replace_avatar(newer, 12)
    assert scene.moment(0.0) != moment and scene.run.step == 12
    assert (drawn(scene) != before).any()


def test_a_performer_is_shown_beside(scene: RunScene) -> None:
    scene.beside = np.full((8, 8, 3), 77, np.uint8)
    scene.update(lambda shown: dataclasses.replace(shown, drive=scene.controls.rest))
    found = drawn(scene, (2 * WIDTH, WIDTH))
    assert (found[:, WIDTH:] == 77).all() and not (found[:, :WIDTH] == 77).all()


def test_a_split_without_test_frames_shows_the_others(tmp_path: Path) -> None:
    run = toy_run(tmp_path)
    scene = RunScene(dataclasses.replace(run, split=dataclasses.replace(run.split, test=())))
    assert scene.shown.clip.frames == run.split.train and scene.shown.mode == AVATAR


def test_tiles_are_as_large_as_fits() -> None:
    assert tile_size((200, 100), (800, 400), 2) == (400, 200)
    assert tile_size((100, 100), (800, 100), 2) == (100, 100)
    tiles = [np.full((4, 4, 3), 10, np.uint8), np.full((2, 4, 3), 20, np.uint8)]
    found = side_by_side(tiles, (8, 6), (1, 2, 3))
    assert (found[1:5, :4] == 10).all() and (found[2:4, 4:] == 20).all()
    assert (found[0] == [1, 2, 3]).all() and (found[5] == [1, 2, 3]).all()
    assert side_by_side(tiles, (1, 1), (0, 0, 0)).shape == (1, 1, 3)
