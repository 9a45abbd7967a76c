"""Opening runs: what evaluation relies on, and what happens when something is missing, moved or damaged."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import torch

from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.head.files import load_head
from ggavatar.io.json_files import read_json
from ggavatar.pretrained.resolve import ModelUnavailable
from ggavatar.training.run_folder import choose_split, open_run, read_config
from ggavatar.training.session import configure, describe, train_run, with_settled_features

OPTIONS: dict[str, Any] = {"steps": 6, "save_every": 3, "device": "cpu", "set": ["perceptual_weight=0"]}


@pytest.fixture(scope="module")
def finished(toy_capture: Capture, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run beside a copy of its capture."""
    home = tmp_path_factory.mktemp("home")
    shutil.copytree(toy_capture.folder, home / "capture")
    train_run(home / "capture", home / "run", OPTIONS, quiet=True)
    return home / "run"


@pytest.fixture
def copy(finished: Path, tmp_path: Path) -> Path:
    """A run and its capture, moved together to another place, and free to be damaged."""
    shutil.copytree(finished.parent, tmp_path / "moved")
    return tmp_path / "moved" / "run"


def test_run_has_what_evaluation_needs(finished: Path) -> None:
    run = open_run(finished)
    assert (run.method, run.step, run.capture.subject) == ("ggavatar", 6, "egg")
    assert not run.avatar.training and run.background.tolist() == [1.0, 1.0, 1.0]
    assert run.config.training.steps == 6 and run.provenance["finished"] is True
    frames = list(run.frames(run.split.test))
    assert [frame.drive.frame for frame in frames] == list(run.split.test)
    assert frames[0].image.shape == (48, 48, 3)
    with torch.no_grad():
        rendering = run.rasterize(run.avatar.gaussians(frames[0].drive), frames[0].camera, run.background)
    assert rendering.image.shape == frames[0].image.shape


def test_earlier_checkpoint_can_be_opened(finished: Path) -> None:
    early, late = open_run(finished, step=3), open_run(finished)
    assert early.step == 3
    assert not torch.equal(early.avatar.rows["means"], late.avatar.rows["means"])
    with pytest.raises(InputError, match="complete checkpoints: 6, 3"):
        open_run(finished, step=4)


def test_run_finds_a_capture_that_moved_along(copy: Path) -> None:
    config = read_json(copy / "config.json")
    config["capture"] = "/nowhere/else"
    (copy / "config.json").write_text(json.dumps(config))
    assert open_run(copy).capture.folder.resolve() == (copy.parent / "capture").resolve()


def test_a_run_of_an_earlier_build_opens(copy: Path) -> None:
    """They hold the settings of the command line, and no digest of the file."""
    config = read_json(copy / "config.json")
    (copy / "config.json").write_text(json.dumps({**config, "settings": ["latent=3"]}))
    assert open_run(copy).config == read_config(copy) and read_config(copy).method == "ggavatar"


def test_lost_capture_is_named_and_can_be_given(copy: Path) -> None:
    config = read_json(copy / "config.json")
    (copy / "config.json").write_text(json.dumps({**config, "capture": "/nowhere/else"}))
    (copy.parent / "capture").rename(copy.parent / "elsewhere")
    with pytest.raises(InputError, match="/nowhere/else"):
        open_run(copy)
    assert open_run(copy, capture=copy.parent / "elsewhere").step == 6


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 99}, "version 1"),
        ({"schema": "other"}, "schema"),
        ({"colour": 1}, "unknown setting 'colour'"),
        ({"seed": "many"}, "expected int"),
        ({"method_config": {"latnet": 3}}, "did you mean latent"),
        ({"method": "gavatar"}, "did you mean ggavatar"),
    ],
)
def test_damaged_config_is_refused(copy: Path, change: dict[str, Any], message: str) -> None:
    config = read_json(copy / "config.json")
    (copy / "config.json").write_text(json.dumps({**config, **change}))
    with pytest.raises(InputError, match=message):
        open_run(copy)


def test_a_changed_setting_is_noticed(copy: Path) -> None:
    """Its seal no longer fits; without a seal, as version 0.1 wrote it, the change is taken as meant."""
    text = (copy / "config.json").read_text()
    assert text.count('"seed": 42') == 1
    (copy / "config.json").write_text(text.replace('"seed": 42', '"seed": 43'))
    with pytest.raises(InputError, match=r"config\.json: changed since .* remove its entry 'content_sha256'"):
        open_run(copy)
    values = json.loads((copy / "config.json").read_text())
    del values["content_sha256"]
    (copy / "config.json").write_text(json.dumps(values))
    assert open_run(copy).config.seed == 43


@pytest.mark.parametrize("name", ["split.json", "provenance.json"])
def test_other_records_of_a_run_are_sealed_too(copy: Path, name: str) -> None:
    text = (copy / name).read_text()
    place = next(place for place, letter in enumerate(text) if letter.isdigit())
    (copy / name).write_text(f"{text[:place]}{(int(text[place]) + 1) % 10}{text[place + 1 :]}")
    with pytest.raises(InputError, match=f"{name}: "):
        open_run(copy)


@pytest.mark.parametrize("text", ["", "[1, 2]", "{", "{}"])
def test_config_that_is_no_object_is_refused(copy: Path, text: str) -> None:
    (copy / "config.json").write_text(text)
    with pytest.raises(InputError, match=r"config\.json"):
        open_run(copy)


def test_any_folder_is_not_a_run(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected a run folder"):
        read_config(tmp_path)
    with pytest.raises(InputError, match="no such folder"):
        read_config(tmp_path / "absent")
    (tmp_path / "capture.json").write_text("{}")
    with pytest.raises(InputError, match="train on it first"):
        read_config(tmp_path)


def test_missing_split_is_named(copy: Path) -> None:
    (copy / "split.json").unlink()
    with pytest.raises(InputError, match=r"split\.json"):
        open_run(copy)


def test_split_by_name_or_by_rule(toy_capture: Capture) -> None:
    assert choose_split(toy_capture, "every-20th") == ("every-20th", toy_capture.splits["every-20th"])
    name, split = choose_split(toy_capture, "ratio-0.75")
    assert name == "ratio-0.75" and split.test == toy_capture.frames[18:]


def test_a_budget_below_the_triangles_is_refused_before_anything_is_written(
    toy_capture: Capture, tmp_path: Path
) -> None:
    faces = len(load_head(toy_capture.head_path).faces)
    options = {"method": "ggavatar", "steps": 2, "eval_every": 0, "device": "cpu"}
    with pytest.raises(InputError, match=rf"--max-gaussians {faces - 1}: expected at least {faces} for ggavatar"):
        train_run(toy_capture.folder, tmp_path / "run", {**options, "max_gaussians": faces - 1}, quiet=True)
    assert not (tmp_path / "run").exists()
    assert train_run(toy_capture.folder, tmp_path / "run", {**options, "max_gaussians": faces}, quiet=True) == 2


@pytest.mark.parametrize(
    "method",
    [
        "flash_avatar",
        "gaussian_avatars",
        "gaussian_blendshapes",
        "ggavatar_plus",
        "point_avatar",
        "ps_avatar",
        "splatting_avatar",
    ],
)
def test_max_gaussians_is_a_limit_from_the_first_step(method: str, toy_capture: Capture, tmp_path: Path) -> None:
    limit = max(len(load_head(toy_capture.head_path).faces), 150)
    options = {"method": method, "steps": 1, "eval_every": 0, "device": "cpu", "max_gaussians": limit}
    train_run(toy_capture.folder, tmp_path / "run", {**options, "set": ["perceptual_weight=0"]}, quiet=True)
    run = open_run(tmp_path / "run")
    assert 0 < len(run.avatar.gaussians(run.reader.drive(run.split.train[0])).means) <= limit


def test_the_features_that_are_compared_are_settled_before_the_training(
    toy_capture: Capture, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Without VGG16 `best` becomes `random` in the run's settings; the paper's preset refuses unless told by name."""
    monkeypatch.setattr("ggavatar.losses.vgg.resolve", _unavailable)
    config = with_settled_features(configure(toy_capture, {"method": "ggavatar", "device": "cpu"})[0])
    assert config.method_config["perceptual_features"] == "random"
    assert describe(config).endswith("seed 42, perceptual loss on random features")
    paper = {"method": "ggavatar", "device": "cpu", "preset": "paper"}
    with pytest.raises(InputError, match="--set perceptual_features=random"):
        train_run(toy_capture.folder, tmp_path / "run", paper, quiet=True)
    assert not (tmp_path / "run").exists()
    wish = {**paper, "set": ["perceptual_features=random", "scale_rate=0.5"]}
    config = with_settled_features(configure(toy_capture, wish)[0])
    assert config.method_config["perceptual_features"] == "random"
    assert describe(config).startswith("ggavatar, preset paper, with scale_rate=0.5, 120,000 steps")


def _unavailable(*_: object, **__: object) -> Path:
    raise ModelUnavailable("no VGG16 here")


def test_a_presets_budget_suffices_for_any_head(toy_capture: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ggavatar.methods.ggavatar.least_gaussians", lambda head: 55_555)
    config, _ = configure(toy_capture, {"method": "ggavatar", "device": "cpu", "preset": "fast"})
    assert config.training.max_gaussians == 55_555
