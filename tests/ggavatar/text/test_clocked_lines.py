"""Lines by the clock: early, at most ten, spread over what is left, and also while nothing gets done."""

from __future__ import annotations

import itertools
import time

import pytest

from ggavatar.text import clocked_lines
from ggavatar.text.clocked_lines import INTERVAL, LINES, ClockedLines, LineSchedule, format_duration, waiting


@pytest.mark.parametrize("duration", [3.0, 20.0, 60.0, 3600.0, 200_000.0])
def test_work_of_known_length_has_at_most_ten_lines_to_its_end(duration: float) -> None:
    schedule = LineSchedule(0.0)
    times = [now / 2 for now in range(round(2 * duration)) if schedule.is_due(now / 2, duration - now / 2)]
    assert len(times) <= LINES - 1
    assert all(later - earlier >= INTERVAL for earlier, later in itertools.pairwise(times))
    if duration > 2 * INTERVAL:
        assert times[0] == INTERVAL, "the first comes early"
        assert duration - times[-1] <= max(2 * INTERVAL, duration / 4), "the last comes late"


def test_work_of_unknown_length_is_told_at_doubling_times() -> None:
    """5, 10, 20, … s, and nine of them: the tenth is for the end."""
    schedule = LineSchedule(0.0)
    times = [float(now) for now in range(100_000) if schedule.is_due(float(now), None)]
    assert times == [INTERVAL * 2**power for power in range(LINES - 1)]


def test_a_step_in_which_nothing_gets_done_is_not_silent(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without a call of `show`, as while kernels are compiled; the watching thread writes."""
    monkeypatch.setattr(clocked_lines, "INTERVAL", 0.02)
    monkeypatch.setattr(clocked_lines, "TICK", 0.01)
    with waiting("compiling"):
        shown = ""
        for _ in range(500):
            shown += capsys.readouterr().err
            if shown.count("\n") >= 2:
                break
            time.sleep(0.01)
    assert shown.startswith("compiling · at work for 0:00\n")
    time.sleep(0.05)
    capsys.readouterr()
    time.sleep(0.05)
    assert capsys.readouterr().err == "", "nothing after the end"


def test_a_count_without_a_total(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    now = [0.0]
    monkeypatch.setattr(clocked_lines, "TICK", 3600.0)
    monkeypatch.setattr(clocked_lines.time, "monotonic", lambda: now[0])
    lines = ClockedLines("reading")
    lines.show(3, None)
    now[0] = 6.0
    lines.show(40, None)
    lines.close()
    assert capsys.readouterr().err == "reading 40 · at work for 0:06\n"


def test_quiet_waits_in_silence(capsys: pytest.CaptureFixture[str]) -> None:
    with waiting("compiling", quiet=True):
        pass
    assert capsys.readouterr().err == ""


def test_durations() -> None:
    assert [format_duration(seconds) for seconds in (0.0, 59.6, 61.0, 3600.0, 7325.0)] == [
        "0:00",
        "1:00",
        "1:01",
        "1:00:00",
        "2:02:05",
    ]
