"""Background colors: one unit, sRGB from 0 to 1, and one message for every command."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from evaluate.cli import evaluate, render
from ggavatar.cli import train
from ggavatar.data.background import background_text, parse_background
from ggavatar.data.capture import Capture
from ggavatar.errors import InputError


@pytest.mark.parametrize(
    ("text", "color"),
    [
        ("white", (1.0, 1.0, 1.0)),
        ("black", (0.0, 0.0, 0.0)),
        ("0,1,0", (0.0, 1.0, 0.0)),
        (" .5, 0.25 ,1e-1", (0.5, 0.25, 0.1)),
        ("1,1,1", (1.0, 1.0, 1.0)),
    ],
)
def test_names_and_triples(text: str, color: tuple[float, float, float]) -> None:
    assert parse_background(text) == color
    assert parse_background(background_text(color)) == color


@pytest.mark.parametrize("text", ["wite", "", "0,1", "0,1,0,1", "a,b,c", "nan,0,0", "-0.1,0,0", "inf,0,0", "0,0,256"])
def test_anything_else_is_refused_with_the_unit(text: str) -> None:
    with pytest.raises(InputError, match="from 0 to 1"):
        parse_background(text)


def test_levels_up_to_255_are_answered_with_the_color_to_pass() -> None:
    with pytest.raises(InputError, match=r"pass --background 0\.502,0,1$") as caught:
        parse_background("128,0,255")
    advice = re.findall(r"--background (\S+)", str(caught.value))[-1]
    assert [round(255 * part) for part in parse_background(advice)] == [128, 0, 255]
    for level in range(256):
        color = parse_background(background_text((level / 255, 0.0, 0.0)))
        assert round(255 * color[0]) == level, "four decimals keep every 8-bit level"


@pytest.mark.parametrize("text", ["0,255,0", "gren", "2,0,0"])
@pytest.mark.parametrize("command", ["train", "eval folders", "eval run", "render"])
def test_every_command_says_the_same(
    command: str,
    text: str,
    toy_capture: Capture,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(InputError) as expected:
        parse_background(text)
    capture, out = str(toy_capture.folder), str(tmp_path / "out")
    words: dict[str, tuple[Callable[[], int], list[str]]] = {
        "train": (train.train, [capture, "-o", out]),
        "eval folders": (evaluate.main, ["--pred", capture, "--gt", capture]),
        "eval run": (evaluate.main, ["--pred", capture, "--capture", capture]),
        "render": (render.main, [str(tmp_path / "run")]),
    }
    main, arguments = words[command]
    monkeypatch.setattr(sys, "argv", [command, *arguments, "--background", text])
    assert main() == 2
    assert capfd.readouterr().err == f"error: {expected.value}\n"
    assert not Path(out).exists()
