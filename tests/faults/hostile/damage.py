"""Fixtures made by chance: mutations of every format and every file of a capture and a run, and bit flips of these."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from preprocess.formats.registry import importer_names
from tests.faults.hostile.bases import FILES, FRAMES, PICTURES, RUN, files_of, tracking_target
from tests.faults.hostile.fixture import Fixture, Flipped, Mutated
from tests.faults.hostile.readers import EXPECTED
from tests.faults.hostile.samples import READERS_OF

IGNORED = (".lock", EXPECTED)
"""Files of the tree that hold nothing, or are ours."""


class Subject(NamedTuple):
    """A file to damage, and what reads it."""

    base: str
    file: str
    reader: str
    target: str


def single_files() -> Iterator[Subject]:
    """Every format that is read on its own."""
    for name, readers in READERS_OF.items():
        for reader in readers:
            yield Subject(FILES, name, reader, name)


def trackings(originals: Path) -> Iterator[Subject]:
    """A file of each suffix of every importer's layout."""
    for name in importer_names():
        by_suffix = {Path(file).suffix: file for file in files_of(originals / name)}
        for file in by_suffix.values():
            yield Subject(name, file, f"tracking:{name}", tracking_target(name))
            yield Subject(name, file, "tracking", tracking_target(name))


def capture_and_run(originals: Path) -> Iterator[Subject]:
    """Every file of a capture, a run and its evaluation, opened as what it belongs to."""
    for file in files_of(originals / RUN):
        if Path(file).name in IGNORED:
            continue
        if file.startswith("capture/"):
            yield Subject(RUN, file, "capture", "capture")
        elif not file.startswith("run/eval/") and "table" not in file:
            yield Subject(RUN, file, "run", "run")
        yield Subject(RUN, file, "eval", ".")


def folders(originals: Path) -> Iterator[Subject]:
    """Images that are read from a folder."""
    for name, reader in ((PICTURES, "pictures"), (FRAMES, "frames")):
        for file in files_of(originals / name):
            yield Subject(name, file, reader, ".")


def mutations(originals: Path, count: int, seed: int) -> list[Fixture]:
    """That many mutations, spread over all files alike; commands, which take longer, get a tenth of a reader's."""
    subjects = [*single_files(), *trackings(originals), *folders(originals), *capture_and_run(originals)]
    quick = [subject for subject in subjects if subject.reader != "eval"]
    slow = [subject for subject in subjects if subject.reader == "eval"]
    found: list[Fixture] = []
    for number in range(count):
        pool = slow if slow and number % 25 == 24 else quick
        subject = pool[number // 25 % len(pool) if pool is slow else (number - number // 25) % len(pool)]
        siblings = [file for file in _siblings(subject, subjects) if file != subject.file]
        other = random.Random(seed * 1_000_003 + number).choice(siblings) if siblings else ""
        name = f"{subject.base}/{subject.file} mutated"
        own = seed * 1_000_003 + number
        found.append(Mutated(name, subject.base, subject.reader, subject.target, subject.file, own, other))
    return found


def _siblings(subject: Subject, subjects: Sequence[Subject]) -> list[str]:
    return sorted({other.file for other in subjects if other.base == subject.base})


def flips(originals: Path, count: int, seed: int) -> list[Fixture]:
    """That many bit flips over all files of a capture, a run and its evaluation."""
    files = [subject.file for subject in capture_and_run(originals) if subject.reader == "eval"]
    found: list[Fixture] = []
    for number in range(count):
        file = files[number % len(files)]
        reader = "numbers" if file.startswith("run/eval/") else "numbers-anew"
        found.append(Flipped(f"a bit of {file} flipped", RUN, reader, ".", file, seed * 1_000_003 + number))
    return found
