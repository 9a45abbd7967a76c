"""Commands can be imported where POSIX modules do not exist, as on Windows."""

from __future__ import annotations

import importlib.metadata
import subprocess
import sys

import pytest

from ggavatar.training.progress import ConsoleListener, peak_memory_mib

POSIX_ONLY = ("fcntl", "grp", "pwd", "resource", "termios")

MODULES = sorted(
    {
        *(
            point.module
            for point in importlib.metadata.entry_points(group="console_scripts")
            if "ggavatar" in point.name
        ),
        *("ggavatar.cli.train", "ggavatar.cli.sweep", "ggavatar.cli.export"),
        *("ggavatar.training.session", "ggavatar.formats.export", "ggavatar.formats.imported_run"),
    }
)


def test_modules_import_without_posix_modules() -> None:
    code = f"import importlib, sys\nfor name in {POSIX_ONLY!r}: sys.modules[name] = None\n" + "".join(
        f"importlib.import_module({module!r})\n" for module in MODULES
    )
    imported = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert imported.returncode == 0, imported.stderr[-2000:]


def test_memory_that_is_not_known_is_left_out(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "resource", None)
    assert peak_memory_mib() is None
    ConsoleListener(0, 3).step(3, 0.5, 1234)
    (line,) = capsys.readouterr().out.splitlines()
    assert line.endswith("loss 0.5000 · 1234 Gaussians")
