"""The body of every command: exceptions become one message on stderr and an exit code."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable

from ggavatar.cli.process import prepare_output, prepare_process
from ggavatar.errors import EXIT_FAILURE, EXIT_GATE, EXIT_INTERRUPTED, EXIT_USAGE, GateError, InputError
from ggavatar.text.terminal import write_err

FEWER = "Use fewer frames, a smaller --size or fewer Gaussians (--max-gaussians)."


def run_command(main: Callable[[], int | None]) -> int:
    """Run the body of a command and return its exit code; expected failures become one message on stderr."""
    prepare_process()
    prepare_output()
    try:
        return main() or 0
    except InputError as error:
        return _report("error", error, EXIT_USAGE)
    except GateError as error:
        return _report("gate failed", error, EXIT_GATE)
    except KeyboardInterrupt as error:
        return _report("interrupted", str(error) or "no further files were written", EXIT_INTERRUPTED)
    except MemoryError as error:
        return _report("out of memory", f"{error}; {FEWER}", EXIT_FAILURE)
    except RuntimeError as error:
        if type(error).__name__ != "OutOfMemoryError":  # torch's, which need not be imported here
            raise
        return _report("out of memory", f"{str(error).splitlines()[0]} {FEWER}", EXIT_FAILURE)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_FAILURE
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _report("error", f"{where}{error.strerror or error}{_next_step(error.errno)}", EXIT_FAILURE)


def _next_step(code: int | None) -> str:
    """What the user can do about an error of the operating system."""
    steps = {
        errno.ENOSPC: "; free some space or choose another folder with -o, then run the same command again",
        errno.EACCES: "; check the permissions or choose another folder with -o",
        errno.EROFS: "; choose a writable folder with -o",
    }
    return steps.get(code or 0, "")


def _report(kind: str, message: object, code: int) -> int:
    write_err(f"{kind}: {message}")
    return code
