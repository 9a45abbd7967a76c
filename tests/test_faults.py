"""The bench of faults notices what it is there for: programs that lose, mix or leave something make their rows fail.

The faults themselves are injected by `make faults` (all) and `.ci/run` (a few, others each day). Here the commands are
small programs that do what ours must not: write in place, leave temporary files, differ after a kill, say too much.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.faults import disk, kill, surroundings
from tests.faults.__main__ import main
from tests.faults.bench import Bench, Ended, Surroundings
from tests.faults.case import Case, Row
from tests.faults.catalogue import ROWS, named
from tests.faults.contents import contents, differences, half_written
from tests.faults.endings import complaints
from tests.faults.ledger import Entry
from tests.faults.report import BEGIN, END, tally, write_table
from tests.faults.run import run_row
from tests.faults.small_disk import can_mount, small_disk
from tests.faults.tasks import Task, nothing

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs process groups and a POSIX shell")

WRITER = """
import json, os, sys, time
folder, way = sys.argv[1:3]
os.makedirs(folder, exist_ok=True)
for number in range(8):
    path = os.path.join(folder, f"{number}.json")
    if os.path.exists(path) and way != "again":
        continue
    text = json.dumps(list(range(100)))
    name = path if way == "in place" else os.path.join(folder, f".{number}.json.part")
    with open(name, "w") as file:
        for start in range(0, len(text), 50):
            file.write(text[start : start + 50])
            file.flush()
            time.sleep(0.001)
    if way != "in place":
        os.replace(name, path)
"""
"""Writes eight files: whole or in place."""


def bench_of(tmp_path: Path, script: str) -> Bench:
    """A bench whose only command is a script."""
    (tmp_path / "program.py").write_text(script)
    (tmp_path / "bench").mkdir()
    return Bench(tmp_path / "bench", lambda _: [sys.executable, "-S", "-E", str(tmp_path / "program.py")])


def writer(way: str) -> Task:
    return Task("writer", "writer", lambda bench: ("out", way), nothing, "out")


def wrong_of(row: Row, bench: Bench, count: int) -> list[str]:
    outcomes = run_row(row, row.cases(count, 0), bench, lambda outcome: None)
    assert len(outcomes) == count
    return [text for outcome in outcomes for text in outcome.wrong]


def kill_row(task: Task) -> Row:
    return kill.row_of("kill-writer", 4, 1, (task,))


def test_a_command_that_writes_whole_files_survives_every_kill(tmp_path: Path) -> None:
    assert wrong_of(kill_row(writer("whole")), bench_of(tmp_path, WRITER), 6) == []


def test_a_write_in_place_is_noticed(tmp_path: Path) -> None:
    wrong = wrong_of(kill_row(writer("in place")), bench_of(tmp_path, WRITER), 6)
    assert any("half written" in text for text in wrong) and any("differs" in text for text in wrong)


def test_a_temporary_file_that_stays_is_noticed(tmp_path: Path) -> None:
    script = WRITER.replace('f".{number}.json.part"', 'f".{number}-{os.getpid()}.json.part"')
    assert any("left over" in text for text in wrong_of(kill_row(writer("whole")), bench_of(tmp_path, script), 6))


def test_a_folder_that_comes_back_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disk, "TASKS", (writer("in place"),))
    case = Case("disk", "writer", f"{disk.REMOVED} after 0.4", 24, "")
    stubborn = WRITER.replace("    name = path", "    os.makedirs(folder, exist_ok=True)\n    name = path")
    slow = stubborn.replace("0.001", "0.01")
    assert any("came back" in text for text in disk.check(case, bench_of(tmp_path, slow)))


@pytest.mark.skipif(not can_mount(), reason="needs the right to mount a tmpfs")
def test_a_full_disk_is_one_and_its_traceback_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disk, "TASKS", (writer("whole"),))
    case = Case("disk", "writer", f"{disk.FULL} after 0.5", 26, "")
    wrong = disk.check(case, bench_of(tmp_path, WRITER))
    assert any("No space left on device" in text and "Traceback" in text for text in wrong)
    with small_disk(tmp_path) as small:
        small.make_read_only()
        with pytest.raises(OSError, match="Read-only"):
            (tmp_path / "file").write_text("x")


def test_a_check_that_fails_is_a_failure_and_a_reference_is_made_once(tmp_path: Path) -> None:
    bench = bench_of(tmp_path, "import sys; print('no'); sys.exit(1)")
    wrong = wrong_of(kill_row(writer("whole")), bench, 3)
    assert len(wrong) == 3 and all("failed without a fault" in text for text in wrong)
    assert len(list(bench.folder.glob("*"))) == 1  # shared; the folders of cases are gone


def test_signals_streams_and_limits_reach_a_command(tmp_path: Path) -> None:
    report = "import os, resource, sys; sys.stderr.write(f\"{sys.stdout} {os.environ.get('HOME')} \""
    bench = bench_of(tmp_path, report + ' f"{resource.getrlimit(resource.RLIMIT_NOFILE)[0]}")')
    around = Surroundings(tmp_path, {"HOME": None}, "exec >&-; ulimit -n 24")
    assert bench.run("any", (), around).errors == "None None 24"


@pytest.mark.parametrize(
    ("ended", "codes", "complaint"),
    [
        (Ended(1, "", "error: the disk is full\n", 1.0), {1}, None),
        (Ended(0, "done", "", 1.0), {0}, None),
        (Ended(-signal.SIGINT, "", "", 1.0), {130, -signal.SIGINT}, None),
        (Ended(0, "", "", 1.0), {1}, "expected exit code 1"),
        (Ended(1, "", "error: a\nerror: b\n", 1.0), {1}, "found 2"),
        (Ended(1, "", "", 1.0), {1}, "found 0"),
        (Ended(1, "", "error: a\nTraceback (most recent call last)\n", 1.0), {1}, "Traceback"),
        (Ended(None, "", "", 300.0), {0}, "hung"),
    ],
)
def test_ends_of_commands(ended: Ended, codes: set[int], complaint: str | None) -> None:
    wrong = complaints(ended, codes)
    assert (wrong == []) if complaint is None else (complaint in wrong[0])


def test_a_comparison_ignores_times_and_sees_everything_else(tmp_path: Path) -> None:
    first, second = tmp_path / "here" / "run", tmp_path / "there" / "run"
    for folder, seconds, loss in ((first, 1.0, 0.5), (second, 2.0, 0.25)):
        folder.mkdir(parents=True)
        (folder / "journal.jsonl").write_text(f'{{"step": 1, "seconds": {seconds}}}\n')
        (folder / "table.csv").write_text(f"metric,value\nefficiency,{seconds}\n")
        (folder / "run.json").write_text(f'{{"run": "{folder}"}}')
        (folder / "metrics.json").write_text(f'{{"loss": {loss}}}')
    (second / ".1.part").write_text("")
    assert differences(contents(second), contents(first)) == [".1.part: left over", "metrics.json: differs"]
    (second / "cut.json").write_text('{"loss": 0.2')
    assert ["cut.json" in text for text in half_written(second)] == [True]


def test_rows_have_distinct_names_and_cases_that_can_be_repeated() -> None:
    assert len({row.name for row in ROWS}) == len(ROWS)
    for row in (*kill.ROWS, *disk.ROWS, *surroundings.ROWS):
        cases = row.cases(5, 7)
        assert list(cases) == list(row.cases(5, 7)) and len(cases) == 5
        assert len({case.title for case in cases}) == 5 and {case.row for case in cases} == {row.name}
        assert row.cases(5, 8) != cases and row.sample <= row.count


def test_every_command_meets_all_surroundings() -> None:
    met = {(case.command, case.fault) for case in surroundings.cases(surroundings.COUNT, 0)}
    assert len(met) == len(surroundings.TASKS) * len(surroundings.FAULTS) == surroundings.COUNT


def planted(wrong: Sequence[str]) -> Row:
    def cases(count: int, seed: int) -> list[Case]:
        return [Case("planted", "train", "nothing", seed + number, "all is well") for number in range(count)]

    return Row("planted", "nothing | at all", "all is well", 3, 1, cases, lambda case, bench: list(wrong))


def test_the_command_reports_counts_and_failures(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\n{END}\nafter\n")
    assert main(["--jobs", "1", "--write", str(page)], [planted(())]) == 0
    assert "3 cases     0 failures" in capsys.readouterr().out
    assert main(["--sample", "--seed", "4"], [planted(("it is lost",))]) == 1
    said = capsys.readouterr().out
    assert "FAILED planted: train, nothing (seed 4); expected: all is well\n  it is lost" in said
    assert main(["--row", "no such row"], [planted(())]) == 2 and "known are planted" in capsys.readouterr().out
    assert main(["--list", "--count", "2"], [planted(())]) == 0 and len(capsys.readouterr().out.splitlines()) == 2
    assert main(["--case", "1", "7"], [planted(())]) == 0 and "1 cases" in capsys.readouterr().out
    assert [row.name for row in named(["kill-*"])] == [f"kill-{name}" for name in kill.COMMANDS]
    text = page.read_text()
    assert text.startswith(f"before\n{BEGIN}\n") and text.endswith(f"{END}\nafter\n") and "`planted`" in text


def test_the_table_keeps_the_lines_of_other_rows(tmp_path: Path) -> None:
    """And names every commit that cases of a row were run with."""
    page = tmp_path / "page.md"
    page.write_text(f"{BEGIN}\n{END}\n")
    first, second = planted(()), Row("other", "more", "it holds", 1, 1, planted(()).cases, planted(()).check)
    days = ("2026-12-01", "2026-12-03")
    entries = [Entry(str(n), ("lost",), 0.075, days[n % 2], "s", f"abc{n % 2}", "2 cores") for n in range(1200)]
    write_table(page, [tally(second, entries)], (first, second))
    write_table(page, [tally(first, entries[:1]), tally(second, [])], (first, second))
    lines = [line for line in page.read_text().splitlines() if line.startswith("| `")]
    assert [line.split("|")[1].strip() for line in lines] == ["`planted`", "`other`"]
    assert "| 1,200 | 1,200 | 1.5 | 2026-12-01 to 2026-12-03 | abc0, abc1 | 2 cores |" in lines[1]
    write_table(page, [], (first,))
    assert "other" not in page.read_text()
    with pytest.raises(ValueError, match="found none"):
        write_table(Path(__file__).with_name("conftest.py"), [], (first,))


def test_outcomes_are_kept_and_passed_cases_are_not_run_again(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A row in two parts is counted as a whole; a failure is run again, another build runs everything again."""
    kept, wrong = ("--jobs", "1", "--results", str(tmp_path)), ["it is lost"]
    assert main([*kept, "--case", "0", "1"], [planted(wrong)]) == 1
    file = tmp_path / "planted.jsonl"
    file.write_text(file.read_text() + '{"case": "planted: train, nothing (see')  # killed while it wrote
    assert main([*kept, "--case", "0", "2"], [planted(())]) == 1
    assert "3 cases     1 failures" in capsys.readouterr().out
    assert main(kept, [planted(())]) == 0
    assert "2 of 3 cases have passed with this code before" in capsys.readouterr().out
    assert len(file.read_text().splitlines()) == 6
    monkeypatch.setattr("tests.faults.__main__.sources_digest", lambda: "another")
    assert main([*kept, "--no-run"], [planted(wrong)]) == 0 and main(kept, [planted(wrong)]) == 1
    assert "3 cases     3 failures" in capsys.readouterr().out
