"""ggavatar-render and ggavatar-eval on files of Gaussians, rendered and scored like runs. Reference: the run itself."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from evaluate.cli import evaluate as cli
from evaluate.cli import render as render_cli
from evaluate.rendering.standalone_file import extent, open_standalone
from ggavatar.core import Gaussians
from ggavatar.data.capture import Capture
from ggavatar.formats.source_options import GaussianFileOptions
from ggavatar.formats.splats.gaussian_ply import write_gaussian_ply
from ggavatar.formats.splats.stored_gaussians import to_stored
from ggavatar.formats.unbinding import unbind
from ggavatar.geometry.triangles import triangle_frames
from ggavatar.io.images import read_rgb
from ggavatar.render.reference import rasterize
from tests.support.toy_run import camera, head, toy_run, write_capture


def render(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    fixed = ["--device", "cpu", "--backend", "reference", "--no-video"]
    monkeypatch.setattr(sys, "argv", ["ggavatar-render", *map(str, arguments), *fixed])
    try:
        return render_cli.main()
    except SystemExit as leaving:
        return int(leaving.code or 0)


def evaluate(*arguments: object) -> int:
    return cli.main([*map(str, arguments), "--no-lpips", "--no-report", "-q", "--device", "cpu"])


@pytest.fixture
def capture(tmp_path: Path) -> Capture:
    return write_capture(tmp_path / "capture")


@pytest.fixture
def plain(tmp_path: Path) -> Path:
    """The toy avatar as posed in frame 10."""
    run = toy_run(tmp_path / "home")
    with torch.no_grad():
        gaussians = run.avatar.gaussians(run.reader.drive(10))
    write_gaussian_ply(tmp_path / "baked.ply", to_stored(gaussians))
    return tmp_path / "baked.ply"


@pytest.fixture
def bound(tmp_path: Path, capture: Capture) -> Path:
    """Three Gaussians on the three triangles of the toy head."""
    model = head()
    frames = triangle_frames(model.template, model.faces)
    colors = torch.eye(3) * 0.8
    balls = Gaussians(
        frames.centers, torch.eye(1, 4).expand(3, 4), torch.full((3, 3), 0.03), torch.full((3,), 0.9), colors
    )
    write_gaussian_ply(tmp_path / "point_cloud.ply", unbind(balls, torch.arange(3), frames))
    return tmp_path / "point_cloud.ply"


def test_plain_file_is_drawn_by_a_captures_cameras(
    plain: Path, capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert render(monkeypatch, plain, "--capture", capture.folder) == 0
    folder = tmp_path / "baked" / "renders" / "test"
    assert sorted(path.name for path in (folder / "frames").iterdir()) == ["000010.png", "000015.png"]
    run = toy_run(tmp_path / "again")
    with torch.no_grad():
        drawn = run.rasterize(run.avatar.gaussians(run.reader.drive(10)), camera(), torch.ones(3)).image
    expected = (drawn.clamp(0, 1) * 255).round().numpy()
    assert np.abs(read_rgb(folder / "frames" / "000010.png").astype(float) - expected).max() <= 1
    assert np.ptp(expected) > 100, "the avatar is in the image"
    same = read_rgb(folder / "frames" / "000015.png")
    assert np.array_equal(same, read_rgb(folder / "frames" / "000010.png")), "it stands still, the camera too"


def test_bound_file_moves_with_the_captures_head(
    bound: Path, capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert render(monkeypatch, bound, "--capture", capture.folder, "--split", "all") == 0
    folder = tmp_path / "point_cloud" / "renders" / "all" / "frames"
    first, last = (read_rgb(folder / f"{number:06d}.png") for number in (10, 15))
    assert len(list(folder.iterdir())) == 6 and not np.array_equal(first, last)
    assert render(monkeypatch, bound, "--capture", capture.folder, "--split", "all", "--resume") == 0
    write_gaussian_ply(bound, to_stored(_one_ball()))
    assert render(monkeypatch, bound, "--capture", capture.folder, "--split", "all", "--resume") == 2


def _one_ball() -> Gaussians:
    return Gaussians(torch.zeros(1, 3), torch.eye(1, 4), torch.full((1, 3), 0.02), torch.ones(1), torch.zeros(1, 3))


def test_orbit_without_a_capture(
    plain: Path, bound: Path, capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("evaluate.rendering.standalone_file.IMAGE_SIDE", 64)
    orbit = ("--orbit", "--views", 3)
    assert render(monkeypatch, plain, *orbit) == 0
    folder = tmp_path / "baked" / "renders" / "orbit"
    assert len(list((folder / "frames").iterdir())) == 3 and (folder / "novel_views.png").is_file()
    front = read_rgb(folder / "frames" / "000000.png")
    assert (front < 200).any() and (front[[0, -1]] > 240).all(), "all of it is in the image"
    assert render(monkeypatch, bound, *orbit) == 2
    assert render(monkeypatch, bound, *orbit, "--head-model", capture.head_path) == 0
    assert render(monkeypatch, bound, *orbit, "--capture", capture.folder, "--overwrite") == 0


def test_front_camera_sees_the_face_upright(tmp_path: Path) -> None:
    """A green ball above a red one above the origin, seen from +Z."""
    balls = Gaussians(
        torch.tensor([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]]),
        torch.eye(1, 4).expand(2, 4),
        torch.full((2, 3), 0.02),
        torch.full((2,), 0.95),
        torch.tensor([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
    )
    write_gaussian_ply(tmp_path / "balls.ply", to_stored(balls))
    file = open_standalone(tmp_path / "balls.ply", GaussianFileOptions(), "cpu", "reference")
    drive, view, center = file.front_view()
    assert float(center.abs().max()) < 0.01 and extent(balls)[1] == pytest.approx(0.096 + 0.04, abs=1e-3)
    image = rasterize(file.avatar.gaussians(drive), view.resized(64, 64), torch.zeros(3)).image
    assert image[:32].mean((0, 1)).argmax() == 1 and image[32:].mean((0, 1)).argmax() == 0


@pytest.mark.parametrize("which", ["plain", "bound"])
def test_file_is_scored_like_a_run(
    which: str, request: pytest.FixtureRequest, capture: Capture, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = request.getfixturevalue(which)
    assert evaluate(path, "--capture", capture.folder, "--table") == 0
    home = tmp_path / path.stem / "eval" / "paper-v1+resolution=32x24"
    found = json.loads((home / "metrics.json").read_text())
    assert found["frames"] == [10, 15] and found["seed"] is None and found["subject"] == "toy"
    assert found["method"] == {"plain": "3DGS file", "bound": "GaussianAvatars file"}[which]
    assert any("training frames are not known" in note for note in found["notes"])
    assert np.isfinite(found["summary"]["psnr"]["mean"]) and found["efficiency"]["gaussians"] > 1
    assert (tmp_path / path.stem / "table.md").is_file()
    assert found["method"] in capsys.readouterr().out
    strict = (path, "--capture", capture.folder, "--protocol", "strict")
    assert evaluate(*strict) == 0
    other = tmp_path / path.stem / "eval" / "strict-v1+resolution=32x24" / "metrics.json"
    assert json.loads(other.read_text())["frames"] == [15]


def test_scores_follow_the_file(plain: Path, capture: Capture, tmp_path: Path) -> None:
    metrics = tmp_path / "baked" / "eval" / "paper-v1+resolution=32x24" / "metrics.json"
    assert evaluate(plain, "--capture", capture.folder) == 0
    before = json.loads(metrics.read_text())["summary"]["psnr"]["mean"]
    write_gaussian_ply(plain, to_stored(_one_ball()))
    assert evaluate(plain, "--capture", capture.folder) == 0
    assert json.loads(metrics.read_text())["summary"]["psnr"]["mean"] != before


def test_files_and_runs_stand_in_one_table(plain: Path, bound: Path, capture: Capture, tmp_path: Path) -> None:
    out = tmp_path / "table"
    assert evaluate(plain, bound, "--capture", capture.folder, "-o", out) == 0
    text = (out / "table.md").read_text()
    assert "3DGS file" in text and "GaussianAvatars file" in text


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("FILE",), "--capture DIR"),
        (("FILE", "--capture", "nowhere"), "capture.json"),
        (("FILE", "--orbit", "--head-model", "x.pkl"), "found no binding_0"),
        (("missing.ply", "--orbit"), "no such file"),
        (("RUN", "--axes", "viewer"), "belong to a file of Gaussians"),
    ],
)
def test_what_is_missing_is_said(
    plain: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[str, ...],
    words: str,
) -> None:
    (tmp_path / "run").mkdir()
    given = [{"FILE": str(plain), "RUN": str(tmp_path / "run")}.get(word, word) for word in arguments]
    assert render(monkeypatch, *given) == 2
    shown = capsys.readouterr().err
    assert words in shown and "Traceback" not in shown


def test_eval_of_a_file_needs_a_capture(plain: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate(plain) == 2 and "--capture DIR" in capsys.readouterr().err
    plain.write_bytes(b"ply\n")
    assert evaluate(plain, "--capture", tmp_path / "capture") == 2


def test_a_run_whose_capture_moved(tmp_path: Path, capture: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    """--capture with a run goes to `open_avatar`."""
    import evaluate.rendering.jobs as jobs

    made, asked = toy_run(tmp_path / "home"), []
    monkeypatch.setattr(jobs, "open_avatar", lambda *given: asked.append(given) or made)
    assert render(monkeypatch, made.folder, "--capture", capture.folder) == 0
    assert asked[0][-1] == capture.folder
