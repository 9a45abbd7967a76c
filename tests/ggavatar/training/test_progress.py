"""Progress of a training: plain lines, readable durations."""

from __future__ import annotations

import pytest

from ggavatar.training import progress
from ggavatar.training.progress import ConsoleListener, format_duration, peak_memory_mib


def test_plain_lines_come_at_intervals_and_at_the_end(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    line = ConsoleListener(0, 100)
    for step in range(1, 101):
        now[0] += 1.0
        if step == 50:
            line.evaluated(step, 27.125)
        line.step(step, lambda: 0.5, 1234)
    line.close()
    shown = capsys.readouterr().out.splitlines()
    assert len(shown) == 10
    assert shown[0].startswith("step 10/100 · 1.0 it/s · ETA 1:30 · loss 0.5000 · 1234 Gaussians")
    assert shown[-1].startswith("step 100/100") and "test 27.12 dB" in shown[-1] and "MiB" in shown[-1]


def test_durations() -> None:
    assert [format_duration(seconds) for seconds in (0.0, 59.6, 61.0, 3600.0, 7325.0)] == [
        "0:00",
        "1:00",
        "1:01",
        "1:00:00",
        "2:02:05",
    ]


def test_memory_is_measured() -> None:
    assert peak_memory_mib() > 20
