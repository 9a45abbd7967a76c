"""ggavatar-render from the outside: output files, refused options, exit codes.

Also covers `evaluate/rendering/options.py`.
"""

from __future__ import annotations

import dataclasses
import json
import shutil
import sys
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
import torch

import evaluate.rendering.jobs
from evaluate.cli.render import main
from evaluate.rendering import jobs, views
from evaluate.rendering.views import straight_alpha
from ggavatar.io.folder_lock import lock_folder
from ggavatar.io.images import read_rgb
from ggavatar.training.run_folder import Run
from tests.support.toy_run import COUNT, HEIGHT, WIDTH, toy_run, write_capture


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    made = toy_run(tmp_path)
    monkeypatch.setattr(evaluate.rendering.jobs, "open_avatar", lambda *_: made)
    return made


def render(monkeypatch: pytest.MonkeyPatch, run: Run, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["ggavatar-render", str(run.folder), "--device", "cpu", *map(str, arguments)])
    try:
        return main()
    except SystemExit as leaving:
        return int(leaving.code or 0)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_test_frames_as_images_video_and_alpha(
    run: Run, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert render(monkeypatch, run, "--alpha") == 0
    folder = run.folder / "renders" / "test"
    assert names(folder / "frames") == names(folder / "rgba") == ["000010.png", "000015.png"]
    with av.open(str(folder / "render.mp4")) as container:
        assert len(list(container.decode(video=0))) == 2
    rgba = cv2.imread(str(folder / "rgba" / "000010.png"), cv2.IMREAD_UNCHANGED)
    alpha = rgba[..., 3:] / 255
    again = rgba[..., 2::-1] * alpha + 255 * (1 - alpha)
    assert alpha.max() > 0.5 and np.abs(again - read_rgb(folder / "frames" / "000010.png")).max() <= 2
    shown = capsys.readouterr()
    written = [str(folder / name) for name in ("frames", "rgba", "render.mp4")]
    assert shown.out.splitlines() == written and "rendering 2/2" in shown.err


def test_orbit_and_its_figure(run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    out = tmp_path / "o"
    assert render(monkeypatch, run, "--orbit", "--views", 8, "--no-video", "-o", out, "--background", "0,0,1") == 0
    assert names(out) == ["frames", "novel_views.png", "render.json"] and len(names(out / "frames")) == 8
    images = [read_rgb(path) for path in sorted((out / "frames").iterdir())]
    assert images[0][0, 0].tolist() == [0, 0, 255] and (images[0] != images[1]).any()


def test_another_capture_drives(run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    write_capture(tmp_path / "driver", seed=5)
    assert render(monkeypatch, run, "--drive", tmp_path / "driver", "--width", 64) == 0
    folder = run.folder / "renders" / "drive-driver"
    assert len(names(folder / "frames")) == COUNT and (folder / "reenactment.png").exists()
    assert read_rgb(folder / "frames" / "000010.png").shape == (2 * HEIGHT, 2 * WIDTH, 3)
    assert json.loads((folder / "render.json").read_text())["options"]["transfer"] == "matched"
    alone = read_rgb(folder / "reenactment.png").shape
    again = ["--drive", tmp_path / "driver", "--width", 64, "--resume", "--no-video", "--beside"]
    assert render(monkeypatch, run, *again, folder) == 0
    assert read_rgb(folder / "reenactment.png").shape[0] > alone[0]
    assert render(monkeypatch, run, *again, tmp_path) == 2


def test_parameters_drive_and_other_bases_do_not(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    motion = np.linspace(0, 1, 5)[:, None] * [1.0, 0, 0]
    np.savez(tmp_path / "params.npz", expression=motion, version="toy-1")
    assert render(monkeypatch, run, "--drive", tmp_path / "params.npz", "--no-video", "--frames", "0:4") == 0
    assert "only expression axes that both heads have" in capsys.readouterr().err
    assert len(names(run.folder / "renders" / "drive-params" / "frames")) == 4
    part = ["--frames", "1:5:2", "-o", tmp_path / "part"]
    assert render(monkeypatch, run, "--drive", tmp_path / "params.npz", "--no-video", *part) == 0
    assert names(tmp_path / "part" / "frames") == ["000001.png", "000003.png"]
    assert (tmp_path / "part" / "reenactment.png").is_file()
    np.savez(tmp_path / "short.npz", expression=motion[:, :2], version="toy-1")
    copied = ["--transfer", "relative", "--no-video"]
    assert render(monkeypatch, run, "--drive", tmp_path / "short.npz", *copied) == 2
    assert "--force-basis" in capsys.readouterr().err
    assert render(monkeypatch, run, "--drive", tmp_path / "short.npz", "--force-basis", *copied) == 0
    np.savez(tmp_path / "flame.npz", expression=motion, version="flame2020")
    assert render(monkeypatch, run, "--drive", tmp_path / "flame.npz", "--force-basis", *copied) == 2
    assert "mean different things" in capsys.readouterr().err
    assert render(monkeypatch, run, "--drive", tmp_path / "flame.npz", "--no-video") == 2
    assert "its head has other axes" in capsys.readouterr().err


def test_a_second_render_is_refused_and_a_typo_of_resume_too(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert render(monkeypatch, run, "--resume", "-o", out) == 2 and not out.exists()
    assert "--resume found nothing to continue here; check -o" in capsys.readouterr().err
    out.mkdir()
    with lock_folder(out):
        assert render(monkeypatch, run, "-o", out) == 2 and "is writing here" in capsys.readouterr().err
    assert not list(out.iterdir())


@pytest.mark.parametrize("flag", ["", "--resume", "--overwrite"])
def test_a_start_that_was_killed_or_failed_blocks_nothing(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, flag: str
) -> None:
    """Without an image there is nothing to lose: the corrected command needs no flag."""
    out, flags = tmp_path / "out", [flag] if flag else []
    (out / "frames").mkdir(parents=True)
    for name in (".lock", ".abc.json.part") if flag else (".lock", "frames/.abc.png.part", ".render.mp4.part"):
        (out / name).touch()
    key = {"--resume": None}.get(flag, "of other options")
    if flag != "--resume":
        (out / "render.json").write_text(json.dumps({"key": key}))
        assert render(monkeypatch, run, "-o", out, *flags) == 0
    else:
        (out / "frames").rmdir()
        assert render(monkeypatch, run, "-o", out, *flags) == 0
    assert names(out) == ["frames", "render.json", "render.mp4"] and len(names(out / "frames")) == 2


def test_overwriting_removes_no_pictures_of_the_user(run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert render(monkeypatch, run, "--no-video", "-o", out) == 0
    (out / "holiday.png").write_bytes(b"mine")
    assert render(monkeypatch, run, "--no-video", "-o", out, "--overwrite") == 0
    assert (out / "holiday.png").read_bytes() == b"mine"


@pytest.mark.parametrize("change", ["checkpoint", "tracking"])
def test_resuming_notices_what_has_changed(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: str
) -> None:
    out = tmp_path / "out"
    assert render(monkeypatch, run, "--no-video", "-o", out) == 0
    changed = dataclasses.replace(run, sha256="01") if change == "checkpoint" else run
    if change == "tracking":
        write_capture(tmp_path / "other", seed=5)
        (run.capture.folder / "tracking.npz").write_bytes((tmp_path / "other" / "tracking.npz").read_bytes())
    monkeypatch.setattr(jobs, "open_avatar", lambda *_: changed)
    assert render(monkeypatch, run, "--no-video", "-o", out, "--resume") == 2
    assert "changed since" in capsys.readouterr().err


def test_a_capture_that_changed_since_the_training_is_said(
    run: Run, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for digest, said in ((run.capture.digest(), False), ("00", True)):
        trained = dataclasses.replace(run, provenance={"capture_sha256": digest})
        monkeypatch.setattr(jobs, "open_avatar", lambda *_, trained=trained: trained)
        assert render(monkeypatch, run, "--no-video", "--overwrite") == 0
        assert ("has changed since" in capsys.readouterr().err) == said


def test_a_folder_that_is_removed_meanwhile_does_not_come_back(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, plain = tmp_path / "out", views.write_png

    def removing(path: Path, image: np.ndarray) -> None:
        shutil.rmtree(out)
        plain(path, image)

    monkeypatch.setattr(views, "write_png", removing)
    assert render(monkeypatch, run, "--no-video", "-o", out) == 1
    assert "removed or renamed" in capsys.readouterr().err and not out.exists()


def test_existing_output(run: Run, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert render(monkeypatch, run, "--no-video") == 0
    folder = run.folder / "renders" / "test"
    first = (folder / "frames" / "000010.png").stat().st_mtime_ns
    assert render(monkeypatch, run) == 2 and "--resume" in capsys.readouterr().err
    (folder / "frames" / "000015.png").unlink()
    assert render(monkeypatch, run, "--resume") == 0
    assert (folder / "frames" / "000010.png").stat().st_mtime_ns == first and len(names(folder / "frames")) == 2
    assert render(monkeypatch, run, "--resume", "--width", 16) == 2 and "other options" in capsys.readouterr().err
    (folder / "frames" / "mine.txt").write_text("kept")
    assert render(monkeypatch, run, "--overwrite", "--width", 16) == 0
    assert names(folder / "frames") == ["000010.png", "000015.png", "mine.txt"]
    assert render(monkeypatch, run, "-o", run.capture.folder) == 2 and "other files" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--orbit", "--drive", "x"], "mutually exclusive"),
        (["--resume", "--overwrite"], "mutually exclusive"),
        (["--views", "0"], "--views"),
        (["--width", "3"], "--width"),
        (["--fps", "0"], "--fps"),
        (["--frames", "5"], "START:STOP"),
        (["--frames", "7:9"], "START:STOP"),
        (["--background", "mauve"], "--background"),
        (["--drive", "no-such-folder"], "capture folder, an .npz"),
        (["--orbit", "--target-neutral", "3"], "no frame 3"),
    ],
)
def test_bad_requests(
    run: Run, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    assert render(monkeypatch, run, *arguments) == 2
    assert words in capsys.readouterr().err
    assert not (run.folder / "renders").exists(), "nothing is written before the options are validated"


def test_not_a_run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    monkeypatch.setattr(sys, "argv", ["ggavatar-render", str(tmp_path)])
    assert main() == 2 and "expected a run folder" in capsys.readouterr().err


def test_an_absent_cuda_device_is_one_line_and_code_2(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(sys, "argv", ["ggavatar-render", str(tmp_path), "--device", "cuda"])
    assert main() == 2
    error = capsys.readouterr().err
    assert "--device cuda: torch finds no CUDA device" in error and error.count("\n") == 1


def test_straight_alpha_composites_back() -> None:
    random = torch.Generator().manual_seed(1)
    alpha = torch.rand((5, 6, 1), generator=random)
    alpha[0] = 0
    color, background = torch.rand((5, 6, 3), generator=random), torch.tensor([0.2, 0.5, 1.0])
    rgba = straight_alpha(color * alpha + background * (1 - alpha), alpha, background)
    torch.testing.assert_close(rgba[1:, :, :3], color[1:], atol=1e-4, rtol=0)
    torch.testing.assert_close(rgba[..., 3:], alpha)
    assert not rgba[0, :, :3].any()
