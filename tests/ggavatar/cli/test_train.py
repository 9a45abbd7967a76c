"""The command ggavatar-train: exit codes, messages, nothing lost."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from ggavatar.cli import train as train_command
from ggavatar.cli.train import Arguments, options_of
from ggavatar.data.capture import Capture
from ggavatar.pretrained.folders import is_offline, model_folders


def train(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    """Run the entry point in this process."""
    monkeypatch.setattr(sys, "argv", ["ggavatar-train", *words])
    try:
        return train_command.train()
    except SystemExit as stop:
        return int(stop.code or 0)


def test_help_lists_methods_and_starts_without_torch() -> None:
    code = (
        "import sys; sys.argv = ['ggavatar-train', '--help']\nfrom ggavatar.cli import train\n"
        "try: train.train()\nfinally: print('torch' in sys.modules)"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert shown.returncode == 0 and shown.stdout.rstrip().endswith("False")
    assert "ggavatar_without_triplane" in shown.stdout


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["{missing}", "-o", "{out}"], "no such file"),
        (["{capture}"], "-o RUN"),
        (["{capture}", "gavatar", "-o", "{out}"], "did you mean ggavatar?"),
        (["{capture}", "-o", "{out}", "--set", "latnet=3"], "did you mean latent?"),
        (["{capture}", "-o", "{out}", "--set", "latent=many"], "expected int"),
        (["{capture}", "-o", "{out}", "--steps", "0"], "--steps"),
        (["{capture}", "-o", "{out}", "--device", "tpu"], "--device"),
        (["{capture}", "-o", "{out}", "--background", "2,0,0"], "--background"),
        (["{capture}", "-o", "{out}", "--split", "some"], "split"),
        (["{capture}", "-o", "{out}", "--backend", "vulkan"], "expected one of auto, cpu"),
        (["{capture}", "-o", "{out}", "--resume", "--overwrite"], "mutually exclusive"),
        (["{capture}", "-o", "{file}"], "found a file"),
        (["{capture}", "-o", "{out}", "--sede", "1"], "--seed"),
    ],
)
def test_bad_input_is_refused_with_a_way_out(
    words: list[str],
    message: str,
    toy_capture: Capture,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "file").write_text("mine")
    places = {
        "capture": toy_capture.folder,
        "missing": tmp_path / "nowhere",
        "out": tmp_path / "r ü n",
        "file": tmp_path / "file",
    }
    assert train(monkeypatch, *(word.format(**places) for word in words)) == 2
    shown = capfd.readouterr().err
    assert message in shown and "Traceback" not in shown
    assert (tmp_path / "file").read_text() == "mine"


def test_training_says_what_it_wrote_and_what_is_next(
    toy_capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "a run with spaces"
    words = [str(toy_capture.folder), "-o", str(out), "--steps", "6", "--device", "cpu", "--background", "0.5,0.5,0.5"]
    assert train(monkeypatch, *words) == 0
    lines = capfd.readouterr().out.splitlines()
    assert "step 6/6" in lines[-3] and "loss" in lines[-3] and "Gaussians" in lines[-3]
    assert lines[-2:] == [f"wrote {out} (6 steps)", f"next: ggavatar-eval {out} --table"]
    config, provenance = (json.loads((out / name).read_text()) for name in ("config.json", "provenance.json"))
    assert config["background"] == [0.5, 0.5, 0.5] and config["method_config"]["latent"] == 32
    assert provenance["finished"] and provenance["steps"] == 6 and len(provenance["capture_sha256"]) == 64
    assert train(monkeypatch, *words, "--resume") == 0


def test_models_and_offline_reach_the_perceptual_loss_and_no_configuration(
    toy_capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Through the environment: it says where this computer keeps files, which is no property of a run."""
    given = tmp_path / "models"
    monkeypatch.setenv("GGAVATAR_MODELS", "elsewhere")
    monkeypatch.setenv("GGAVATAR_OFFLINE", "0")
    words = [str(toy_capture.folder), "-o", str(tmp_path / "run"), "--steps", "2", "--device", "cpu", "--offline"]
    assert train(monkeypatch, *words, "--models", str(given)) == 2
    assert "models: no such folder" in capfd.readouterr().err and not (tmp_path / "run").exists()
    given.mkdir()
    assert train(monkeypatch, *words, "--models", str(given)) == 0
    assert model_folders()[0] == given and is_offline()
    config = json.loads((tmp_path / "run" / "config.json").read_text())
    assert not {"models", "offline"} & set(config)


def test_options_left_open_are_absent() -> None:
    assert options_of(Arguments(Path("c"), Path("r"), steps=3)) == {
        "steps": 3,
        "set": [],
        "resume": False,
        "overwrite": False,
    }


def test_read_only_capture_is_fine_and_unwritable_output_is_a_failure(
    toy_capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    from ggavatar.training import session

    def refuse(folder: Path, overwrite: bool) -> None:
        raise PermissionError(13, "Permission denied", str(folder))

    monkeypatch.setattr(session, "create_run_folder", refuse)
    assert train(monkeypatch, str(toy_capture.folder), "-o", str(tmp_path / "run"), "--device", "cpu") == 1
    assert "check the permissions" in capfd.readouterr().err
