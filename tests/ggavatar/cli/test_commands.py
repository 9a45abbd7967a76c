"""Ctrl-C and a lack of memory while a command is imported end it as they do later: one message, an exit code.

Also covers `preprocess/cli/commands.py` and `evaluate/cli/commands.py`. The commands themselves are in their own tests.
"""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

import evaluate.cli.commands as evaluate_commands
import ggavatar.cli.commands as ggavatar_commands
import preprocess.cli.commands as preprocess_commands

COMMANDS: dict[str, tuple[Callable[[], int], str]] = {
    "ggavatar-train": (ggavatar_commands.train, "ggavatar.cli.train"),
    "ggavatar-sweep": (ggavatar_commands.sweep, "ggavatar.cli.sweep"),
    "ggavatar-export": (ggavatar_commands.export, "ggavatar.cli.export"),
    "ggavatar-models": (ggavatar_commands.models, "ggavatar.cli.models"),
    "ggavatar-prep": (preprocess_commands.prep, "preprocess.cli.prep"),
    "ggavatar-doctor": (preprocess_commands.doctor, "preprocess.cli.doctor"),
    "ggavatar-demo": (preprocess_commands.demo, "preprocess.cli.demo"),
    "ggavatar-eval": (evaluate_commands.evaluate, "evaluate.cli.evaluate"),
    "ggavatar-render": (evaluate_commands.render, "evaluate.cli.render"),
    "ggavatar-view": (evaluate_commands.view, "evaluate.cli.view"),
}


class Failing:
    """An importer that fails for one module."""

    def __init__(self, module: str, error: BaseException) -> None:
        self.module, self.error = module, error

    def find_spec(self, name: str, *rest: object) -> None:
        if name == self.module:
            raise self.error


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (KeyboardInterrupt(), 130, "interrupted: "),
        (ImportError("libtorch.so: failed to map segment from shared object"), 1, "out of memory: "),
    ],
)
def test_an_import_that_is_cut_short(
    name: str,
    error: BaseException,
    code: int,
    words: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    command, module = COMMANDS[name]
    monkeypatch.delitem(sys.modules, module, raising=False)
    monkeypatch.setattr(sys, "meta_path", [Failing(module, error), *sys.meta_path])
    assert command() == code
    shown = capsys.readouterr()
    assert shown.err.startswith(words) and len(shown.err.splitlines()) == 1 and not shown.out


def test_the_commands_of_the_project_are_these() -> None:
    scripts = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]["scripts"]
    found = {name: f"{command.__module__}:{command.__name__}" for name, (command, _) in COMMANDS.items()}
    assert scripts == found
