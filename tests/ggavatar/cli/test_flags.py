"""Flags as data: what a dataclass of options says, against what the parser makes of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from ggavatar.cli.flags import flags_of, spellings_of
from ggavatar.cli.train import Arguments
from preprocess.options import PrepOptions
from website.command_pages import PAGES


def test_flags_of_a_training() -> None:
    flags = {flag.field: flag for flag in flags_of(Arguments)}
    assert flags["capture"].is_positional and flags["capture"].required and flags["capture"].kind is Path
    assert flags["output"].shown == "-o, --output RUN" and flags["output"].required
    assert flags["preset"].choices == ("default", "fast", "paper") and flags["preset"].default is None
    assert flags["steps"].kind is int and flags["steps"].shown == "--steps N"
    assert flags["set"].repeats and not flags["set"].several
    assert flags["quiet"].shown == "-q, --quiet" and flags["quiet"].negations == ("--no-quiet",)


def test_nested_flags_and_names_of_their_own() -> None:
    flags = {flag.field: flag for flag in flags_of(PrepOptions)}
    assert flags["smooth"].shown == "--tracker.smooth, --tracker.no-smooth"
    assert flags["head_model"].spellings == ("--head", "--head-model")
    demo = {flag.field: flag for flag in flags_of(PAGES["ggavatar-demo"].options)}
    assert demo["identity"].spellings == ("--id",) and demo["identity"].choices == ("1", "2", "3", "4", "5")


@pytest.mark.parametrize("name", sorted(PAGES))
def test_every_command_has_help_and_version(name: str) -> None:
    assert {"-h", "--help", "--version"} <= spellings_of(PAGES[name].options)
