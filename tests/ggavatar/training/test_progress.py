"""Progress of a training: plain lines, memory."""

from __future__ import annotations

import pytest

from ggavatar.training import progress
from ggavatar.training.progress import ConsoleListener, peak_memory_mib


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
    assert 8 <= len(shown) <= 10
    assert shown[0].startswith("step 5/100 · 1.0 it/s · ETA 1:35 · loss 0.5000 · 1234 Gaussians")
    assert shown[-1].startswith("step 100/100") and "test 27.12 dB" in shown[-1] and "MiB" in shown[-1]


def test_memory_is_measured() -> None:
    assert peak_memory_mib() > 20
