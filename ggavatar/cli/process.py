"""Process-wide settings: OpenMP, malloc, output streams that cannot fail, and SIGTERM as an orderly end."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import io
import os
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Any

from ggavatar.errors import Terminated

MMAP_THRESHOLD, TRIM_THRESHOLD = 1 << 25, 1 << 29
"""Blocks of up to 32 MiB come from the heap, of which up to 512 MiB stay with the process when they are freed."""


def prepare_process() -> None:
    """Apply the settings; call it before torch is imported. Environment variables that the user has set are kept."""
    # Idle OpenMP threads would otherwise spin on the cores that our own threads use.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    _keep_freed_memory()


def prepare_output() -> None:
    """Let no message fail: a closed or broken stdout or stderr swallows it, an encoding replaces what it lacks.

    A reader that has seen enough (`| head -1`) does not stop the work, whose files are what the command is for.
    """
    _open_standard_descriptors()
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 - open until the process ends
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
            if stream is getattr(sys, f"__{name}__") and type(_raw(stream)) is io.FileIO:
                setattr(sys, name, _swallowing(stream))


def flush_output() -> None:
    """Write out what is buffered.

    Raises:
        OSError: The output cannot be written, as on a full disk; what was left is dropped.
    """
    try:
        sys.stdout.flush()
    except OSError:
        _to_null(sys.stdout.fileno())  # or the interpreter would try again when it ends, and fail
        sys.stdout.flush()
        raise


@contextlib.contextmanager
def orderly_termination() -> Iterator[None]:
    """While active, SIGTERM raises `Terminated`, so that locks are released and temporary files removed.

    Whoever handles the signal already, such as a training, keeps doing so.
    """

    def end(_: int, frame: FrameType | None) -> None:
        raise Terminated

    in_charge = threading.current_thread() is threading.main_thread()
    if not in_charge or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _open_standard_descriptors() -> None:
    """Open the null device in place of a closed stdin, stdout or stderr.

    Otherwise the next file that is opened gets its number, and messages of libraries are written into that file.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)  # gets the lowest free number, which is this one
            os.set_inheritable(opened, True)


class _SwallowingFile(io.FileIO):
    """A descriptor that goes on with the null device when its reader has gone away."""

    def write(self, data: Any, /) -> int:
        """Write, or drop what nobody reads."""
        try:
            return super().write(data)
        except OSError as error:
            gone = errno.EINVAL if os.name == "nt" else errno.EPIPE
            if error.errno not in (errno.EPIPE, gone):
                raise
            _to_null(self.fileno())
            return super().write(data)


def _raw(stream: io.TextIOWrapper) -> Any:
    """The descriptor behind a stream, which has no buffer in between with $PYTHONUNBUFFERED."""
    return getattr(stream.buffer, "raw", stream.buffer)


def _swallowing(stream: io.TextIOWrapper) -> io.TextIOWrapper:
    """A stream like this one on the same descriptor, whose reader may go away."""
    stream.flush()
    raw = _SwallowingFile(stream.fileno(), "w", closefd=False)
    is_buffered = _raw(stream) is not stream.buffer
    return io.TextIOWrapper(
        io.BufferedWriter(raw) if is_buffered else raw,
        encoding=stream.encoding,
        errors=stream.errors,
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )


def _to_null(descriptor: int) -> None:
    """Let a descriptor be the null device from now on."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, descriptor)
    os.close(null)


def _keep_freed_memory() -> None:
    """Keep freed memory in the process: otherwise every step returns tens of MiB and page-faults them in again."""
    m_trim_threshold, m_mmap_threshold = -1, -3  # malloc.h of glibc; other C libraries have no mallopt
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError, TypeError):
        return
    mallopt(m_trim_threshold, TRIM_THRESHOLD)
    mallopt(m_mmap_threshold, MMAP_THRESHOLD)
