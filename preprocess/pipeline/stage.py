"""Stages of the pipeline, and the records in the output folder that decide whether a stage is skipped."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from ggavatar.data.capture_schema import RECORDS
from ggavatar.errors import InputError
from ggavatar.io.atomic import write_text
from ggavatar.io.json_files import read_json, readable_json
from preprocess.formats.tracking_record import TrackingRecord
from preprocess.options import PrepOptions


@runtime_checkable
class Reporter(Protocol):
    """Receives progress and warnings of a stage."""

    def advance(self, done: int, total: int | None) -> None:
        """Report `done` of `total` items; None if the total is unknown."""
        ...

    def warn(self, message: str) -> None:
        """Report something the user should know; it is repeated in the summary."""
        ...

    def note(self, message: str) -> None:
        """Report an assumption that was made; it is repeated in the summary."""
        ...


class RecordingReporter:
    """Passes everything on and keeps warnings and notes, so that a later run that skips the stage can say them again.

    Attributes:
        messages: Pairs of "warning" or "note" and the message, in order.
    """

    def __init__(self, reporter: Reporter) -> None:
        self._reporter = reporter
        self.messages: list[tuple[str, str]] = []

    def advance(self, done: int, total: int | None) -> None:
        """Pass progress on."""
        self._reporter.advance(done, total)

    def warn(self, message: str) -> None:
        """Keep a warning and pass it on."""
        self.messages.append(("warning", message))
        self._reporter.warn(message)

    def note(self, message: str) -> None:
        """Keep an assumption and pass it on."""
        self.messages.append(("note", message))
        self._reporter.note(message)


@dataclass(frozen=True)
class StageContext:
    """What a stage works with.

    Attributes:
        options: The user's options.
        folder: The capture folder to write.
        results: Results of the earlier stages by name.
        reporter: Receives progress and warnings.
        tracking_record: Gives the format's name and the tracking that `--tracking` names; read once a run, since
            several stages need it and a folder of thousands of files takes seconds.
    """

    options: PrepOptions
    folder: Path
    results: Mapping[str, Mapping[str, Any]]
    reporter: Reporter
    tracking_record: Callable[[], tuple[str, TrackingRecord]]


@dataclass(frozen=True)
class Stage:
    """One step from video to capture.

    Attributes:
        name: Name in records and messages.
        title: Title of the progress line.
        inputs: Gives what decides the result besides the earlier stages, as plain JSON values.
        run: Does the work and returns the result as plain JSON values.
        outputs: Files and folders it writes into the capture folder; removed before it runs again.
        version: Incremented whenever the same inputs would give another result than before.
    """

    name: str
    title: str
    inputs: Callable[[PrepOptions], Mapping[str, Any]]
    run: Callable[[StageContext], Mapping[str, Any]]
    outputs: tuple[str, ...] = ()
    version: int = 1


def fingerprint(stage: Stage, options: PrepOptions, before: str) -> str:
    """SHA-256 of everything that decides a stage's result; `before` is the previous stage's fingerprint."""
    text = json.dumps([stage.name, stage.version, before, stage.inputs(options)], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def file_state(path: Path | None) -> Any:
    """Names, sizes and modification times of a file or a folder's files, to detect changes; None for None.

    Raises:
        InputError: No such file or folder.
    """
    if path is None:
        return None
    try:
        if path.is_dir():
            inside = sorted(entry for entry in path.iterdir() if entry.is_file())
            return [str(path), *([entry.name, entry.stat().st_size, entry.stat().st_mtime_ns] for entry in inside)]
        state = path.stat()
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file or folder; check the path") from error
    return [str(path), state.st_size, state.st_mtime_ns]


def _record_path(folder: Path, stage: Stage) -> Path:
    return folder / RECORDS / f"{stage.name}.json"


def finished_result(folder: Path, stage: Stage, wanted: str) -> Mapping[str, Any] | None:
    """The result of a stage if it finished with the wanted fingerprint and its outputs still exist, else None."""
    record = _read_record(folder, stage)
    if record.get("fingerprint") != wanted or "result" not in record:
        return None
    if not all((folder / name).exists() for name in stage.outputs):
        return None
    return record["result"]


def was_interrupted(folder: Path, stage: Stage, wanted: str) -> bool:
    """Whether a stage started with this fingerprint and did not finish, so that its complete files may be kept."""
    record = _read_record(folder, stage)
    return record.get("fingerprint") == wanted and "result" not in record


def may_begin(folder: Path, first: Stage, wanted: str) -> bool:
    """Whether the stages may run in a folder without a finished capture: nobody began with another input there."""
    record = _read_record(folder, first)
    return "result" not in record or record.get("fingerprint") == wanted


def forget_stages(folder: Path, stages: Sequence[Stage]) -> None:
    """Remove the records of stages, so that all of them run again; each then replaces its own outputs."""
    for stage in stages:
        _record_path(folder, stage).unlink(missing_ok=True)


def _read_record(folder: Path, stage: Stage) -> Mapping[str, Any]:
    """The record of a stage; a damaged one is as good as none, since the stage then runs again."""
    path = _record_path(folder, stage)
    try:
        return read_json(path) if path.exists() else {}
    except InputError:
        return {}


def repeat_messages(folder: Path, stage: Stage, reporter: Reporter) -> None:
    """Report the warnings and notes of a finished stage again; records of older versions hold none."""
    for kind, message in _read_record(folder, stage).get("messages", ()):
        (reporter.warn if kind == "warning" else reporter.note)(message)


def write_record(
    folder: Path,
    stage: Stage,
    wanted: str,
    result: Mapping[str, Any] | None,
    messages: Sequence[tuple[str, str]] = (),
) -> None:
    """Record that a stage has started (`result` is None) or finished, with the warnings and notes it reported."""
    finished = {} if result is None else {"result": dict(result), "messages": list(messages)}
    text = readable_json({"fingerprint": wanted} | finished, indent=1)
    write_text(_record_path(folder, stage), text)
