"""Which of mesh, masks and faces is believed. Reference: a right capture whose masks are spoiled on purpose."""

from __future__ import annotations

import dataclasses
import shutil

import numpy as np
import pytest

from ggavatar.data.capture import Capture
from ggavatar.head.files import load_head
from ggavatar.io.images import write_png
from preprocess.cli.prep import main
from preprocess.doctor import diagnosis
from preprocess.doctor.conventions import FIXES
from preprocess.doctor.diagnosis import examine
from preprocess.doctor.mask_check import lies_on_faces, sampled_faces
from preprocess.tracking.geometry.projection import posed_vertices, project


@pytest.fixture(scope="module")
def folder(clip, tmp_path_factory):
    place = tmp_path_factory.mktemp("checked") / "c"
    assert main([*clip.arguments, "-o", str(place), "--quiet"]) == 0
    return place


@pytest.fixture(scope="module")
def head(folder):
    return load_head(folder / "head.npz")


def drawn_faces(capture, head):
    """Where the front of the head is drawn, in some frames."""
    tracking, found = capture.tracking, {}
    front = np.flatnonzero((head.template[:, 2] > 0.02).numpy())
    for row in range(0, len(capture.frames), 4):
        vertices = posed_vertices(head, tracking, row)[front]
        found[row] = project(vertices, tracking.intrinsics[row], tracking.world_to_camera[row])[0]
    return found


def spoiled(folder, target, change):
    shutil.copytree(folder, target)
    capture = Capture.open(target)
    for number in capture.frames:
        write_png(capture.image_path("masks", number), change(capture.mask(number)))
    return capture


CHANGES = {
    "inverted": lambda mask: 255 - mask,
    "everywhere": np.ones_like,
    "empty": np.zeros_like,
    "elsewhere": lambda mask: np.roll(mask, 48, axis=1),
}


@pytest.mark.parametrize("fault", CHANGES)
def test_no_flag_for_the_tracking_is_named(folder, head, tmp_path, monkeypatch, fault):
    change = CHANGES[fault]
    scale = 255 if fault == "everywhere" else 1
    capture = spoiled(folder, tmp_path / "c", lambda mask: np.asarray(change(mask) * scale, np.uint8))
    monkeypatch.setattr(diagnosis, "rank_hypotheses", lambda *_: pytest.fail("the ranking was consulted"))
    monkeypatch.setattr(diagnosis, "photometric_alternative", lambda *_: pytest.fail("the ranking was consulted"))
    found = examine(capture, head, drawn_faces(capture, head))
    faults = [finding for finding in found.findings if finding.severity == "fault"]
    assert [finding.code for finding in faults] == [f"masks-{fault}"]
    assert not {finding.code for finding in found.findings} & {"blur", "bars"} and "--fix" not in faults[0].flag


def test_a_head_on_the_faces_is_not_moved_off_them(folder, head, tmp_path):
    """Masks of far too much pass the check; the hypothesis that they suggest is contradicted by the faces."""

    def much(mask):
        wide = mask.copy()
        wide[12:], wide[:, -14:] = 255, 0
        return wide

    capture = spoiled(folder, tmp_path / "c", much)
    blind, seeing = examine(capture, head, {}), examine(capture, head, drawn_faces(capture, head))
    named = {finding.code for finding in blind.findings if finding.severity == "fault"}
    assert named & set(FIXES), "without faces the masks mislead"
    faults = [finding for finding in seeing.findings if finding.severity == "fault"]
    assert [finding.code for finding in faults] == ["overlap"]
    assert "the masks are probably wrong" in faults[0].message and faults[0].flag == "--masks"


def test_heads_on_and_off_the_faces(folder, head):
    capture = Capture.open(folder)
    faces = drawn_faces(capture, head)
    assert lies_on_faces(capture, head, capture.tracking, faces) is True
    for name in ("distance/1000", "distance/4", "axes+--", "inverted"):
        moved = FIXES[name].correct(capture.tracking, capture.width, capture.height)
        assert lies_on_faces(capture, head, moved, faces) is False, name
    assert lies_on_faces(capture, head, capture.tracking, {}) is None


def test_landmarks_of_the_tracking_are_used(folder):
    capture = Capture.open(folder)
    landmarks = np.full((len(capture.frames), 5, 2), 3.0)
    landmarks[::2] = np.nan
    known = dataclasses.replace(capture, tracking=dataclasses.replace(capture.tracking, landmarks=landmarks))
    assert sampled_faces(known) and all(row % 2 for row in sampled_faces(known))
