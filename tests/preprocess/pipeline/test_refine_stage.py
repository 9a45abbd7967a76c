"""Refinement as a stage: what decides whether it runs, what the capture says, and that it can be undone and resumed."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from preprocess.cli.prep import _refine_as_value, main
from preprocess.options import PrepOptions
from preprocess.pipeline import refine_stage
from preprocess.refinement import refine as refinement

REPORT = {"pictures": 24, "head_degrees": 0.5, "head_mm": 2.0}


def run(clip, folder, *more):
    """Exit code of ggavatar-prep on the clip with imported tracking, refined unless it is told otherwise."""
    flags = () if "--no-refine" in more or "auto" in more else ("--refine",)
    return main([*clip.arguments, "-o", str(folder), *flags, *more])


@pytest.fixture
def quick(monkeypatch):
    """A refinement of 24 frames that shifts the head by 2 mm, and the clips it was called with."""
    monkeypatch.setattr(refine_stage, "LEAST_FRAMES", 24)
    calls = []

    def shifted(head, tracking, pictures, fps, advance):
        calls.append((head.version, len(pictures.rows), pictures.size, fps))
        views = tracking.world_to_camera.copy()
        views[:, 0, 3] += 0.002
        return refinement.Refined(dataclasses.replace(tracking, world_to_camera=views), (2.0, 1.0), True, dict(REPORT))

    monkeypatch.setattr(refinement, "refine", shifted)
    return calls


def shift(folder, clip):
    return np.median(Capture.open(folder).tracking.world_to_camera[:, 0, 3] - clip.record.world_to_camera[:, 0, 3])


def test_a_short_clip_is_not_refined_and_says_why(clip, tmp_path, capsys):
    assert run(clip, tmp_path / "c") == 0
    assert "not refined against the pictures: 24 frames are too few, it takes 48" in capsys.readouterr().err
    said = Capture.open(tmp_path / "c").source["refinement"]
    assert said == {"refined": False, "reason": "24 frames are too few, it takes 48"}
    assert shift(tmp_path / "c", clip) == pytest.approx(0, abs=1e-6)


def test_the_rule():
    options = PrepOptions(input=Path("a.mp4"), output_dir=Path("a"))
    imported = dataclasses.replace(options, tracking=Path("t"))
    assert refine_stage.why_not(options, 48) is None
    assert refine_stage.why_not(options, 47) == "47 frames are too few, it takes 48"
    assert refine_stage.why_not(imported, 500) == "it was made elsewhere; --refine corrects it"
    assert refine_stage.why_not(dataclasses.replace(imported, refine="yes"), 500) is None
    for each in (options, imported):
        assert refine_stage.why_not(dataclasses.replace(each, refine="no"), 500) == "--no-refine"


@pytest.mark.parametrize(
    ("given", "read"),
    [
        (["--refine"], ["--refine", "yes"]),
        (["--refine", "-o", "x"], ["--refine", "yes", "-o", "x"]),
        (["--refine", "auto", "a"], ["--refine", "auto", "a"]),
        (["a", "--no-refine"], ["a", "--refine", "no"]),
        (["--refined"], ["--refined"]),
    ],
)
def test_flags_without_a_value(given, read):
    assert _refine_as_value(given) == read


def test_an_imported_tracking_is_kept_unless_it_is_asked_for(clip, tmp_path, capsys, quick):
    assert run(clip, tmp_path / "c", "--refine", "auto") == 0 and not quick
    assert "made elsewhere; --refine corrects it" in capsys.readouterr().err
    assert Capture.open(tmp_path / "c").source["refinement"]["refined"] is False


def test_a_refined_capture_says_so_and_can_be_made_as_tracked_again(clip, tmp_path, capsys, quick):
    folder = tmp_path / "c"
    assert run(clip, folder) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert "refined against 24 of the pictures, test frames among them" in said and "--no-refine" in said
    assert quick == [("ball-1", 24, (96, 96), 25.0)]
    assert Capture.open(folder).source["refinement"] == {"refined": True, **REPORT}
    assert shift(folder, clip) == pytest.approx(0.002, abs=1e-6)
    assert run(clip, folder, "--resume", "--no-refine") == 0
    assert capsys.readouterr().err.count(": unchanged") == 6
    assert shift(folder, clip) == pytest.approx(0, abs=1e-6)
    assert Capture.open(folder).source["refinement"] == {"refined": False, "reason": "--no-refine"}
    assert run(clip, folder, "--resume") == 0
    assert shift(folder, clip) == pytest.approx(0.002, abs=1e-6) and len(quick) == 2
    assert run(clip, folder, "--resume") == 0 and len(quick) == 2


def test_a_refinement_that_does_not_settle_is_not_kept(clip, tmp_path, capsys, quick, monkeypatch):
    settled = refinement.refine

    def drifted(*arguments, **options):
        return dataclasses.replace(settled(*arguments, **options), settled=False)

    monkeypatch.setattr(refinement, "refine", drifted)
    assert run(clip, tmp_path / "c") == 0
    assert "drifted apart" in capsys.readouterr().err
    assert Capture.open(tmp_path / "c").source["refinement"] == {"refined": False, "reason": "it did not settle"}
    assert shift(tmp_path / "c", clip) == pytest.approx(0, abs=1e-6)


def test_an_interrupted_refinement_is_resumed(clip, tmp_path, capsys, quick, monkeypatch):
    folder, whole = tmp_path / "c", tmp_path / "whole"

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    assert run(clip, whole) == 0
    with monkeypatch.context() as patch:
        patch.setattr(refinement, "refine", interrupted)
        assert run(clip, folder) == 130
    with pytest.raises(InputError, match="--resume"):
        Capture.open(folder)
    capsys.readouterr()
    assert run(clip, folder, "--resume") == 0
    assert capsys.readouterr().err.count(": unchanged") == 6
    assert Capture.open(folder).digest() == Capture.open(whole).digest()


def test_a_clip_is_refined_for_real(clip, tmp_path, monkeypatch):
    """The tracking is exact, so that it hardly moves; everything is finite and the capture opens."""
    monkeypatch.setattr(refine_stage, "LEAST_FRAMES", 24)  # as many as the clip has
    assert run(clip, tmp_path / "c", "--quiet") == 0
    capture = Capture.open(tmp_path / "c")
    said = json.loads((tmp_path / "c" / "capture.json").read_text())["source"]["refinement"]
    assert said["refined"] and said["pictures"] == 24 and said["misfit"]["last"] < said["misfit"]["first"]
    assert said["head_degrees"] < 3 and said["head_mm"] < 10
    assert np.isfinite(capture.tracking.expression).all()
