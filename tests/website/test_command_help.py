"""What the commands print for --help, taken apart: nothing that is printed is lost.

Reference: a help page written out here, and the flags in what the commands print.
"""

from __future__ import annotations

import re

import pytest

from website.command_help import Box, HelpPage, Option, entry_points, printed_help, read_help

PRINTED = """usage: tool [-h] [OPTIONS] PATH

Do a thing. It takes long.

Names:
  one, two

╭─ positional arguments ──────────────╮
│ PATH          A folder. (required)  │
╰─────────────────────────────────────╯
╭─ way options ───────────────────────╮
│ How it is done.                     │
│ ─────────────────────────────────── │
│ -o DIR, --output DIR                │
│               Where to. (required)  │
│ --way {a,b}   A way; with a break   │
│               in it. (default: a)   │
╰─────────────────────────────────────╯

Examples:
  tool a
"""


def test_a_page_has_its_parts() -> None:
    assert read_help(PRINTED) == HelpPage(
        usage="tool [-h] [OPTIONS] PATH",
        text="Do a thing. It takes long.\n\nNames:\n  one, two\n\n\nExamples:\n  tool a",
        boxes=(
            Box("positional arguments", "", (Option("PATH", "A folder. (required)"),)),
            Box(
                "way options",
                "How it is done.",
                (
                    Option("-o DIR, --output DIR", "Where to. (required)"),
                    Option("--way {a,b}", "A way; with a break in it. (default: a)"),
                ),
            ),
        ),
    )


@pytest.mark.parametrize("command", entry_points())
def test_every_printed_flag_is_an_option(command: str) -> None:
    """Flags are those at the margin of boxes in a narrow window, where more lines are broken than on the page."""
    flag = re.compile(r"(?<![\w-])--[a-z][\w.-]*")
    margin = re.findall(r"^│ (-.*?)(?:  |│$)", printed_help(command, 80), re.MULTILINE)
    page = read_help(printed_help(command))
    options = [option for box in page.boxes for option in box.options]
    assert set(flag.findall(" ".join(margin))) == set(flag.findall(" ".join(option.flags for option in options)))
    assert "--help" in {name for option in options for name in option.flags.split(", ")}
    assert page.usage.startswith(command) and page.text and all(option.meaning for option in options)
