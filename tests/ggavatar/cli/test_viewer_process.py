"""The viewer beside a training: a process that ends with it. Reference: small programs in the viewer's place."""

from __future__ import annotations

import importlib.util
import sys
import time
from pathlib import Path

import pytest

from ggavatar.cli import viewer_process
from ggavatar.cli.viewer_process import viewer_beside
from ggavatar.errors import InputError

PROGRAM = """
import pathlib, sys
note = pathlib.Path(sys.argv[1] + ".note")
note.write_text(" ".join(sys.argv[1:]))
sys.stdin.buffer.read()
note.write_text("ended")
"""


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "stand_in.py").write_text(PROGRAM)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(viewer_process, "VIEWER", "stand_in")
    known = importlib.util.find_spec("sys")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: known)


def wait_for(path: Path) -> str:
    end = time.monotonic() + 30
    while not (path.exists() and path.read_text()) and time.monotonic() < end:
        time.sleep(0.02)
    return path.read_text()


def test_it_is_told_the_run_and_ends_with_the_training(tmp_path: Path, program: None) -> None:
    run, note = tmp_path / "-run", tmp_path / "-run.note"
    with viewer_beside(run):
        assert wait_for(note) == f"{run} --wait"
    assert note.read_text() == "ended"


def test_it_ends_when_the_training_fails(tmp_path: Path, program: None) -> None:
    with pytest.raises(RuntimeError), viewer_beside(tmp_path / "run"):
        wait_for(tmp_path / "run.note")
        raise RuntimeError
    assert (tmp_path / "run.note").read_text() == "ended"


def test_one_that_does_not_end_is_killed(tmp_path: Path, program: None, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "stand_in.py").write_text(PROGRAM + "\nimport time; time.sleep(600)")
    monkeypatch.setattr(viewer_process, "PATIENCE", 0.5)
    began = time.monotonic()
    with viewer_beside(tmp_path / "run"):
        wait_for(tmp_path / "run.note")
    assert time.monotonic() - began < 60


def test_one_that_fails_leaves_the_training_alone(tmp_path: Path, program: None) -> None:
    (tmp_path / "stand_in.py").write_text("raise SystemExit(2)")
    with viewer_beside(tmp_path / "run"):
        time.sleep(0.5)


def test_without_viser_the_training_does_not_begin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match="pip install"), viewer_beside(tmp_path):
        raise AssertionError
    assert "evaluate" not in sys.modules or viewer_process.VIEWER.startswith("evaluate.")
