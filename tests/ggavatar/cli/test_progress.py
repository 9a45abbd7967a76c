"""Progress of commands: a bar on a terminal, a few plain lines elsewhere, nothing when quiet."""

from __future__ import annotations

import io
import sys
import time

import pytest

from ggavatar.cli import progress
from ggavatar.cli.progress import announce_start, show_progress
from ggavatar.cli.run import run_command
from ggavatar.errors import InputError
from ggavatar.text import clocked_lines


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Seconds as the module sees them."""
    now = [100.0]
    monkeypatch.setattr(clocked_lines.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(clocked_lines, "TICK", 3600.0)  # lines come with the work alone, so that they are the same
    return now


def on_terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """What would be on the terminal; called by a test, since pytest puts its own stderr back after the fixtures."""
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setenv("TERM", "xterm")
    for name in ("NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
        monkeypatch.delenv(name, raising=False)
    return stream


def test_plain_lines_come_now_and_then_and_at_the_end(clock: list[float], capsys: pytest.CaptureFixture[str]) -> None:
    with show_progress("rendering") as report:
        for done in range(1, 101):
            clock[0] += 0.25
            report(done, 100)
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.splitlines() == [
        "rendering 20/100 · 4.0 it/s · ETA 0:20",
        "rendering 40/100 · 4.0 it/s · ETA 0:15",
        "rendering 60/100 · 4.0 it/s · ETA 0:10",
        "rendering 80/100 · 4.0 it/s · ETA 0:05",
        "rendering 100/100 in 0:25",
    ]


def test_work_done_before_does_not_count_as_speed(clock: list[float], capsys: pytest.CaptureFixture[str]) -> None:
    with show_progress("rendering") as report:
        report(1001, 1101)
        clock[0] += 10
        report(1050, 1101)
    assert capsys.readouterr().err == "rendering 1050/1101 · 5.0 it/s · ETA 0:10\n"


def test_short_work_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with show_progress("scoring") as report:
        for done in (1, 2, 3):
            report(done, 3)
    assert capsys.readouterr().err == "scoring 3/3 in 0:00\n"


def test_quiet_shows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = on_terminal(monkeypatch)
    with show_progress("scoring", quiet=True) as report:
        report(3, 3)
    assert terminal.getvalue() == ""


def test_a_bar_is_shown_on_a_terminal_and_leaves_stdout_alone(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    terminal = on_terminal(monkeypatch)
    before = sys.stdout
    with show_progress("rendering") as report:
        report(1, 2)
        assert sys.stdout is before
        sys.stdout.write("result\n")
        report(2, 2)
    assert "rendering" in terminal.getvalue() and "2/2" in terminal.getvalue()
    assert terminal.getvalue().rstrip().endswith("\x1b[?25h"), "the cursor is visible again"
    assert capsys.readouterr().out == "result\n"


def test_a_bar_that_is_left_early_ends_before_the_next_one_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = on_terminal(monkeypatch)
    with show_progress("rendering") as first:
        first(1, 2)
    after_first = terminal.getvalue()
    assert "1/2" in after_first and after_first.rstrip().endswith("\x1b[?25h"), "the cursor is visible again"
    with show_progress("scoring") as second:
        second(1, 1)
    assert "1/1" in terminal.getvalue().removeprefix(after_first)


def test_a_bar_without_any_work_is_never_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = on_terminal(monkeypatch)
    with show_progress("rendering"):
        pass
    assert "rendering" not in terminal.getvalue()


def test_a_bar_appears_even_if_no_part_gets_done(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = on_terminal(monkeypatch)
    monkeypatch.setattr(progress, "PATIENCE", 0.01)
    with show_progress("rendering"):
        for _ in range(500):
            if "rendering" in terminal.getvalue():
                break
            time.sleep(0.01)
    assert "rendering" in terminal.getvalue() and terminal.getvalue().rstrip().endswith("\x1b[?25h")


def test_the_first_line_says_what_is_loaded(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "torch", raising=False)
    announce_start(quiet=True)
    assert capsys.readouterr().err == ""
    announce_start()
    assert capsys.readouterr().err == "starting: loading torch\n"


def test_a_command_that_fails_removes_its_bar_before_the_message(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = on_terminal(monkeypatch)

    def body() -> int:
        with show_progress("rendering") as report:
            report(1, 2)
            raise InputError("no such frame")

    assert run_command(body) == 2
    text = terminal.getvalue()
    assert text.index("\x1b[?25h") < text.index("error: no such frame")
