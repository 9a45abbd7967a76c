"""Runs the cases of rows, some at a time."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

from tests.faults.bench import Bench
from tests.faults.case import Case, Outcome, Row


def run_case(row: Row, case: Case, bench: Bench) -> Outcome:
    """Inject one fault; a check that raises counts as failed."""
    began = time.monotonic()
    try:
        wrong = tuple(row.check(case, bench))
    except AssertionError as error:
        wrong = (f"the check failed: {error}",)
    except Exception:
        wrong = (f"the check failed:\n{traceback.format_exc()}",)
    return Outcome(case, wrong, time.monotonic() - began)


def run_row(row: Row, cases: Sequence[Case], bench: Bench, report: Callable[[Outcome], None]) -> list[Outcome]:
    """Run cases of a row; `report` is called with each outcome, in the order of the cases."""
    outcomes = []
    with ThreadPoolExecutor(bench.jobs) as pool:
        for outcome in pool.map(lambda case: run_case(row, case, bench), cases):
            report(outcome)
            outcomes.append(outcome)
    return outcomes
