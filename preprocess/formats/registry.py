"""Formats of other trackers: every module in `preprocess/formats/importers/` is one, under its own name."""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil
from pathlib import Path
from typing import Protocol, cast, runtime_checkable

import preprocess.formats.importers
from ggavatar.errors import InputError
from ggavatar.io.restricted_pickle import read_pickle
from preprocess.formats.frame_files import pickled_files
from preprocess.formats.tracking_record import TrackingRecord
from preprocess.options import PrepOptions

SWAPPED_SIZE = "swapped-size"
"""The `--fix` that is applied before the crop is chosen."""


@runtime_checkable
class Importer(Protocol):
    """The interface of a module in `preprocess/formats/importers/`.

    Attributes:
        TITLE: The tools and the files that the format consists of, for messages.
    """

    TITLE: str

    def recognizes(self, path: Path) -> bool:
        """Whether the file or folder looks like this format; cheap, never raises for other content."""
        ...

    def read(self, path: Path) -> TrackingRecord:
        """Read the tracking in our conventions; `InputError` naming the file for anything wrong."""
        ...

    def write(self, path: Path, record: TrackingRecord) -> None:
        """Write the format as exactly as it can hold the tracking; `InputError` if it cannot."""
        ...


def importer_names() -> list[str]:
    """Names of all formats in alphabetical order."""
    return sorted(module.name for module in pkgutil.iter_modules(preprocess.formats.importers.__path__))


def importer(name: str) -> Importer:
    """The format of that name, dashes read as underscores; `InputError` listing all names if there is none."""
    names = importer_names()
    wanted = name.replace("-", "_")
    if wanted not in names:
        raise InputError(f"--format {name}: expected auto or one of {', '.join(names)}")
    return cast(Importer, importlib.import_module(f"preprocess.formats.importers.{wanted}"))


def detect_format(path: Path) -> str:
    """The format of a file or folder, found by its content; `InputError` if none or several recognize it."""
    if not path.exists():
        raise InputError(f"{path}: no such file or folder; --tracking expects the output of another tracker")
    found = [name for name in importer_names() if importer(name).recognizes(path)]
    if len(found) == 1:
        return found[0]
    if found:
        titles = "; ".join(f"--format {name.replace('_', '-')} ({importer(name).TITLE})" for name in found)
        raise InputError(f"{path}: its content fits {len(found)} formats; choose one of them: {titles}")
    for first in list(pickled_files(path).values())[:1]:
        read_pickle(first)  # a frame that cannot be read is the reason, and says so
    formats = "; ".join(f"{name} ({importer(name).TITLE})" for name in importer_names())
    raise InputError(
        f"{path}: expected the output of a known tracker, found none; choose the folder or file that one of these "
        f"names: {formats}"
    )


def read_tracking_record(options: PrepOptions) -> tuple[str, TrackingRecord]:
    """The format's name, detected unless `--format` gives it, and the tracking that `--tracking` names."""
    path = options.tracking
    if path is None:
        raise InputError("expected --tracking with the output of another tracker")
    name = detect_format(path) if options.format == "auto" else options.format
    record = importer(name).read(path)
    if SWAPPED_SIZE in options.fix:
        record = dataclasses.replace(record, width=record.height, height=record.width)
    return name, record
