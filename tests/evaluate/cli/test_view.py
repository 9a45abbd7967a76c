"""ggavatar-view from the outside: what it refuses, and how it ends."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from evaluate.cli.view import main


def view(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["ggavatar-view", *map(str, arguments)])
    try:
        return main()
    except SystemExit as leaving:
        return int(leaving.code or 0)


def test_what_cannot_be_shown_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    assert view(monkeypatch, tmp_path) == 2
    assert "expected a run folder" in capsys.readouterr().err
    assert view(monkeypatch, tmp_path, "--port", 70000) == 2
    assert "--port" in capsys.readouterr().err


def test_without_viser_the_command_to_get_it_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert view(monkeypatch, tmp_path) == 2
    message = capsys.readouterr().err
    assert "pip install 'viser>=1.1'" in message and "Traceback" not in message


def test_help_names_what_can_be_shown(monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    assert view(monkeypatch, "--help") == 0
    page = capsys.readouterr().out
    assert "RUN|CAPTURE|FILE" in page and "--public" in page and "--wait" not in page
    assert view(monkeypatch, "--no-such-flag") == 2
    assert view(monkeypatch, "--version") == 0 and capsys.readouterr().out.startswith("ggavatar-view ")


def test_ctrl_c_is_how_it_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("evaluate.viewer.session.view", interrupted)
    assert view(monkeypatch, tmp_path) == 0
    assert "ended" in capsys.readouterr().err
