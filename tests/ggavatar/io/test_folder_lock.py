"""One writer a folder: the lock names its holder, ends with the process, and needs an existing folder."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ggavatar.errors import InputError
from ggavatar.io.folder_lock import LOCK_FILES, lock_folder


def test_another_process_is_refused_until_the_lock_is_released(tmp_path: Path) -> None:
    code = (
        "from pathlib import Path; from ggavatar.io.folder_lock import lock_folder\n"
        f"with lock_folder(Path({str(tmp_path)!r})): pass"
    )
    with lock_folder(tmp_path):
        other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
        assert f"process {os.getpid()} on " in other.stderr and "InputError" in other.stderr
    subprocess.run([sys.executable, "-c", code], check=True)
    assert {path.name for path in tmp_path.iterdir()} <= set(LOCK_FILES[:1])


def test_a_lock_file_that_nobody_holds_is_stale(tmp_path: Path) -> None:
    (tmp_path / LOCK_FILES[0]).write_text("")
    (tmp_path / LOCK_FILES[1]).write_text('{"process": 1, "host": "gone", "command": "ggavatar-train"}')
    with lock_folder(tmp_path):
        assert str(os.getpid()) in (tmp_path / LOCK_FILES[1]).read_text()


def test_damaged_owner_file_still_gives_one_line(tmp_path: Path) -> None:
    with lock_folder(tmp_path):
        (tmp_path / LOCK_FILES[1]).write_text("{")
        with pytest.raises(InputError, match="another process is writing"), lock_folder(tmp_path):
            pass


def test_a_missing_folder_is_not_made(tmp_path: Path) -> None:
    with pytest.raises(OSError), lock_folder(tmp_path / "none"):
        pass
    assert not (tmp_path / "none").exists()
