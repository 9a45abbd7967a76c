"""The rows of the table that are about files: hostile ones, mutations, and flipped bits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from tests.faults.bench import Bench
from tests.faults.case import Case, Row
from tests.faults.hostile.bases import make_tree
from tests.faults.hostile.damage import flips, mutations
from tests.faults.hostile.fixture import FAULT, Fixture
from tests.faults.hostile.pool import Pool

EXPECTATION = "no code runs; within 10 s and 1 GB it is read, or refused by a message that names the file"


@dataclass(frozen=True)
class FixtureCase(Case):
    """A fixture as a case of a row."""

    fixture: Fixture
