"""One writer an output: the lock names its holder, ends with the process, leaves nothing, needs an existing folder."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from filelock import FileLock

from ggavatar.errors import InputError
from ggavatar.io import folder_lock
from ggavatar.io.folder_lock import LOCK, OWNER, is_lock_file, lock_folder, lock_output

IMPORTS = (
    "import sys, time; from pathlib import Path; from ggavatar.io.folder_lock import lock_folder, lock_output; "
    "sys.argv[0] = 'ggavatar-other'\n"
)


def start(body: str) -> subprocess.Popen[str]:
    """A process that runs this code after the imports."""
    return subprocess.Popen(
        [sys.executable, "-c", IMPORTS + body], text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )


def holder(place: Path, lock: str = "lock_folder") -> subprocess.Popen[str]:
    """A process that holds a lock until it is killed."""
    process = start(f"with {lock}(Path({str(place)!r})): print('held', flush=True); time.sleep(600)")
    assert process.stdout is not None and process.stdout.readline() == "held\n"
    return process


@pytest.mark.parametrize("lock", [lock_folder, lock_output])
def test_another_process_is_refused_by_name_until_it_is_killed(tmp_path: Path, lock) -> None:
    place = tmp_path / "place"
    place.mkdir()
    process = holder(place, lock.__name__)
    try:
        with pytest.raises(InputError) as refused, lock(place):
            pass
        assert f"{place}: ggavatar-other (process {process.pid} on " in str(refused.value)
    finally:
        process.send_signal(signal.SIGKILL)
        process.communicate()
    home = place if lock is lock_folder else tmp_path
    assert any(is_lock_file(path) for path in home.iterdir()), "a killed process leaves its files"
    with lock(place):
        assert any(str(os.getpid()) in path.read_text() for path in home.iterdir() if path.name.endswith(OWNER))
    assert not any(is_lock_file(path) for path in home.iterdir()), "the next one takes them away"


def test_one_that_waits_says_for_whom(tmp_path: Path) -> None:
    process = holder(tmp_path)
    body = f"with lock_folder(Path({str(tmp_path)!r}), wait=True): print('mine')"
    waiting = start(body)
    assert waiting.stderr is not None
    assert f"waiting for ggavatar-other (process {process.pid} on " in waiting.stderr.readline()
    process.kill()
    process.communicate()
    assert waiting.communicate(timeout=60)[0] == "mine\n" and waiting.returncode == 0


def test_many_processes_take_turns(tmp_path: Path) -> None:
    """The lock file goes with the lock: two must never hold different files of that name (counted in a plain file)."""
    count = tmp_path / "count"
    count.write_text("0")
    body = (
        f"count = Path({str(count)!r})\n"
        f"for _ in range(20):\n"
        f"    with lock_folder(Path({str(tmp_path)!r}), wait=True):\n"
        f"        number = int(count.read_text()); time.sleep(0.001); count.write_text(str(number + 1))\n"
    )
    processes = [start(body) for _ in range(4)]
    for process in processes:
        assert process.communicate(timeout=120) and process.returncode == 0
    assert count.read_text() == "80"
    assert [path.name for path in tmp_path.iterdir()] == ["count"]


@pytest.mark.parametrize(
    "text", ["{", "[]", "{}", '{"command": "a\\u001b[2J\\n::error::", "process": 1, "host": "b"}', "\0", ""]
)
def test_damaged_or_hostile_owner_file_still_gives_one_line(tmp_path: Path, text: str) -> None:
    with lock_folder(tmp_path):
        (tmp_path / OWNER).write_text(text)
        with pytest.raises(InputError, match="another process is writing"), lock_folder(tmp_path):
            pass


def test_a_missing_folder_is_not_made(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), lock_folder(tmp_path / "none"):
        pass
    assert not (tmp_path / "none").exists()


def test_an_owner_file_that_is_a_link_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "theirs").write_text("years of work")
    (tmp_path / OWNER).symlink_to(tmp_path / "theirs")
    with lock_folder(tmp_path):
        pass
    assert (tmp_path / "theirs").read_text() == "years of work"


@pytest.mark.parametrize("code", [errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP])
def test_a_file_system_without_locks_is_said_and_the_work_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], code: int
) -> None:
    def refuse(*_: object, **__: object) -> None:
        (tmp_path / LOCK).touch()
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(FileLock, "acquire", refuse)
    with lock_folder(tmp_path):
        assert not list(tmp_path.iterdir())
    assert capfd.readouterr().err == (
        f"note: {tmp_path}: this file system has no locks; let no other command write here meanwhile\n"
    )


def test_a_folder_that_cannot_be_written_gets_no_lock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Simulated, since tests may run as root: opening the lock file fails, and the folder is not writable."""

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", str(tmp_path / LOCK))

    monkeypatch.setattr(FileLock, "acquire", refuse)
    monkeypatch.setattr(folder_lock.os, "access", lambda *_: False)
    with lock_folder(tmp_path):
        pass
    monkeypatch.setattr(folder_lock.os, "access", lambda *_: True)
    with pytest.raises(PermissionError), lock_folder(tmp_path):  # somebody else's lock file
        pass
    assert capfd.readouterr().err == ""


def test_refusing_takes_less_than_a_second(tmp_path: Path) -> None:
    with lock_folder(tmp_path):
        began = time.monotonic()
        with pytest.raises(InputError), lock_folder(tmp_path):
            pass
    assert time.monotonic() - began < 1
