"""The body of every command: exceptions become one message on stderr and an exit code."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

from ggavatar.cli.process import flush_output, orderly_termination, prepare_output, prepare_process
from ggavatar.cli.remedies import exhausted, less_memory, next_step
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


def run_command(main: Callable[[], int | None], options: type | None = None) -> int:
    """Run a command, from the parsing of its arguments on, and return its exit code.

    Expected failures become one message on stderr. `SystemExit`, with which a help page ends, passes.

    Args:
        main: The command.
        options: The dataclass of its flags, which messages may name; None where it is not imported yet.
    """
    prepare_process()
    prepare_output()
    with orderly_termination():
        return _guarded(lambda: _flushed(main), options)


def _flushed(main: Callable[[], int | None]) -> int:
    """Run the body and write out what it has printed, also if it ends with a help page."""
    try:
        code = main() or 0
    except SystemExit:
        flush_output()
        raise
    flush_output()
    return code


def _guarded(body: Callable[[], int], options: type | None) -> int:
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
        return _report("out of memory", f"{error}; {less_memory(_flags(options))}", EXIT_FAILURE)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _report(
            "error", f"{where}{error.strerror or error}{next_step(error.errno, _flags(options))}", EXIT_FAILURE
        )
    except Exception as error:
        if (message := exhausted(error, _flags(options))) is None:
            raise
        return _report(*message, EXIT_FAILURE)


def _flags(options: type | None) -> frozenset[str]:
    """The flags of the command; looked up only for a message."""
    if options is None:
        return frozenset()
    from ggavatar.cli.flags import spellings_of

    return spellings_of(options)


def _report(kind: str, message: object, code: int) -> int:
    """Print what has been printed so far, then one message, and return the exit code."""
    with contextlib.suppress(OSError):
        flush_output()
    write_err(f"{kind}: {message}")
    return code
