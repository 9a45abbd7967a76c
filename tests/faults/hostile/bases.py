"""Valid trees of files, one for every format, that cases change: made once a session by the project's own writers."""

from __future__ import annotations

import json
import pickle
import shutil
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from tests.faults.hostile import samples

FILES: dict[str, Callable[[], bytes]] = samples.FILES
"""Content of single files, by the name of the file."""

BASES: dict[str, Callable[[Path], None]] = {}
"""Makers of trees, by name."""


def base(name: str) -> Callable[[Callable[[Path], None]], Callable[[Path], None]]:
    """Register the maker of a tree."""

    def register(make: Callable[[Path], None]) -> Callable[[Path], None]:
        BASES[name] = make
        return make

    return register


@base("files")
def _files(folder: Path) -> None:
    folder.mkdir(parents=True)
    for name, content in FILES.items():
        (folder / name).write_bytes(content())


def make_bases(folder: Path, wanted: Sequence[str]) -> None:
    """Make the wanted trees below a folder; those that are there stay."""
    for name in dict.fromkeys(wanted):
        if not (folder / name).exists():
            BASES[name](folder / name)
