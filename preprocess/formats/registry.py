"""The foreign formats, one file each in `preprocess/formats/importers/`: the file name is the format's name."""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil
from pathlib import Path
from typing import Protocol, cast, runtime_checkable

import preprocess.formats.importers
from ggavatar.errors import InputError
from preprocess.formats.tracking_record import TrackingRecord
from preprocess.options import PrepOptions

SWAPPED_SIZE = "swapped-size"
"""The `--fix` that must be applied before the crop is chosen."""


@runtime_checkable
class Importer(Protocol):
    """What a module in `preprocess/formats/importers/` offers."""

    TITLE: str

    def recognizes(self, folder: Path) -> bool:
        """Whether the folder or file looks like this format; cheap, never raises for foreign content."""
        ...

    def read(self, folder: Path) -> TrackingRecord:
        """Read it in our conventions; `InputError` naming the file for anything wrong."""
        ...

    def write(self, folder: Path, record: TrackingRecord) -> None:
        """Write the format, as exactly as it can hold the tracking."""
        ...


def importer_names() -> list[str]:
    """Names of all formats."""
    return sorted(module.name for module in pkgutil.iter_modules(preprocess.formats.importers.__path__))


def importer(name: str) -> Importer:
    """A format by name (dashes count as underscores); `InputError` listing all if there is none."""
    names = importer_names()
    wanted = name.replace("-", "_")
    if wanted not in names:
        raise InputError(f"--format {name}: expected auto or one of {', '.join(names)}")
    return cast(Importer, importlib.import_module(f"preprocess.formats.importers.{wanted}"))


def detect_format(folder: Path) -> str:
    """The format of a folder or file; `InputError` if none or several recognize it."""
    if not folder.exists():
        raise InputError(f"{folder}: no such file or folder; --tracking wants the output of another tracker")
    found = [name for name in importer_names() if importer(name).recognizes(folder)]
    if len(found) == 1:
        return found[0]
    formats = "; ".join(f"{name} ({importer(name).TITLE})" for name in importer_names())
    what = (
        f"looks like {' and '.join(found)}: choose one with --format"
        if found
        else f"no known tracking in it. Known: {formats}"
    )
    raise InputError(f"{folder}: {what}")


def read_tracking_record(options: PrepOptions) -> tuple[str, TrackingRecord]:
    """Read the tracking that `--tracking` names; also gives the format's name, detected unless `--format` says it."""
    folder = options.tracking
    if folder is None:
        raise InputError("--tracking is not given")
    name = detect_format(folder) if options.format == "auto" else options.format
    record = importer(name).read(folder)
    if SWAPPED_SIZE in options.fix:
        record = dataclasses.replace(record, width=record.height, height=record.width)
    return name, record
