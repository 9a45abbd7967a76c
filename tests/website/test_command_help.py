"""What the commands print for --help, taken apart: nothing that is printed is lost.

Reference: a help page written out here, and the flags in what the commands print.
"""

from __future__ import annotations

import re

import pytest

from website.command_help import HelpPage, Option, Section, entry_points, printed_help, read_help

PRINTED = """usage: tool PATH -o DIR [options]

Do a thing. It
takes long.

names (NAME):
  one   the first, which is
        long
    one_other
  two

examples:
  tool a -o b
      what it is for

arguments:
  PATH          A folder. (required)

the way:
  -o, --output DIR
                Where to: here. (required)
  --way {a,b}   A way; with a break
                in it. (default: a)
"""


def test_a_page_has_its_parts() -> None:
    assert read_help(PRINTED) == HelpPage(
        usage="tool PATH -o DIR [options]",
        text="Do a thing. It\ntakes long.",
        sections=(
            Section("names (NAME)", ("one   the first, which is", "      long", "  one_other", "two")),
            Section("examples", ("tool a -o b", "    what it is for")),
            Section("arguments", ("PATH          A folder. (required)",), (Option("PATH", "A folder. (required)"),)),
            Section(
                "the way",
                tuple(line[2:] for line in PRINTED.splitlines()[-4:]),
                (
                    Option("-o, --output DIR", "Where to: here. (required)"),
                    Option("--way {a,b}", "A way; with a break in it. (default: a)"),
                ),
            ),
        ),
    )


@pytest.mark.parametrize("command", entry_points())
def test_every_printed_flag_is_an_option(command: str) -> None:
    """Flags are those that begin a line in a narrow window, where more lines are broken than on the page."""
    flag = re.compile(r"(?<![\w-])--[a-z][\w.-]*")
    margin = re.findall(r"^  (-.*?)(?:  |$)", printed_help(command, 70), re.MULTILINE)
    page = read_help(printed_help(command))
    options = [option for section in page.sections for option in section.options]
    assert set(flag.findall(" ".join(margin))) == set(flag.findall(" ".join(option.flags for option in options)))
    assert "--help" in {name for option in options for name in option.flags.split(", ")}
    assert page.usage.startswith(command) and page.text and all(option.meaning for option in options)
    assert any(section.title == "examples" and not section.options for section in page.sections)
