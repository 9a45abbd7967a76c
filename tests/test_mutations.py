"""The list of planted faults applies to today's code and names tests that exist, and its runner tells verdicts apart.

The faults themselves are planted by `make mutations` (all) and `.ci/run` (eight a day).
"""

from __future__ import annotations

import ast
import datetime
import functools
from pathlib import Path

import pytest

from tests.mutations.__main__ import main
from tests.mutations.catalogue import AREAS, MUTATIONS, drawn, named
from tests.mutations.mutation import ROOT, Mutation, StaleMutation
from tests.mutations.run import KILLED, SURVIVED, UNDECIDED, Settings, run_mutation


@functools.cache
def names_of_tests(file: str) -> frozenset[str]:
    """Names of the test functions in a file."""
    return frozenset(
        node.name for node in ast.walk(ast.parse((ROOT / file).read_text())) if isinstance(node, ast.FunctionDef)
    )


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.name)
def test_every_fault_can_be_planted_and_has_tests(mutation: Mutation) -> None:
    planted = mutation.planted((ROOT / mutation.file).read_text(encoding="utf-8"))
    if mutation.file.endswith(".py"):
        ast.parse(planted)
    assert mutation.tests
    for test in mutation.tests:
        file, _, name = test.partition("[")[0].partition("::")
        assert (ROOT / file).is_file() and (not name or name in names_of_tests(file)), test


def test_the_list_is_long_and_its_names_are_unique() -> None:
    assert len({mutation.name for mutation in MUTATIONS}) == len(MUTATIONS) >= 70
    assert all(len(area.MUTATIONS) >= 8 for area in AREAS)


def test_samples_of_consecutive_days_go_through_all() -> None:
    days = [datetime.date(2026, 12, 1) + datetime.timedelta(days) for days in range(-(-len(MUTATIONS) // 8))]
    samples = [drawn(8, day) for day in days]
    assert all(len({mutation.name for mutation in sample}) == 8 for sample in samples)
    assert {mutation.name for sample in samples for mutation in sample} == {mutation.name for mutation in MUTATIONS}
    assert drawn(8, days[3]) == samples[3] and len(drawn(10**6, days[0])) == len(MUTATIONS)


def test_mutations_are_chosen_by_name_or_file() -> None:
    assert [mutation.name for mutation in named(["cooling_never_applied"])] == ["cooling_never_applied"]
    assert {mutation.file for mutation in named(["ggavatar/data/splits.py"])} == {"ggavatar/data/splits.py"}
    assert named(["no such thing"]) == []


SOURCE = "ggavatar/numbers.py"
PROJECT = {
    SOURCE: "def double(x):\n    return 2 * x\n",
    "tests/test_numbers.py": """
import time

from ggavatar.numbers import double


def test_sees():
    assert double(3) == 6


def test_looks_away():
    assert double(0) == 0


def test_waits():
    time.sleep(0 if double(3) == 6 else 60)
""",
    "pyproject.toml": '[tool.pytest.ini_options]\npythonpath = ["."]\naddopts = "--import-mode=importlib"\n',
}


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project of one function and three tests, for a pytest without plugins, which starts faster."""
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    for name, text in PROJECT.items():
        path = tmp_path / "project" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path / "project"


def fault(test: str, old: str = "2 * x", new: str = "4 * x") -> Mutation:
    return Mutation("fourfold", SOURCE, old, new, (f"tests/test_numbers.py::{test}",))


def test_faults_are_noticed_survive_or_stay_undecided(project: Path) -> None:
    settings = Settings(jobs=1, limit=200.0, preloaded=())
    seen = run_mutation(fault("test_sees"), project, settings)
    assert (seen.verdict, seen.detail) == (KILLED, "tests/test_numbers.py::test_sees")
    assert run_mutation(fault("test_looks_away"), project, settings).verdict == SURVIVED
    assert run_mutation(fault("test_that_does_not_exist"), project, settings).verdict == UNDECIDED
    late = run_mutation(fault("test_waits"), project, Settings(jobs=1, limit=5.0, preloaded=()))
    assert late.verdict == UNDECIDED and "no end within 5 s" in late.detail
    assert (project / SOURCE).read_text() == PROJECT[SOURCE]


def test_a_fault_that_no_longer_applies_is_an_error() -> None:
    for old, new in (("3 * x", "4 * x"), ("x", "y"), ("2 * x", "2 * x")):
        with pytest.raises(StaleMutation, match=r"ggavatar/numbers\.py"):
            fault("test_sees", old, new).planted(PROJECT[SOURCE])


def test_the_checkout_is_never_changed() -> None:
    with pytest.raises(AssertionError, match="copies"):
        MUTATIONS[0].plant(ROOT)


def test_the_command_says_what_survives(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--jobs", "1"], [fault("test_sees")], project) == 0
    assert "1 of 1 mutations were noticed" in capsys.readouterr().out
    assert main(["--jobs", "1"], [fault("test_sees"), fault("test_looks_away")], project) == 1
    out = capsys.readouterr().out
    assert "1 of 2 mutations were noticed" in out and "SURVIVED: Mutation(name='fourfold'" in out
    assert main([], [fault("test_sees", "3 * x")], project) == 1
    assert "found it 0 times" in capsys.readouterr().out
    (project / "ggavatar" / "numbers.py").write_text("def double(x):\n    return 2 * x + 1\n")
    assert main(["--jobs", "1"], [fault("test_sees")], project) == 1
    assert "the tests fail on the unchanged project" in capsys.readouterr().out


def test_the_command_lists_and_refuses(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--list", "--sample", "8", "--date", "2026-12-01"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 8
    assert main(["no such thing"]) == 2 and "found none" in capsys.readouterr().out
    with pytest.raises(SystemExit) as refused:
        main(["--date", "today"])
    assert refused.value.code == 2
