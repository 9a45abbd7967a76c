"""What became of the cases of a row, line by line in a file, so that a row can be run in parts and at different times.

Each line names the sources that were tried, by a digest and a commit. A case that passed is not run again while the
sources are the same; of a case that was tried several times the last outcome counts.
"""

from __future__ import annotations

import functools
import hashlib
import json
import subprocess
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from tests.faults.case import Case, Outcome
from tests.mutations.mutation import ROOT

SOURCES = ("ggavatar", "preprocess", "evaluate", "tests/faults", "tests/support")
"""Folders whose Python files decide what becomes of a case."""


@dataclass(frozen=True)
class Entry:
    """One outcome of one case.

    Attributes:
        case: Its title.
        wrong: What did not hold; empty if it passed.
        seconds: Time that it took, s.
        day: When, as YYYY-MM-DD.
        sources: Digest of the code, see `sources_digest`.
        commit: The commit of the checkout, with `+` if the code was changed since.
        machine: What kind of machine it was.
    """

    case: str
    wrong: tuple[str, ...]
    seconds: float
    day: str
    sources: str
    commit: str
    machine: str


class Ledger:
    """The outcomes of rows in a folder, a file of JSON lines each; half a line at the end, after a kill, is ignored.

    Args:
        folder: Made if it does not exist.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def entries(self, row: str, cases: Sequence[Case]) -> list[Entry]:
        """The last outcome of each of these cases of a row that was tried; others are no cases of it any more."""
        path = self._folder / f"{row}.jsonl"
        if not path.exists():
            return []
        lines = path.read_text(encoding="utf-8").split("\n")[:-1]
        found = [Entry(**json.loads(line)) for line in lines if line.endswith("}")]
        last = {entry.case: entry for entry in found}
        return [last[case.title] for case in cases if case.title in last]

    def open_cases(self, row: str, cases: Sequence[Case], sources: str) -> list[Case]:
        """The cases that have not passed with these sources."""
        passed = {entry.case for entry in self.entries(row, cases) if not entry.wrong and entry.sources == sources}
        return [case for case in cases if case.title not in passed]

    def add(self, outcome: Outcome, day: str, machine: str) -> None:
        """Write down an outcome."""
        case, wrong = outcome.case, outcome.wrong
        entry = Entry(case.title, wrong, round(outcome.seconds, 3), day, sources_digest(), commit(), machine)
        path = self._folder / f"{case.row}.jsonl"
        text = json.dumps(asdict(entry), ensure_ascii=True)
        is_torn = path.exists() and path.stat().st_size and not path.read_bytes().endswith(b"\n")
        with path.open("a", encoding="utf-8") as file:
            file.write(("\n" if is_torn else "") + text + "\n")


@functools.cache
def sources_digest() -> str:
    """A digest of the code that is tried and of the code that tries it, as it was when first asked for."""
    total = hashlib.sha256()
    for path in sorted(path for folder in SOURCES for path in (ROOT / folder).rglob("*.py")):
        total.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return total.hexdigest()


@functools.cache
def commit() -> str:
    """The checkout's commit, `+` after it if the code was changed since; `unknown` outside of a checkout."""
    try:
        number = _git("rev-parse", "--short=8", "HEAD")
        return number + ("+" if _git("status", "--porcelain", "--", *SOURCES) else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def _git(*arguments: str) -> str:
    return subprocess.run(("git", *arguments), cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
