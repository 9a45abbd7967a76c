"""A file of Gaussians on show. Reference: the picture that `ggavatar-render --orbit` begins with."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from evaluate.rendering.standalone_file import StandaloneGaussians, open_standalone
from evaluate.viewer.file_scene import FileScene
from evaluate.viewer.orbit import resting_place
from ggavatar.formats.source_options import GaussianFileOptions
from ggavatar.formats.splats.gaussian_ply import write_gaussian_ply
from ggavatar.formats.splats.stored_gaussians import to_stored
from ggavatar.pictures.quantization import to_8_bit
from tests.support.fake_viser import FakeServer
from tests.support.gaussian_cloud import cloud

SIDE = 512


@pytest.fixture
def file(tmp_path: Path) -> StandaloneGaussians:
    path = tmp_path / "cloud.ply"
    write_gaussian_ply(path, to_stored(cloud()))
    return open_standalone(path, GaussianFileOptions(), "cpu", "reference")


def test_at_rest_it_is_seen_from_the_front(file: StandaloneGaussians) -> None:
    scene = FileScene(file, torch.tensor([0.0, 0.5, 0.0]))
    drive, camera, _ = file.front_view()
    with torch.no_grad():
        expected = file.rasterize(file.avatar.gaussians(drive), camera, torch.tensor([0.0, 0.5, 0.0])).image
        place = resting_place(scene.pivot, SIDE, SIDE)
        found = scene.picture(place, (SIDE, SIDE), 0.0)
        np.testing.assert_allclose(found.astype(int), to_8_bit(expected.numpy()).astype(int), atol=1)
        behind = dataclasses.replace(place, wxyz=(0.0, 0.0, 0.0, 1.0), position=(0.0, 0.0, -place.position[2]))
        covered = [(one != [0, 128, 0]).any(axis=2) for one in (found, scene.picture(behind, (SIDE, SIDE), 0.0))]
    assert covered[0].mean() > 0.1 and (covered[0] == covered[1][:, ::-1]).mean() > 0.9  # mirrored, nearly
    assert scene.moment(0.0) == scene.moment(9.0) and not scene.plays()


def test_the_panel_says_what_it_is(file: StandaloneGaussians) -> None:
    server = FakeServer()
    FileScene(file, torch.ones(3)).build(server)
    assert "60 Gaussians" in server.viser.gui.controls[0].content
    server.viser.gui.named("view from the front").use(client="me")
    assert server.fronts == ["me"]
