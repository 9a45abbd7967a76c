"""Lines on a terminal: nothing in them is obeyed, and every command prints through them."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
from hypothesis import given

from ggavatar.cli.run import run_command
from ggavatar.errors import GateError, InputError
from ggavatar.text.terminal import printable, write_err, write_out
from tests.support.hostile_names import HOSTILE, NATURAL, TEXTS, patient

ROOT = Path(__file__).parents[3]
COMMAND = re.compile(r"^\s*::|##(\[|vso\[|teamcity\[)")
"""Where actions/runner (ActionCommand.TryParseV2 and TryParse), Azure and TeamCity find a command in a line."""
OBEYED = re.compile("[\0-\x1f\x7f-\x9f\ud800-\udfff\u200e\u200f\u061c\u2028-\u202e\u2066-\u2069\ufffe\uffff]")
"""Control characters (ISO 6429), bidirectional controls (UAX 9, section 2), line separators."""


@patient
@given(TEXTS)
def test_a_printed_text_is_one_line_that_steers_nothing(text: str) -> None:
    line = printable(text)
    assert not OBEYED.search(line)
    assert not COMMAND.search(line)
    assert line.splitlines() in ([], [line])
    line.encode()


@pytest.mark.parametrize("name", [*NATURAL, "50% of 1:30, C:\\a #1 ##", "std::vector"])
def test_ordinary_text_is_kept(name: str) -> None:
    assert printable(name) == name


def test_what_would_be_obeyed_is_shown() -> None:
    assert printable("\x1b[2J\x9b\u202e\udce9\U000e0041") == r"\x1b[2J\x9b\u202e\udce9\U000e0041"
    assert printable("a\n  b\tc") == "a b c"
    assert printable("::error::x") == ": :error::x"
    assert printable("see ##[error]x") == "see # #[error]x"


def test_lines_are_written_one_by_one(capsys: pytest.CaptureFixture[str]) -> None:
    write_out("a\nb", "c")
    write_err("\x1b", *())
    write_err()
    assert capsys.readouterr() == ("a b\nc\n", "\\x1b\n")


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("kind", [InputError, GateError, OSError, KeyboardInterrupt, MemoryError])
def test_an_error_of_a_command_is_one_line_whatever_it_quotes(
    kind: type[BaseException], name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    def fail() -> int:
        raise kind(f"{name}: no such file")

    assert run_command(fail) != 0
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1 and captured.err.endswith("\n")
    assert not OBEYED.search(captured.err[:-1]) and not COMMAND.search(captured.err)


SILENT = {
    "ggavatar/text/terminal.py",
    "ggavatar/jit/kernels.py",
    "ggavatar/jit/kernel_cache.py",
}
"""The function itself, and messages that quote only the user's own cache folder.

Kernels are compiled again when a file changes that they import, which those of messages need not be.
"""


def test_no_other_code_writes_to_the_terminal() -> None:
    """Except finished JSON, workflow commands that are escaped on their own, and rich's tables of escaped texts."""
    found = []
    for package in ("ggavatar", "preprocess", "evaluate"):
        for path in (ROOT / package).rglob("*.py"):
            name = path.relative_to(ROOT).as_posix()
            for node in ast.walk(ast.parse(path.read_text())) if name not in SILENT else ():
                if not isinstance(node, ast.Call):
                    continue
                called, given = ast.unparse(node.func), ast.unparse(node)
                writes = called in {"print", "sys.stdout.write", "sys.stderr.write"} or called.endswith(".print")
                if writes and "json.dumps(" not in given and "to_github(" not in given:
                    found.append((name, given))
    assert all(name == "evaluate/tables/format_terminal.py" or text == "console.print()" for name, text in found), found
