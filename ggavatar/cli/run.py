"""The body of every command: exceptions become one message on stderr and an exit code."""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Callable

from ggavatar.cli.process import flush_output, orderly_termination, prepare_output, prepare_process
from ggavatar.errors import (
    EXIT_FAILURE,
    EXIT_GATE,
    EXIT_INTERRUPTED,
    EXIT_TERMINATED,
    EXIT_USAGE,
    GateError,
    InputError,
    Terminated,
)
from ggavatar.text.terminal import write_err

FEWER = "Use fewer frames, a smaller --size or fewer Gaussians (--max-gaussians)."
ON_DEVICE = (
    "Use fewer Gaussians (--max-gaussians), the perceptual loss on crops (--set perceptual_mode=crops), smaller frames "
    "(ggavatar-prep --size), or another device (--device cuda:1, --device cpu); checkpoints are intact."
)
FILES = "Too many open files: raise the limit (ulimit -n)."


def run_command(main: Callable[[], int | None]) -> int:
    """Run a command, from the parsing of its arguments on, and return its exit code.

    Expected failures become one message on stderr. `SystemExit`, with which a help page ends, passes.
    """
    prepare_process()
    prepare_output()
    with orderly_termination():
        return _guarded(lambda: _flushed(main))


def _flushed(main: Callable[[], int | None]) -> int:
    """Run the body and write out what it has printed, also if it ends with a help page."""
    try:
        code = main() or 0
    except SystemExit:
        flush_output()
        raise
    flush_output()
    return code


def _guarded(body: Callable[[], int]) -> int:
    """Run a body; expected failures are reported and have their exit code."""
    try:
        return body()
    except InputError as error:
        return _report("error", error, EXIT_USAGE)
    except GateError as error:
        return _report("gate failed", error, EXIT_GATE)
    except Terminated as stop:
        return _report("terminated", str(stop) or "no further files were written", EXIT_TERMINATED)
    except KeyboardInterrupt as stop:
        return _report("interrupted", str(stop) or "no further files were written", EXIT_INTERRUPTED)
    except MemoryError as error:
        return _report("out of memory", f"{error}; {FEWER}", EXIT_FAILURE)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _report("error", f"{where}{error.strerror or error}{_next_step(error.errno)}", EXIT_FAILURE)
    except Exception as error:
        if (message := _exhausted(error)) is None:
            raise
        return _report(*message, EXIT_FAILURE)


def _exhausted(error: Exception) -> tuple[str, str] | None:
    """Kind and message if an error says that the machine has no more memory, threads or open files; else None."""
    text = str(error).splitlines()[0] if str(error) else ""
    if "Too many open files" in text:
        return "error", FILES
    if type(error).__name__ == "OutOfMemoryError":  # torch's, which need not be imported here
        return "out of memory", f"{text} {ON_DEVICE if 'CUDA' in text else FEWER}"
    lacking = ("can't allocate memory", "cannot allocate memory", "failed to map segment", "can't start new thread")
    if any(words in str(error).lower() for words in lacking):
        return "out of memory", f"{text}; raise the limit (ulimit -v), or use fewer frames or Gaussians"
    return None


def _next_step(code: int | None) -> str:
    """What the user can do about an error of the operating system."""
    steps = {
        errno.ENOSPC: "; free some space or choose another folder with -o, then run the same command again",
        errno.EACCES: "; check the permissions or choose another folder with -o",
        errno.EROFS: "; choose a writable folder with -o",
        errno.EMFILE: "; raise the limit (ulimit -n)",
    }
    return steps.get(code or 0, "")


def _report(kind: str, message: object, code: int) -> int:
    """Print what has been printed so far, then one message, and return the exit code."""
    with contextlib.suppress(OSError):
        flush_output()
    write_err(f"{kind}: {message}")
    return code
