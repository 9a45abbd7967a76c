"""The functions do what the commands do, and say nothing. Also covers `ggavatar/api/runs.py`, `ggavatar/api/images.py`,
`ggavatar/api/performances.py`, `ggavatar/api/exporting.py`, `evaluate/api/scores.py`, `evaluate/api/tables.py` and
`evaluate/scoring/folders.py`.

References: the files that the commands write for the same run.
"""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest

import ggavatar
from evaluate.cli.evaluate import main as evaluate
from ggavatar.api.performances import _recording
from ggavatar.cli.export import main as export_command
from ggavatar.data.capture import Capture
from ggavatar.formats.arkit_recording import ARKIT_NAMES, read_arkit_recording
from ggavatar.io.images import read_rgb, write_png
from ggavatar.training.run_folder import Run


@pytest.fixture(scope="module")
def run(toy_capture: Capture, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run of six steps on the egg; tests must not change it."""
    folder = tmp_path_factory.mktemp("api") / "run"
    settings = {"perceptual_weight": 0.0}
    return ggavatar.train(
        toy_capture, folder, "ggavatar", preset="fast", steps=6, eval_every=0, device="cpu", settings=settings
    )


def test_values_have_short_reprs(run: Run, toy_capture: Capture) -> None:
    assert repr(run).startswith("Run('ggavatar', 6 steps, subject 'egg', '")
    assert repr(run.capture).startswith("Capture('egg', 24 frames of 48×48 px at 25 fps, head 'egg-1', '")
    assert repr(toy_capture.tracking) == "Tracking(24 frames, 3 expression axes, 5 joints)"
    drive, camera = run.reader.drive(3), run.reader.camera(3)
    assert repr(drive) == "Drive(frame 3, 3 expression axes, 5 joints)"
    assert repr(camera) == "Camera(48×48 px, focal length 124.8 px)"
    assert repr(run.avatar.gaussians(drive)).endswith("harmonics, on cpu)")


def test_it_says_nothing_unless_asked(
    run: Run, toy_capture: Capture, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    options = {"steps": 2, "eval_every": 0, "device": "cpu", "settings": {"perceptual_weight": 0}}
    ggavatar.train(toy_capture, tmp_path / "quiet", **options)
    ggavatar.score_run(run, metrics=["psnr"], learned=False)
    ggavatar.export(run, tmp_path / "a.ply")
    assert capfd.readouterr() == ("", "")
    ggavatar.train(toy_capture.folder, tmp_path / "quiet", **options, overwrite=True, progress=True)
    assert "2 steps" in capfd.readouterr().out


def test_a_run_is_resumed_and_reopened(run: Run, toy_capture: Capture) -> None:
    again = ggavatar.train(toy_capture, run.folder, resume=True, device="cpu")
    opened = ggavatar.open_run(str(run.folder), device="cpu")
    assert again.step == opened.step == 6 and again.sha256 == opened.sha256 == run.sha256
    assert ggavatar.open_capture(toy_capture.folder).digest() == toy_capture.digest()
    with pytest.raises(ggavatar.InputError, match="already holds a run"):
        ggavatar.train(toy_capture, run.folder, device="cpu")


def test_a_capture_that_changed_since_the_training_is_a_warning(run: Run, toy_capture: Capture, tmp_path: Path) -> None:
    changed = tmp_path / "changed"
    shutil.copytree(toy_capture.folder, changed)
    image = changed / "images" / f"{toy_capture.frames[0]:06d}.png"
    write_png(image, 255 - read_rgb(image))
    with pytest.warns(UserWarning, match=r"changed has changed since .* was trained on it"):
        ggavatar.open_run(run.folder, device="cpu", capture=changed)


def test_an_avatar_file_is_not_scored_and_wrong_numbers_are_refused(run: Run, tmp_path: Path) -> None:
    ggavatar.export(run, tmp_path / "me.ggavatar")
    with pytest.raises(ggavatar.InputError, match="expected a run, found an avatar file, which holds no photographs"):
        ggavatar.score_run(ggavatar.open_run(tmp_path / "me.ggavatar", device="cpu"))
    with pytest.raises(ggavatar.InputError, match="frames per second above 0"):
        ggavatar.drive(run, {"jawOpen": [0.0, 1.0]}, fps=0)
    with pytest.raises(ggavatar.InputError, match="frames per second above 0"):
        ggavatar.write_video(tmp_path / "a.mp4", np.zeros((1, 16, 16, 3), np.uint8), fps=0.0)
    with pytest.raises(ggavatar.InputError, match="expected one of auto, subjects, ablation, found 'x'"):
        ggavatar.make_tables([], layout="x")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["me.ggavatar"]


@pytest.mark.parametrize(
    ("call", "name", "meant"),
    [
        ("train", "stepz", "steps"),
        ("drive", "pos", "pose"),
        ("export", "frame", "frames"),
        ("score_run", "metric", "metrics"),
    ],
)
def test_unknown_options_are_type_errors(call: str, name: str, meant: str, run: Run) -> None:
    arguments = {"train": (run.capture, "out"), "drive": (run, {}), "export": (run, "out"), "score_run": (run,)}[call]
    expected = rf"^{call}\(\) got an unexpected keyword argument '{name}' \(did you mean {meant}\?\)"
    with pytest.raises(TypeError, match=expected):
        getattr(ggavatar, call)(*arguments, **{name: 1})


def test_images_and_scores_are_those_of_the_command(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    found = ggavatar.score_run(run, metrics=["psnr", "ssim"], learned=False)
    flags = ["--metrics", "psnr", "ssim", "--no-learned", "--no-report", "--device", "cpu", "-q"]
    assert evaluate([str(run.folder), *flags]) == 0
    (home,) = (run.folder / "eval").glob("*ssim*")
    assert ggavatar.read_scores(home).values == found.values
    assert repr(found).startswith(f"Evaluation('egg', 'ggavatar', {found.protocol.id}, 5 frames: PSNR ")
    images = ggavatar.render_frames(run)
    files = [read_rgb(home / "predictions" / f"{number:06d}.png") for number in run.split.test]
    assert images.dtype == np.uint8 and images.shape == (5, 48, 48, 3)
    np.testing.assert_array_equal(images, files)
    assert ggavatar.render_frames(run, [3], width=24, background="black").shape == (1, 24, 24, 3)
    assert ggavatar.render_frames(run, []).shape == (0, 48, 48, 3)
    assert ggavatar.render_frames(run, [], width=24).shape == (0, 24, 24, 3)
    pictures = ggavatar.score_pictures(
        home / "predictions", run.capture, "mine", metrics=["psnr", "ssim"], learned=False
    )
    assert pictures.method == "mine" and pictures.values == found.values
    folders = ggavatar.score_folders(
        home / "predictions", home / "ground_truth", label="mine", metrics=["psnr"], learned=False
    )
    assert folders.values["psnr"] == found.values["psnr"]


def test_tables_hold_the_means(run: Run, tmp_path: Path) -> None:
    found = ggavatar.score_run(run, metrics=["psnr", "l1"], table_metrics=["psnr", "l1"], learned=False)
    table = ggavatar.make_tables([found, found], labels=["one", "two"])[0]
    frame = table.to_dataframe()
    assert frame.to_numpy().ravel()[0] == pytest.approx(found.summary("psnr").mean)
    assert "one" in table._repr_html_() and repr(table).startswith("Table('comparison', ")
    assert {path.suffix for path in ggavatar.write_tables([table], tmp_path)} == {
        ".md",
        ".tex",
        ".csv",
        ".html",
        ".json",
    }
    with pytest.raises(ggavatar.InputError, match="one label for each of 2 evaluations, found 1"):
        ggavatar.make_tables([found, found], labels=["one"])
    escaped = dataclasses.replace(table, caption="<script>")
    assert "<script>" not in escaped._repr_html_()


def test_an_avatar_repeats_its_own_performance(run: Run, tmp_path: Path) -> None:
    """Copied coefficients give the images of its own frames; the notebook on curves drives a head with ARKit's axes."""
    options = {"transfer": "absolute", "pose": "absolute", "smooth": "none", "limit": -1.0}
    performance = ggavatar.drive(run, run.capture, **options)
    assert performance.frames == run.capture.frames and "24 frames at 25 fps" in repr(performance)
    images = ggavatar.render_performance(run, performance, slice(0, 8, 4))
    np.testing.assert_allclose(images, ggavatar.render_frames(run, run.capture.frames[:8:4]), atol=1)
    assert ggavatar.write_video(tmp_path / "v.mp4", images, 10.0).stat().st_size > 500


def test_curves_are_a_recording_that_every_command_opens(run: Run, tmp_path: Path) -> None:
    path = _recording(tmp_path / "curves.npz", {"jawOpen": np.linspace(0, 1, 8), "mouthPucker": [0.5] * 8}, 10.0)
    found = read_arkit_recording(path)
    np.testing.assert_allclose(found.times, np.arange(8) / 10)
    np.testing.assert_allclose(found.scores[:, ARKIT_NAMES.index("jawOpen")], np.linspace(0, 1, 8))
    assert found.scores.sum() == pytest.approx(4 + 4)
    with pytest.raises(ggavatar.InputError, match=r"found 'jawOpn' \(did you mean jawOpen\?\)"):
        ggavatar.drive(run, {"jawOpn": [0.0]})
    with pytest.raises(ggavatar.InputError, match=r"curves of one length of 1 or more, found \[1, 2\]"):
        ggavatar.drive(run, {"jawOpen": [0.0], "mouthClose": [0.0, 1.0]})


@pytest.mark.parametrize("name", ["a.ply", "a.html"])
def test_exports_are_those_of_the_command(name: str, run: Run, tmp_path: Path) -> None:
    result = ggavatar.export(run, tmp_path / name)
    assert export_command([str(run.folder), "-o", str(tmp_path / f"command-{name}"), "--device", "cpu"]) == 0
    ours, theirs = (tmp_path / name).read_bytes(), (tmp_path / f"command-{name}").read_bytes()
    assert result.path == tmp_path / name and (ours == theirs or (name == "a.html" and len(ours) == len(theirs)))
    with pytest.raises(ggavatar.InputError, match="already exists"):
        ggavatar.export(run.folder, tmp_path / name)


def test_other_sources_of_exports(run: Run, tmp_path: Path) -> None:
    ggavatar.export(run, tmp_path / "a.ply")
    assert ggavatar.export(tmp_path / "a.ply", tmp_path / "b.spz").gaussians > 100
    assert ggavatar.open_run(ggavatar.export(run, tmp_path / "a.ggavatar").path, device="cpu").step == 6
    with pytest.raises(ggavatar.InputError, match="unknown format 'vhap' of a run; it is a format of captures"):
        ggavatar.export(run, tmp_path / "x", "vhap")


def test_lists_know_everything() -> None:
    assert {"ggavatar", "point_avatar"} <= set(ggavatar.list_methods())
    assert ggavatar.list_metrics()["psnr"].title == "PSNR" and "vhap" in ggavatar.list_importers()
