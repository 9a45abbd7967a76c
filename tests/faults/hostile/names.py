"""Names of people and methods that are markup, formulas, commands or control characters, in every output of a table."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

from tests.faults.hostile.bases import FILES
from tests.faults.hostile.fixture import Hostile

NAMES = (
    "<script>open('canary','w')</script>",
    "<img src=x onerror=alert(1)>",
    "</td></table><h1>x",
    "<!--",
    "]]>",
    "&lt;x",
    "<svg/onload=alert(1)>",
    "' onmouseover='alert(1)",
    '" onmouseover="alert(1)',
    "<a href='javascript:alert(1)'>x</a>",
    "javascript:alert(1)",
    "data:text/html,<script>alert(1)</script>",
    "{{ 7 * 7 }}",
    "{% include '/etc/passwd' %}",
    "${7*7}",
    "![x](http://127.0.0.1:9/x.png)",
    "[x](javascript:alert(1))",
    "[x]: http://127.0.0.1:9/",
    "| a | b |",
    "`x`",
    "**x**",
    "=cmd|' /C touch canary'!A0",
    "+1+1",
    "-2+3",
    "@SUM(1)",
    '=HYPERLINK("http://127.0.0.1:9/")',
    "\t=1",
    "\r=1",
    "＝1+1",
    r"\write18{touch canary}",
    r"\input{/etc/passwd}",
    r"\immediate\openout3=canary",
    "$x^{$",
    "$\\frac{$",
    "%",
    "#1",
    "\\",
    "a_b^c",
    "}",
    "{",
    "$$",
    r"$\mathdefault{\x}$",
    "\x1b[2J\x1b]0;owned\x07",
    "\x1b]8;;http://127.0.0.1:9/\x1b\\x",
    "\x9b31m",
    "::error::owned",
    "x\n::error file=a::owned",
    "x\r\n::set-output name=a::b",
    "##[error]x",
    "a\nb\nc",
    "\0",
    "a\0b",
    "\ufffe",
    "\uffff",
    "\u202egnp.exe",
    "\u2028",
    "\u200b",
    "\ufeff",
    " ",
    "x" * 10_000,
    "..",
    "../../victim",
    "/etc/passwd",
    "CON",
    "a/b",
    "-rf",
    "--help",
    "~",
    "*",
    "?",
    "nan",
    "None",
    "1e5",
    "é́́́́́́́́́́",
    "字" * 500,
    "[red]x[/red]",
    "[link=http://x]y[/link]",
)
"""What a subject or a method may be called by whoever made the file."""


def fixtures() -> list[Hostile]:
    """Each name as that of a subject and of a method."""
    return list(_fixtures())


def _fixtures() -> Iterator[Hostile]:
    from evaluate.protocols.results import to_json
    from tests.support.evaluations import evaluation

    for number, name in enumerate(NAMES):
        one = evaluation(name, "ggavatar") if number % 2 else evaluation("ball", name)
        one = dataclasses.replace(one, notes=(name,), provenance={"run": name})
        data = to_json(one.as_dict()).encode()
        title = f"{'a subject' if number % 2 else 'a method'} called {name!r:.40}"
        yield Hostile(title, FILES, "names", "metrics.json", {"metrics.json": data})
