"""Avatar files in the commands of `evaluate`: rendered like the run, never scored as one."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from evaluate.cli import evaluate as evaluating
from evaluate.cli import render as command
from evaluate.options import Options
from evaluate.scoring.run import evaluate_run
from evaluate.viewer.options import Options as ViewerOptions
from evaluate.viewer.orbit import resting_place
from evaluate.viewer.run_scene import AVATAR, RunScene
from evaluate.viewer.session import open_session
from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.formats.avatar_file import export as exporting
from ggavatar.io.dataclass_json import to_plain
from ggavatar.io.images import read_rgb
from ggavatar.landmarks.blendshapes import NAMES
from ggavatar.training.registry import load
from ggavatar.training.run_folder import RunConfig
from tests.support.silent_reporter import SilentReporter
from tests.support.untrained_avatars import run_of, untrained


@pytest.fixture
def file(toy_capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An avatar whose training frames have known scores."""
    avatar, reader = untrained("gaussian_avatars", toy_capture, 100)
    values = to_plain(load("gaussian_avatars").config("default"))
    run = dataclasses.replace(
        run_of(avatar, reader, toy_capture),
        method="gaussian_avatars",
        config=RunConfig("gaussian_avatars", "", method_config=values),
    )
    scores = np.random.default_rng(0).uniform(0.05, 0.6, size=(len(run.split.train), 52))
    monkeypatch.setattr(exporting, "measured_scores", lambda *_: scores)
    exporting.export_avatar_file(run, tmp_path / "me.ggavatar", overwrite=False)
    return tmp_path / "me.ggavatar"


def test_a_file_is_not_scored_but_says_how_its_pictures_are(
    file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["ggavatar-eval", str(file), "--device", "cpu"])
    assert evaluating.main() == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "no photographs" in line and "--pred OUT/frames --capture" in line
    with pytest.raises(InputError, match=r"no photographs.*--pred OUT/frames --capture"):
        evaluate_run(file, Options(runs=(file,)), SilentReporter())


@pytest.mark.parametrize("kind", ["mediapipe.json", "arkit.json", "take.csv", "take.npz"])
def test_any_recording_of_scores_drives_a_file(kind: str, file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same scores in four formats give the same pictures, without a capture and without networks."""
    names, scores = list(NAMES[1:]), np.random.default_rng(1).uniform(size=(4, 51))
    frames = [dict(zip(names, row.tolist(), strict=True)) for row in scores]
    folder = file.parent
    (folder / "mediapipe.json").write_text(
        json.dumps([{"blendshapes": row, "time": number / 30} for number, row in enumerate(frames)])
    )
    shuffled = names[::-1]
    (folder / "arkit.json").write_text(
        json.dumps({"names": shuffled, "frames": [{"weights": [row[name] for name in shuffled], "time": number / 30}
                                                  for number, row in enumerate(frames)]})
    )  # fmt: skip
    lines = [",".join(["time", *shuffled])]
    lines += [",".join(map(str, [number / 30, *(row[name] for name in shuffled)])) for number, row in enumerate(frames)]
    (folder / "take.csv").write_text("\n".join(lines))
    np.savez(folder / "take.npz", names=np.array(names), scores=scores, times=np.arange(4) / 30)
    pictures = []
    for source in ("take.npz", kind):
        out = folder / f"out-{source}"
        given = ["ggavatar-render", str(file), "--drive", str(folder / source), "--no-video", "--device", "cpu"]
        monkeypatch.setattr("sys.argv", [*given, "--width", "48", "-o", str(out)])
        if not out.exists():
            assert command.main() == 0
        pictures.append(np.stack([read_rgb(path) for path in sorted((out / "frames").iterdir())]))
    assert pictures[0].shape[0] == 4 and np.array_equal(*pictures)
    assert (pictures[0][0] != pictures[0][2]).any(), "it moves"


def test_the_flags_of_driving_are_those_of_the_export() -> None:
    from evaluate.rendering.options import Options as RenderOptions
    from ggavatar.cli.export import Arguments

    ours, theirs = (
        {field.name: field.default for field in dataclasses.fields(kind(Path("x")).driving)}
        for kind in (RenderOptions, Arguments)
    )
    assert ours == theirs and SimpleNamespace(**ours).transfer == "matched"


def test_the_viewer_shows_a_file_without_its_video(file: Path) -> None:
    pytest.importorskip("viser", reason="needs viser, which serves the viewer: pip install viser")
    session = open_session(ViewerOptions(file, port=0, device="cpu", backend="reference"))
    scene = session.drawing.scene
    session.close()
    assert isinstance(scene, RunScene) and scene.modes == (AVATAR,)
    with torch.no_grad():  # as its drawing thread does
        image = scene.picture(resting_place(scene.controls.pivot, 48, 32), (48, 32), 0.0)
    assert image.shape == (32, 48, 3) and image.std() > 5


def test_the_viewer_names_a_file_that_is_missing(tmp_path: Path) -> None:
    pytest.importorskip("viser", reason="needs viser, which serves the viewer: pip install viser")
    with pytest.raises(InputError, match=r"you\.ggavatar"):
        open_session(ViewerOptions(tmp_path / "you.ggavatar", port=0, device="cpu"))
