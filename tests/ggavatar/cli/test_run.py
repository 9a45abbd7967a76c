"""The edges of every process: streams that are closed, broken, full or narrow, signals, exhausted limits.

Also covers `ggavatar/cli/process.py`, beside its own test file. The processes are real; what they run is small.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from ggavatar.cli.run import run_command
from ggavatar.errors import GateError, InputError

BODY = """
import os, sys
from pathlib import Path
from ggavatar.cli.run import run_command
from ggavatar.errors import InputError
place = Path(sys.argv[1])
def body():
{body}
sys.exit(run_command(body))
"""


def shell(tmp_path: Path, body: str, redirection: str) -> subprocess.CompletedProcess[str]:
    """Run a body as a command under a shell's redirection; `$?` of the command is the last line of stdout."""
    lines = "\n".join(f"    {line}" for line in body.splitlines())
    (tmp_path / "command.py").write_text(BODY.format(body=lines))
    command = f'"{sys.executable}" "{tmp_path}/command.py" "{tmp_path}"'
    script = redirection.replace("COMMAND", command)
    return subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=False, timeout=120)


WRITES = """for number in range(20000): print("line", number, "–")
sys.stderr.write("a note – on stderr\\n")
(place / "done").write_text("whole")"""


@pytest.mark.parametrize(
    "redirection",
    [
        "COMMAND >&-; echo $?",
        "PYTHONUNBUFFERED=1 COMMAND | head -1 >/dev/null; echo ${PIPESTATUS[0]}",
        "env -u PYTHONUNBUFFERED COMMAND | head -1 >/dev/null; echo ${PIPESTATUS[0]}",
        "COMMAND 2>&- >/dev/null; echo $?",
        "COMMAND >&- 2>&- <&-; echo $?",
        "PYTHONIOENCODING=ascii COMMAND >/dev/null; echo $?",
        "LC_ALL=C PYTHONUTF8=0 PYTHONCOERCECLOCALE=0 COMMAND >/dev/null; echo $?",
        "(COMMAND 2>&1 >/dev/null | true); echo $?",
    ],
)
def test_nobody_who_does_not_read_stops_the_work(tmp_path: Path, redirection: str) -> None:
    ended = shell(tmp_path, WRITES, redirection)
    assert ended.stdout.splitlines()[-1] == "0"
    assert (tmp_path / "done").read_text() == "whole"
    assert "Traceback" not in ended.stderr and "Exception" not in ended.stderr


def test_a_full_disk_behind_stdout_is_one_message(tmp_path: Path) -> None:
    ended = shell(tmp_path, 'print("x" * 100)', "COMMAND >/dev/full; echo $?")
    assert ended.stdout == "1\n" and ended.stderr.startswith("error: No space left") and ended.stderr.count("\n") == 1


def test_messages_never_land_in_a_file_that_got_the_number_of_a_closed_stream(tmp_path: Path) -> None:
    """With stdin, stdout and stderr closed, the first file opened would be descriptor 0, and so on."""
    body = """with open(place / "mine", "w") as file, open(place / "other", "w"), open(place / "third", "w"):
    file.write("mine")
    for number in range(3):
        try: os.write(number, b"a message of a library")
        except OSError: pass"""
    shell(tmp_path, body, "COMMAND >&- 2>&- <&-")
    assert [(tmp_path / name).read_text() for name in ("mine", "other", "third")] == ["mine", "", ""]


def test_child_processes_have_the_streams_too(tmp_path: Path) -> None:
    body = "import subprocess\nreturn subprocess.run([sys.executable, '-c', 'print(1)'], check=False).returncode"
    assert shell(tmp_path, body, "COMMAND >&- 2>&- <&-; echo $?").stdout == "0\n"


@pytest.mark.parametrize(
    ("number", "code", "word"), [(signal.SIGTERM, 143, "terminated"), (signal.SIGINT, 130, "interrupted")]
)
def test_a_signal_ends_in_order(tmp_path: Path, number: int, code: int, word: str) -> None:
    """What is released on the way out, such as locks, is released."""
    body = f"""import signal, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # background jobs of a shell ignore it
from ggavatar.io.folder_lock import lock_folder
(place / "folder").mkdir()
with lock_folder(place / "folder"):
    os.kill(os.getpid(), {int(number)})
    time.sleep(60)"""
    ended = shell(tmp_path, body, "COMMAND; echo $?")
    assert ended.stdout == f"{code}\n" and ended.stderr == f"{word}: no further files were written\n"
    assert not list((tmp_path / "folder").iterdir())


def test_output_before_an_error_comes_before_it(tmp_path: Path) -> None:
    ended = shell(tmp_path, 'print("first")\nraise InputError("second")', "COMMAND 2>&1; echo $?")
    assert ended.stdout == "first\nerror: second\n2\n"


def test_a_help_page_that_nobody_reads(tmp_path: Path) -> None:
    ended = shell(tmp_path, 'print("x" * 100000)\nraise SystemExit(0)', "COMMAND | true; echo ${PIPESTATUS[0]}")
    assert ended.stdout == "0\n" and ended.stderr == ""


class OutOfMemoryError(RuntimeError):
    """Stands in for torch's, which is known by its name."""


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (InputError("a"), 2, "error: a\n"),
        (GateError("a"), 3, "gate failed: a\n"),
        (KeyboardInterrupt("kept"), 130, "interrupted: kept\n"),
        (MemoryError("a"), 1, "out of memory: a; "),
        (OutOfMemoryError("CUDA out of memory.\nmore"), 1, "out of memory: CUDA out of memory. Use "),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried"), 1, "out of memory: Default"),
        (RuntimeError("can't start new thread"), 1, "out of memory: can't start new thread; "),
        (ImportError("libx.so: cannot open shared object file: Too many open files"), 1, "error: Too many open files"),
        (ImportError("libx.so: failed to map segment from shared object"), 1, "out of memory: libx.so"),
        (OSError(24, "Too many open files", "a.png"), 1, "error: a.png: Too many open files; raise the limit"),
        (PermissionError(13, "Permission denied", "out"), 1, "error: out: Permission denied; check the permissions"),
    ],
)
def test_expected_failures_are_one_line(
    error: BaseException, code: int, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def body() -> None:
        raise error

    assert run_command(body) == code
    text = capsys.readouterr().err
    assert text.startswith(said) and text.count("\n") == 1


def test_faults_of_the_program_are_not_hidden() -> None:
    def body() -> None:
        raise RuntimeError("a fault")

    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(RuntimeError, match="a fault"):
        run_command(body)
    assert signal.getsignal(signal.SIGTERM) is before and os.path.exists(os.devnull)
