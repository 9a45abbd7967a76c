"""What was given is recognized, and the message names the command that takes it, or the nearest name.

Also covers `ggavatar/io/image_suffixes.py`.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ggavatar.cli.given import (
    A_CAPTURE,
    A_VIDEO,
    AN_AVATAR,
    CAPTURE,
    EVALUATION,
    IMAGES,
    MISSING,
    OTHER,
    RUN,
    TO_TRAIN_ON,
    VIDEO,
    Expected,
    check_given,
    kind_of,
)
from ggavatar.errors import InputError


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A user's folder with one of each."""
    monkeypatch.chdir(tmp_path)
    for folder, name, text in (
        ("captures/alice", "capture.json", "{}"),
        ("runs/alice", "config.json", json.dumps({"capture": "captures/alice"})),
        ("eval", "metrics.json", "{}"),
        ("frames", "000001.png", ""),
        ("demo", "video.mp4", ""),
        ("demo", "truth.npz", ""),
        ("notes", "todo.txt", ""),
    ):
        Path(folder).mkdir(parents=True, exist_ok=True)
        Path(folder, name).write_text(text)
    Path("clip.MOV").write_bytes(b"")
    return tmp_path


def test_kinds(home: Path) -> None:
    kinds = {
        "captures/alice": CAPTURE,
        "runs/alice": RUN,
        "eval": EVALUATION,
        "eval/metrics.json": EVALUATION,
        "frames": IMAGES,
        "clip.MOV": VIDEO,
        "notes": OTHER,
        "notes/todo.txt": OTHER,
        "nothing": MISSING,
    }
    assert {path: kind_of(Path(path)) for path in kinds} == kinds


@pytest.mark.parametrize(
    ("path", "expected", "said"),
    [
        ("captures/alice", A_VIDEO, "found a capture; it is ready: ggavatar-train captures/alice -o runs/alice"),
        ("captures/alice", AN_AVATAR, "found a capture; train on it first: ggavatar-train captures/alice -o runs/"),
        ("clip.MOV", A_CAPTURE, "found a video; make a capture of it first: ggavatar-prep clip.MOV -o captures/clip"),
        ("frames", A_CAPTURE, "ggavatar-prep frames -o captures/frames"),
        ("demo", A_VIDEO, "ggavatar-prep demo/video.mp4 -o demo-capture"),
        ("runs/alice", TO_TRAIN_ON, "to continue it: ggavatar-train captures/alice -o runs/alice --resume"),
        ("runs/alice", A_CAPTURE, "found a run; its capture is captures/alice"),
        ("runs/alice", A_VIDEO, "found a run; it is trained: ggavatar-eval runs/alice --table"),
        ("eval", AN_AVATAR, "found an evaluation; to print its scores: ggavatar-eval eval --table"),
        ("captures", A_CAPTURE, "found a folder with a capture; did you mean captures/alice?"),
        ("runs", AN_AVATAR, "found a folder with a run; did you mean runs/alice?"),
        ("captures/alcie", A_CAPTURE, "no such file or folder (did you mean captures/alice?); expected a capture"),
        ("capture/alice", A_CAPTURE, "no such file or folder (did you mean captures?)"),
        ("zzz/alice", A_CAPTURE, "no such file or folder (zzz is missing)"),
    ],
)
def test_the_message_names_what_fits(home: Path, path: str, expected: Expected, said: str) -> None:
    with pytest.raises(InputError) as caught:
        check_given(Path(path), expected)
    assert said in str(caught.value)


def test_what_fits_or_cannot_be_told_passes(home: Path) -> None:
    check_given(Path("captures/alice"), A_CAPTURE)
    check_given(Path("clip.MOV"), A_VIDEO)
    check_given(Path("notes"), A_CAPTURE)  # its reader says what is missing


def test_a_name_with_a_space_is_quoted(home: Path) -> None:
    Path("my clip.mp4").write_bytes(b"")
    with pytest.raises(InputError, match=r"ggavatar-prep 'my clip.mp4' -o captures/'my clip'"):
        check_given(Path("my clip.mp4"), A_CAPTURE)
