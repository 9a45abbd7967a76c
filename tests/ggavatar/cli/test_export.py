"""The command ggavatar-export: files, messages, refusals, and nothing left behind after a failure."""

from __future__ import annotations

import dataclasses
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from ggavatar.cli.export import main
from ggavatar.core import Gaussians
from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.formats import export as exporting
from ggavatar.formats.drives import neutral_drive
from ggavatar.formats.imported_run import open_imported_run
from ggavatar.formats.output_folder import atomic_folder
from ggavatar.formats.source_options import GaussianFileOptions
from ggavatar.formats.splats.gaussian_ply import read_gaussian_ply
from ggavatar.formats.splats.stored_gaussians import StoredGaussians, activate
from ggavatar.head.files import load_head
from ggavatar.io.folder_lock import lock_output
from ggavatar.io.json_files import read_json, write_sealed_json
from ggavatar.training.run_folder import open_run
from ggavatar.training.session import train_run
from tests.support.gaussian_cloud import psnr


@pytest.fixture(scope="module")
def run_folder(toy_capture: Capture, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of a few steps; the quality of the avatar does not matter."""
    folder = tmp_path_factory.mktemp("trained") / "run"
    train_run(toy_capture.folder, folder, {"steps": 4, "device": "cpu", "set": ["perceptual_weight=0"]}, quiet=True)
    return folder


def export(*arguments: object) -> int:
    try:
        return main([*map(str, arguments), "--device", "cpu"])
    except SystemExit as leaving:
        return int(leaving.code or 0)


def rendered(run_folder: Path, number: int, path: Path) -> tuple[torch.Tensor, torch.Tensor]:
    """The image of a frame by the run, and by a file exported from it."""
    run = open_run(run_folder)
    file = open_imported_run(path, GaussianFileOptions(capture=run.capture.folder))
    drive, camera = run.reader.drive(number), run.reader.camera(number)
    with torch.no_grad():
        images = [one.rasterize(one.avatar.gaussians(drive), camera, run.background).image for one in (run, file)]
    return images[0], images[1]


def test_a_frame_is_baked_and_drawn_again(run_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    number = open_run(run_folder).split.test[1]
    assert export(run_folder, "--frame", number) == 0
    path = run_folder / "exports" / f"frame-{number:06d}.ply"
    shown = capsys.readouterr().out
    assert f"wrote {path}" in shown and f"next: ggavatar-render {path}" in shown
    ours, theirs = rendered(run_folder, number, path)
    assert float(ours.std()) > 0.02 and psnr(ours, theirs) > 70


def test_bound_layout_moves_like_the_run(
    run_folder: Path, toy_capture: Capture, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    number = toy_capture.frames[0]
    out = tmp_path / "bound"
    assert export(run_folder, "--format", "gaussian-avatars", "--frame", number, "-o", out) == 0
    assert sorted(path.name for path in out.iterdir()) == ["flame_param.npz", "point_cloud.ply"]
    shown = capsys.readouterr().out
    assert "not FLAME" in shown and "--capture" in shown
    ours, theirs = rendered(run_folder, number, out / "point_cloud.ply")
    assert psnr(ours, theirs) > 70
    run = open_run(run_folder)
    rows = read_gaussian_ply(out / "point_cloud.ply")
    assert rows.faces is not None and np.array_equal(rows.faces, run.avatar.rows["face"].numpy())
    assert rows.degree == 3, "GaussianAvatars expects all harmonics"


@pytest.mark.parametrize("kind", ["ply", "splat", "spz"])
def test_neutral_is_the_default(run_folder: Path, kind: str, tmp_path: Path) -> None:
    assert export(run_folder, "--format", kind) == 0
    assert export(run_folder, "--format", kind, "--neutral", "-o", tmp_path / f"b.{kind}") == 0
    assert (run_folder / "exports" / f"neutral.{kind}").read_bytes() == (tmp_path / f"b.{kind}").read_bytes()


def test_rows_of_parameters_are_baked(run_folder: Path, toy_capture: Capture, tmp_path: Path) -> None:
    run = open_run(run_folder)
    head = load_head(toy_capture.head_path)
    tracking = toy_capture.tracking
    names = np.array(head.joint_names)
    np.savez(
        tmp_path / "talk.npz",
        expression=tracking.expression[:3],
        joint_rotations=tracking.joint_rotations[:3],
        joint_names=names,
        version=head.version,
    )
    assert export(run_folder, "--drive", tmp_path / "talk.npz") == 0
    folder = run_folder / "exports" / "talk-ply"
    assert sorted(path.name for path in folder.iterdir()) == ["000000.ply", "000001.ply", "000002.ply"]
    first, third = (activate(read_gaussian_ply(folder / f"00000{row}.ply")) for row in (0, 2))
    assert float((first.means - third.means).abs().max()) > 1e-4, "it moves"
    np.savez(tmp_path / "other.npz", expression=tracking.expression[:3], version="flame2020")
    assert export(run_folder, "--drive", tmp_path / "other.npz") == 2
    assert run.step == 4


@pytest.mark.slow
def test_an_avatar_file_is_exported_and_exported_from(
    run_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Gaussians of the file are those of the run, byte by byte."""
    file = tmp_path / "me.ggavatar"
    assert export(run_folder, "-o", file) == 0
    shown = capsys.readouterr().out
    assert f"wrote {file}" in shown and "likeness of a person" in shown and f"next: ggavatar-render {file}" in shown
    number = open_run(run_folder).split.test[0]
    for source, name in ((run_folder, "a.ply"), (file, "b.ply")):
        assert export(source, "--frame", number, "-o", tmp_path / name) == 0
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()
    assert export(file) == 0 and (tmp_path / "me" / "exports" / "neutral.ply").is_file()
    capsys.readouterr()
    bound = tmp_path / "bound"
    assert export(file, "--format", "gaussian-avatars", "-o", bound) == 0
    assert "--capture CAPTURE" in capsys.readouterr().out
    for arguments, words in (
        ((run_folder, "--format", "avatar", "-o", tmp_path / "a.zip"), "ends with .ggavatar"),
        ((run_folder, "-o", file), "--overwrite"),
        ((run_folder, "-o", tmp_path / "b.ggavatar", "--neutral"), "for every pose"),
        ((run_folder, "-o", tmp_path / "b.ggavatar", "--rank", "8"), "options of web pages"),
        ((file, "--step", "3"), "one step"),
        ((file, "--pose", "still"), "belong to --drive"),
        ((file, "--format", "vhap"), "expected a capture folder"),
    ):
        assert export(*arguments) == 2, arguments
        assert words in capsys.readouterr().err


def test_existing_files_are_replaced_only_on_request(
    run_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.ply"
    path.write_text("mine")
    assert export(run_folder, "-o", path) == 2 and "--overwrite" in capsys.readouterr().err
    assert path.read_text() == "mine"
    assert export(run_folder, "-o", path, "--overwrite") == 0 and len(read_gaussian_ply(path)) > 10
    folder = tmp_path / "bound"
    arguments = (run_folder, "--format", "gaussian-avatars", "-o", folder)
    assert export(*arguments) == 0 and export(*arguments) == 2 and export(*arguments, "--overwrite") == 0
    (folder / "mine.txt").write_text("kept")
    assert export(*arguments, "--overwrite") == 2 and "mine.txt" in capsys.readouterr().err
    assert (folder / "mine.txt").read_text() == "kept" and (folder / "point_cloud.ply").is_file()
    assert not list(tmp_path.glob(".*")), "nothing half-written is left"


def test_a_page_of_a_run(run_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "avatar.html"
    assert export(run_folder, "-o", path, "--prune", "0") == 0
    shown = capsys.readouterr().out
    assert f"wrote {path} (" in shown and "dB against the run" in shown and "next: open it in a browser" in shown
    assert path.read_text().startswith("<!doctype html>")
    refused = {
        ("--format", "web", "-o", tmp_path / "a.ply"): "ends with .html",
        ("--format", "web", "--neutral", "-o", tmp_path / "a.html"): "--frame and --neutral",
        ("--format", "ply", "--clip", "all", "-o", tmp_path / "a.ply"): "--format web",
        ("--format", "web", "--clip", "tests", "-o", tmp_path / "a.html"): "did you mean test?",
        ("-o", path): "--overwrite",
    }
    for flags, reason in refused.items():
        assert export(run_folder, *flags) == 2 and reason in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [path]


def test_a_failure_leaves_nothing(run_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(exporting, "write_flame_parameters", full)
    assert export(run_folder, "--format", "gaussian-avatars", "-o", tmp_path / "bound") == 1
    assert list(tmp_path.iterdir()) == []


def test_folder_comes_back_if_the_last_step_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "a").write_text("old")
    rename = Path.rename

    def fail_for_new(self: Path, target: Path) -> Path:
        if self.name == "new":
            raise OSError(5, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", fail_for_new)
    with pytest.raises(OSError, match="Input/output"), atomic_folder(folder, overwrite=True) as temporary:
        (temporary / "a").write_text("new")
    assert (folder / "a").read_text() == "old" and list(tmp_path.iterdir()) == [folder]


def test_a_capture_is_exported_whole(toy_capture: Capture, capsys: pytest.CaptureFixture[str]) -> None:
    assert export(toy_capture.folder, "--format", "vhap", "--neutral") == 2
    assert "whole capture" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--format", "plx"), "did you mean ply"),
        (("--neutral", "--frame", "3"), "found several"),
        (("--frame", "999"), "no frame 999"),
        (("--drive", "none.npz"), "none.npz"),
        (("--format", "gaussian-avatars", "--frame", "3", "4"), "one --frame"),
        (("--format", "vhap"), "capture folder"),
        (("--step", "3"), "complete checkpoints"),
    ],
)
def test_wrong_arguments(
    run_folder: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], words: str
) -> None:
    assert export(run_folder, *arguments) == 2
    shown = capsys.readouterr().err
    assert words in shown and "Traceback" not in shown


def test_a_device_that_is_not_there_is_one_line(
    run_folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    for device, words in (("cuda", "no CUDA device"), ("tpu", "expected auto, cpu, cuda")):
        assert main([str(run_folder), "--device", device]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith("error: --device") and words in line


def test_no_run_and_unknown_flags(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert export(tmp_path) == 2 and "expected a run folder" in capsys.readouterr().err
    assert export(tmp_path, "--no-such-flag") == 2
    assert export("--help") == 0 and "vhap" in capsys.readouterr().out


def test_help_starts_without_torch() -> None:
    code = (
        "import sys; from ggavatar.cli.export import main\n"
        "try: main(['--help'])\nfinally: print('torch' in sys.modules)"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert shown.returncode == 0 and shown.stdout.rstrip().endswith("False")


def test_methods_without_a_binding_are_bound_to_the_nearest(
    run_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(exporting, "binding_of", lambda *_: None)
    number = open_run(run_folder).capture.frames[0]
    out = tmp_path / "bound"
    assert export(run_folder, "--format", "gaussian-avatars", "--frame", number, "-o", out) == 0
    assert "bound to the nearest" in capsys.readouterr().out
    ours, theirs = rendered(run_folder, number, out / "point_cloud.ply")
    assert psnr(ours, theirs) > 70


def test_methods_with_a_renderer_of_their_own_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    from ggavatar.cli.export import _renderer_notes
    from ggavatar.training import registry

    assert _renderer_notes("ggavatar") == []
    monkeypatch.setattr(registry.load("ggavatar").module, "rasterizer", object(), raising=False)
    assert "renderer of its own" in _renderer_notes("ggavatar")[0]


def test_heads_without_flame_joints_are_refused(run_folder: Path, tmp_path: Path) -> None:
    run = open_run(run_folder)
    head = load_head(run.capture.head_path)
    other = dataclasses.replace(head, joint_names=("root", "chin", "neck", "left_eye", "right_eye"))
    with pytest.raises(InputError, match="FLAME's joints"):
        exporting.export_bound(run, other, neutral_drive(run, head).drive, tmp_path / "x", False)


@pytest.mark.parametrize(
    ("name", "format_flags", "found"),
    [
        ("b.sog", (), "a suffix that cannot be written"),
        ("b.xyz", (), "a suffix that cannot be written"),
        ("b.glb", ("--format", "spz"), "found --format spz"),
    ],
)
def test_a_name_that_says_another_format_is_refused(
    run_folder: Path, tmp_path: Path, name: str, format_flags: tuple[str, ...], found: str,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    assert export(run_folder, "-o", tmp_path / name, *format_flags) == 2
    assert found in capsys.readouterr().err and not (tmp_path / name).exists()
    assert export(run_folder, "-o", tmp_path / "b.bin", "--format", "ply") == 0


def test_a_second_export_is_refused_by_name(
    run_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for path, words in ((tmp_path / "a.ply", ()), (tmp_path / "bound", ("--format", "gaussian-avatars"))):
        with lock_output(path):
            assert export(run_folder, *words, "-o", path) == 2
        shown = capsys.readouterr().err
        assert f"{path}: " in shown and f"(process {os.getpid()} on " in shown
        assert export(run_folder, *words, "-o", path) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.ply", "bound"]


@pytest.mark.parametrize("moment", ["writing", "moved aside", "moved in"])
def test_a_killed_export_of_a_folder_is_put_right_by_the_next(tmp_path: Path, moment: str) -> None:
    """What `kill -9` leaves at each moment of the exchange: never is the earlier export lost."""
    folder, home = tmp_path / "out", tmp_path / ".out.partial"
    (home / "new").mkdir(parents=True)
    (home / "new" / "a").write_text("half")
    folder.mkdir()
    (folder / "a").write_text("old")
    if moment != "writing":
        folder.rename(home / "old")
    if moment == "moved in":
        (home / "new").rename(folder)
    found = {"writing": "old", "moved aside": "old", "moved in": "half"}[moment]
    with pytest.raises(InputError, match="already exists"), atomic_folder(folder, overwrite=False):
        pass
    with pytest.raises(ValueError, match="failed"), atomic_folder(folder, overwrite=True):
        assert (folder / "a").read_text() == found
        raise ValueError("failed")
    assert (folder / "a").read_text() == found and list(tmp_path.iterdir()) == [folder]
    with atomic_folder(folder, overwrite=True) as temporary:
        (temporary / "a").write_text("new")
    assert (folder / "a").read_text() == "new" and list(tmp_path.iterdir()) == [folder]
    home.mkdir()
    (home / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match=r"mine\.txt"), atomic_folder(folder, overwrite=True):
        pass
    assert (home / "mine.txt").read_text() == "mine"


def test_a_run_that_is_removed_meanwhile_does_not_come_back(
    run_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run, plain = tmp_path / "run", exporting.to_stored
    shutil.copytree(run_folder, run, ignore=shutil.ignore_patterns("exports"))

    def removing(gaussians: Gaussians) -> StoredGaussians:
        shutil.rmtree(run)
        return plain(gaussians)

    monkeypatch.setattr(exporting, "to_stored", removing)
    assert export(run) == 1
    assert "removed or renamed" in capsys.readouterr().err and not run.exists()


def test_a_run_that_was_moved_with_its_capture_is_exported(
    run_folder: Path, toy_capture: Capture, tmp_path: Path
) -> None:
    """Its own capture comes first, although the original is still where the training had it."""
    place = Path(os.path.relpath(toy_capture.folder, run_folder))
    run = tmp_path / "a" / "b" / "c" / "run"
    shutil.copytree(run_folder, run, ignore=shutil.ignore_patterns("exports"))
    copy = Path(os.path.normpath(run / place))
    shutil.copytree(toy_capture.folder, copy)
    assert open_run(run).capture.folder.resolve() == copy.resolve()
    assert export(run, "-o", tmp_path / "a.ply") == 0


def test_a_capture_that_was_moved_away_from_its_run_is_named(
    run_folder: Path, toy_capture: Capture, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The message says --capture, and that works."""
    run, moved = tmp_path / "a" / "b" / "c" / "run", tmp_path / "moved"
    shutil.copytree(run_folder, run, ignore=shutil.ignore_patterns("exports"))
    shutil.copytree(toy_capture.folder, moved)
    config = {**read_json(run / "config.json"), "capture": str(tmp_path / "gone")}
    write_sealed_json(run / "config.json", config)
    assert export(run) == 2 and "name its new location with --capture" in capsys.readouterr().err
    capsys.readouterr()
    assert export(run, "--capture", moved) == 0 and "has changed since" not in capsys.readouterr().out
    images = sorted((moved / "images").iterdir())
    images[0].write_bytes(images[1].read_bytes())
    assert export(run, "--capture", moved, "--overwrite") == 0 and "has changed since" in capsys.readouterr().out
    assert export(run / "exports" / "neutral.ply", "--capture", moved, "-o", tmp_path / "a.spz") == 2
    assert "belongs to a run" in capsys.readouterr().err
