"""A fault as data: what is done to which command, what is expected, and what became of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tests.faults.bench import Bench


@dataclass(frozen=True)
class Case:
    """One fault that is injected."""

    row: str
    """Name of the row of the table that it counts for."""
    command: str
    """What is exposed to the fault: a command such as `train`, or a reader such as `png`."""
    fault: str
    """What is done to it, in words; unique within the row together with command and seed."""
    seed: int
    """Decides everything that is random: the moment, the byte, the bit."""
    expectation: str
    """What must hold afterwards, in words."""

    @property
    def title(self) -> str:
        """One line that names the case and suffices to repeat it."""
        return f"{self.row}: {self.command}, {self.fault} (seed {self.seed})"


@dataclass(frozen=True)
class Outcome:
    """What became of one case.

    Attributes:
        wrong: What does not hold, one sentence each; empty if the case passed.
        seconds: Time that it took, s.
    """

    case: Case
    wrong: tuple[str, ...]
    seconds: float


@dataclass(frozen=True)
class Row:
    """A row of the table in docs/reliability.md: cases of one kind."""

    name: str
    """Unique; `--row` takes it, with `*` for anything."""
    does: str
    """What is done, for the table."""
    passes_when: str
    """What must hold, for the table."""
    count: int
    """Cases of the full run."""
    sample: int
    """Cases of the sample that CI takes, about a minute a row at most."""
    cases: Callable[[int, int], Sequence[Case]]
    """The cases for a count and a seed; another seed gives others, the same seed the same."""
    check: Callable[[Case, Bench], Sequence[str]]
    """Injects the fault and says what does not hold, one sentence each; nothing if all holds. It may run in a thread
    beside others, each with another case; what they share comes from the bench."""
