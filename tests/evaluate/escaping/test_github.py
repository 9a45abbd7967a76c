"""Workflow commands: read back by the rules of actions/runner, one command and nothing more."""

from __future__ import annotations

import re

import pytest
from hypothesis import given

from evaluate.escaping.github import github_message, github_property
from ggavatar.text.names import displayable
from tests.support.hostile_names import NATURAL, TEXTS, patient


def parsed(line: str) -> tuple[str, dict[str, str], str]:
    """Command, properties and message of a line (actions/runner, ActionCommand.TryParseV2)."""
    head, _, message = line.removeprefix("::").partition("::")
    command, _, words = head.partition(" ")
    pairs = (word.partition("=") for word in words.split(","))
    codes = (("%0D", "\r"), ("%0A", "\n"), ("%3A", ":"), ("%2C", ","), ("%25", "%"))

    def unescaped(text: str, known: int) -> str:
        for code, character in (*codes[:2], *codes[known:]):
            text = text.replace(code, character)
        return text

    return command, {key: unescaped(value, 2) for key, _, value in pairs}, unescaped(message, 4)


@patient
@given(TEXTS)
def test_a_name_is_title_and_message_of_one_command(text: str) -> None:
    line = f"::error title={github_property(text)}::{github_message(text)}"
    assert line.splitlines() == [line]
    command, properties, message = parsed(line)
    wanted = "\n".join(map(displayable, text.splitlines()))
    assert (command, set(properties)) == ("error", {"title"})
    assert properties["title"] == message == wanted
    assert not re.search("[\0-\x1f]", line)


@pytest.mark.parametrize("name", [name for name in NATURAL if "," not in name])
def test_ordinary_text_is_kept(name: str) -> None:
    assert github_property(name) == github_message(name) == name
