"""Formats of other trackers: the modules in `preprocess/formats/importers/`, and those that other packages register.

A module of the folder has its own name, one of another package that of its entry point (`ggavatar.plugins`). In
detection an importer of another package that fails is passed over, with a warning that names it.
"""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, cast, runtime_checkable

import preprocess.formats.importers
from ggavatar.errors import InputError, nearest
from ggavatar.io.restricted_pickle import read_pickle
from ggavatar.plugins.entry_points import IMPORTERS, Plugin, guarded, listed
from ggavatar.text.names import clean_text
from ggavatar.text.terminal import write_err
from preprocess.formats.frame_files import pickled_files
from preprocess.formats.tracking_record import TrackingRecord, without_bad_frames
from preprocess.options import PrepOptions

SWAPPED_SIZE = "swapped-size"
"""The `--fix` that is applied before the crop is chosen."""


@runtime_checkable
class Importer(Protocol):
    """The interface of a module that reads a format.

    Those in `preprocess/formats/importers/` also have `write(path, record)`, for tests that write and read back.
    """

    @property
    def TITLE(self) -> str:
        """The tools and the files that the format consists of, for messages."""
        ...

    def recognizes(self, path: Path) -> bool:
        """Whether the file or folder looks like this format; cheap, never raises for other content."""
        ...

    def read(self, path: Path) -> TrackingRecord:
        """Read the tracking in our conventions; `InputError` naming the file for anything wrong."""
        ...


@dataclass(frozen=True)
class _GuardedImporter:
    """An importer of another package: whatever it raises becomes one line that names it."""

    plugin: Plugin
    module: Importer

    @property
    def TITLE(self) -> str:
        """The importer's own."""
        return clean_text(str(self.module.TITLE))

    def recognizes(self, path: Path) -> bool:
        """What the importer says; `InputError` if it fails."""
        with guarded(self.plugin, f"it looked at {path}"):
            return bool(self.module.recognizes(path))

    def read(self, path: Path) -> TrackingRecord:
        """What the importer reads, without frames that hold no numbers; `InputError` if it fails."""
        with guarded(self.plugin, f"it read {path}"):
            record = self.module.read(path)
        if not isinstance(record, TrackingRecord):
            raise InputError(f"{self.plugin}: expected a TrackingRecord of {path}, found {type(record).__name__}")
        return without_bad_frames(path, record)


def own_importer_names() -> list[str]:
    """Names of the formats that we read ourselves, in alphabetical order."""
    return sorted(module.name for module in pkgutil.iter_modules(preprocess.formats.importers.__path__))


def importer_names() -> list[str]:
    """Names of all formats in alphabetical order, without importing any."""
    own = own_importer_names()
    return sorted([*own, *listed(IMPORTERS, own).usable])


def importer(name: str) -> Importer:
    """The format of that name, dashes read as underscores.

    Raises:
        InputError: There is none of that name, and the message lists all; or it is that of another package and cannot
            be imported.
    """
    wanted, own = name.replace("-", "_"), own_importer_names()
    if wanted in own:
        return cast(Importer, importlib.import_module(f"preprocess.formats.importers.{wanted}"))
    plugins = listed(IMPORTERS, own)
    if wanted in plugins.usable or wanted in plugins.problems:
        plugin = plugins.require(wanted)
        return _GuardedImporter(plugin, plugin.load("TITLE", "recognizes", "read"))
    names = sorted([*own, *plugins.usable])
    raise InputError(f"--format {name}: expected auto or one of {', '.join(names)}{nearest(wanted, names)}")


def detect_format(path: Path) -> str:
    """The format of a file or folder, found by its content; `InputError` if none or several recognize it."""
    if not path.exists():
        raise InputError(f"{path}: no such file or folder; --tracking expects the output of another tracker")
    formats = _all_importers()
    found = [name for name, reader in formats.items() if _recognizes(reader, path)]
    if len(found) == 1:
        return found[0]
    if found:
        titles = "; ".join(f"--format {name.replace('_', '-')} ({formats[name].TITLE})" for name in found)
        raise InputError(f"{path}: its content fits {len(found)} formats; choose one of them: {titles}")
    for first in list(pickled_files(path).values())[:1]:
        read_pickle(first)  # a frame that cannot be read is the reason, and says so
    titles = "; ".join(f"{name} ({reader.TITLE})" for name, reader in formats.items())
    raise InputError(
        f"{path}: expected the output of a known tracker, found none; choose the folder or file that one of these "
        f"names: {titles}"
    )


def _all_importers() -> dict[str, Importer]:
    """All formats by name; those of other packages that cannot be imported are left out, with a warning."""
    own = own_importer_names()
    plugins = listed(IMPORTERS, own)
    for problem in plugins.problems.values():
        write_err(f"warning: {problem}")
    found = {name: importer(name) for name in own}
    for name in plugins.usable:
        try:
            found[name] = importer(name)
        except InputError as error:
            write_err(f"warning: {error}")
    return dict(sorted(found.items()))


def _recognizes(reader: Importer, path: Path) -> bool:
    if not isinstance(reader, _GuardedImporter):
        return reader.recognizes(path)
    try:
        return reader.recognizes(path)
    except InputError as error:
        write_err(f"warning: {error}")
        return False


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
