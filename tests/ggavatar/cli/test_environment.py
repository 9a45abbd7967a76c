"""The report on this computer: torch, the finder of models and the installed packages are the reference."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from ggavatar.cli import environment as module
from ggavatar.cli.environment import environment, environment_lines
from ggavatar.pretrained.catalogue import MODELS
from ggavatar.render.backends import BACKENDS, choice, lacking, load, pick, resolve_device
from preprocess.cli.doctor import main


def test_it_says_what_is_here() -> None:
    report = environment()
    assert report["versions"]["torch"] == torch.__version__ and report["versions"]["numpy"] == np.__version__
    assert report["device"]["auto"] == resolve_device("auto")
    assert set(report["models"]) == set(MODELS) and set(report["rasterizer"]["lacking"]) == set(BACKENDS)
    assert json.loads(json.dumps(report)) == report


def test_the_rasterizer_is_the_one_that_renders() -> None:
    kind = torch.device(resolve_device("auto")).type
    name, _ = choice(kind)
    assert lacking(name, kind) == "" and type(pick(kind)) is type(load(name))
    assert "cuda" in lacking("triton", "cpu") and lacking("reference", "cpu") == ""


def test_what_is_missing_is_said_with_what_to_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("GGAVATAR_MODELS", str(tmp_path))
    monkeypatch.setenv("GGAVATAR_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("GGAVATAR_OFFLINE", "0")
    monkeypatch.setattr(module, "choice", lambda kind: ("reference", ["numba cannot be imported; pip install numba"]))
    lines = environment_lines(environment())
    assert "rasterizer: reference" in lines
    assert any(line.startswith("missing: a faster rasterizer than reference: numba") for line in lines)
    names = " ".join(MODELS)
    assert any(line.endswith(f"fetch them with: ggavatar-models --fetch {names}") for line in lines)
    assert f"variable: GGAVATAR_MODELS={tmp_path}" in lines


def test_a_cache_that_cannot_be_written_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module.os, "access", lambda path, mode: False)
    assert any("set $GGAVATAR_CACHE" in text for text in environment()["missing"])


def test_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--environment", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["device"]["auto"] == resolve_device("auto")
    assert main(["--environment"]) == 0
    assert "model files:" in capsys.readouterr().out
    assert main(["--environment", "capture"]) == 2 and main([]) == 2
    assert "or --environment, found neither" in capsys.readouterr().err
