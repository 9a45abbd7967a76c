"""The rows of the table that are about files: hostile ones, mutations, and flipped bits."""

from __future__ import annotations

import functools
import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.faults.bench import Bench
from tests.faults.case import Case, Row
from tests.faults.hostile.bases import make_trees
from tests.faults.hostile.damage import flips, mutations
from tests.faults.hostile.fixture import FAULT, Fixture
from tests.faults.hostile.pool import Pool

GENERATORS = (
    *("pickles", "pickle_bombs", "archives", "json_texts", "special_files", "pictures", "splats", "videos", "networks"),
    *("texts", "names"),
)
"""Modules with a function `fixtures`, one for each kind of attack."""


EXPECTATION = "no code runs; within 10 s and 1 GB it is read, or refused by a message that names the file"


@dataclass(frozen=True)
class FixtureCase(Case):
    """A fixture as a case of a row."""

    fixture: Fixture


@functools.cache
def attacks() -> tuple[Fixture, ...]:
    """All hostile fixtures."""
    modules = (importlib.import_module(f"tests.faults.hostile.{name}") for name in GENERATORS)
    return tuple(fixture for module in modules for fixture in module.fixtures())


def hostile_cases(count: int, seed: int) -> list[Case]:
    """That many of the hostile fixtures, evenly spread and others with each seed."""
    found = attacks()
    step = max(-(-len(found) // max(count, 1)), 1)
    return [_case("hostile", fixture, seed) for fixture in found[seed % step :: step]]


def mutated_cases(count: int, seed: int) -> list[Case]:
    """Mutations of every format and every file of a capture and a run."""
    return [_case("mutations", fixture, fixture.seed) for fixture in mutations(_trees(), count, seed)]


def flipped_cases(count: int, seed: int) -> list[Case]:
    """Bit flips over all files of a capture and a run."""
    return [_case("bit-flips", fixture, fixture.seed) for fixture in flips(_trees(), count, seed)]


def _case(row: str, fixture: Fixture, seed: int) -> Case:
    expectation = "noticed, or without effect on any number" if row == "bit-flips" else EXPECTATION
    return FixtureCase(row, fixture.reader, fixture.name, seed, expectation, fixture)


@functools.cache
def _home() -> TemporaryDirectory[str]:
    return TemporaryDirectory(prefix="hostile-originals-", ignore_cleanup_errors=True)


@functools.cache
def _trees() -> Path:
    """The valid trees, made when first asked for: their files decide which cases there are."""
    return make_trees(Path(_home().name))


def check(case: Case, bench: Bench) -> Sequence[str]:
    """Have a worker open a fixture, and say what was wrong."""
    assert isinstance(case, FixtureCase)
    pool: Pool = bench.once("hostile pool", lambda folder: Pool(_trees(), folder))
    reading = pool.read(case.fixture)
    return (reading.detail,) if reading.verdict == FAULT else ()


ROWS = (
    Row(
        "hostile",
        "files made to run code, exhaust time or memory, or reach other files: pickles, archives, JSON, pictures, "
        "Gaussians, videos, networks, weights, text, names, and devices in place of files",
        EXPECTATION,
        count=2000,
        sample=60,
        cases=hostile_cases,
        check=check,
    ),
    Row(
        "mutations",
        "bytes changed, cut, repeated, inserted, zeroed, swapped in every format and every file of a capture and a run",
        EXPECTATION,
        count=10_000,
        sample=200,
        cases=mutated_cases,
        check=check,
    ),
    Row(
        "bit-flips",
        "one bit of a file of a capture, a run or its evaluation",
        "evaluation says so, or every number that it writes stays what it was",
        count=1000,
        sample=40,
        cases=flipped_cases,
        check=check,
    ),
)
