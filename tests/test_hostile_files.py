"""The bench of hostile files notices what it is there for: code that runs, files that change, time, memory, silence.

The files themselves are opened by `make faults` (all) and `.ci/run` (a few, others each day).
"""

from __future__ import annotations

import os
import random
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.faults.hostile import outputs
from tests.faults.hostile.bases import FILES, Trees, files_of, make_tree
from tests.faults.hostile.damage import mutations
from tests.faults.hostile.fixture import ACCEPTED, FAULT, REFUSED, Fixture, Flipped, Hostile, Mutated, Reading
from tests.faults.hostile.pool import Pool
from tests.faults.hostile.rows import attacks, hostile_cases
from tests.faults.hostile.samples import READERS_OF
from tests.mutations.mutation import ROOT
from tests.support.damaged_files import mutate, swapped

pytestmark = pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="measures memory as Linux does")

WATCHED = r"""
import contextlib, json, os, pickle, socket, subprocess, sys
from pathlib import Path
from jinja2 import Environment
from evaluate.figures import report
from tests.faults.hostile.watch import Watch, state_of

here = Path(sys.argv[1])
os.chdir(here)
(here / "victim").write_text("x")
(here / "scratch").mkdir()

class Code:
    def __reduce__(self):
        return exec, ("1",)

payload = pickle.dumps(Code())
harmful = {
    "system": lambda: os.system("true"),
    "process": lambda: subprocess.run(["true"]),
    "code": lambda: exec(compile("1", "<string>", "exec")),
    "unpickled code": lambda: pickle.loads(payload),
    "a file outside": lambda: open("victim", "w").close(),
    "a file by descriptor": lambda: os.close(os.open("made", os.O_CREAT | os.O_WRONLY)),
    "removed": lambda: os.remove("made"),
    "renamed": lambda: os.rename("victim", "victim2"),
    "a link": lambda: os.symlink("x", "link"),
    "network": lambda: socket.create_connection(("127.0.0.1", 9), 0.1),
    "a template": lambda: Environment().from_string("{{ 1 }}"),
    "a library": lambda: __import__("ctypes").CDLL("libc.so.6"),
}
harmless = {
    "read": lambda: open("victim2").read(),
    "written where it may": lambda: (here / "scratch" / "a").write_text("x"),
    "JSON": lambda: json.loads("[1]"),
    "a class": lambda: __import__("collections").namedtuple("A", "b"),
    "a template of ours": lambda: report._environment().get_template(report.TEMPLATE),
    "a module": lambda: __import__("wave"),
}
watch = Watch()
for kind, actions in (("harmful", harmful), ("harmless", harmless)):
    for name, action in actions.items():
        watch.start((here / "scratch",))
        with contextlib.suppress(OSError):
            action()
        print(kind, bool(watch.stop()), name)
before = state_of(here)
(here / "scratch" / "a").write_text("y!")
print("state", before != state_of(here), "")
"""


def test_the_watch_sees_what_reading_must_never_do(tmp_path: Path) -> None:
    line = [sys.executable, "-c", WATCHED, str(tmp_path)]
    ended = subprocess.run(
        line, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=True
    )
    seen = [row.split(" ", 2) for row in ended.stdout.splitlines()]
    assert len(seen) == 19
    assert [name for kind, found, name in seen if kind == "harmful" and found == "False"] == []
    assert [name for kind, found, name in seen if kind == "harmless" and found == "True"] == []
    assert seen[-1][:2] == ["state", "True"]


@pytest.mark.parametrize(
    ("result", "events", "cost", "words"),
    [
        ((REFUSED, "/x/files/a.npz: damaged"), [], (0.1, 1.0), ""),
        ((ACCEPTED, ""), [], (0.1, 1.0), "expected it to be refused"),
        ((REFUSED, "damaged"), [], (0.1, 1.0), "names none of"),
        ((REFUSED, "a.npz" + "x" * 5000), [], (0.1, 1.0), "characters"),
        ((REFUSED, "a.npz"), ["os.system('x')"], (0.1, 1.0), "os.system"),
        ((REFUSED, "a.npz"), [], (11.0, 1.0), "took 11.0 s"),
        ((REFUSED, "a.npz"), [], (0.1, 1500.0), "1500 MB"),
        ((FAULT, "KeyError: 'x'"), [], (0.1, 1.0), "KeyError"),
    ],
)
def test_a_reading_is_judged(result: tuple[str, str], events: list[str], cost: tuple[float, float], words: str) -> None:
    from tests.faults.hostile.worker import judge

    fixture = Hostile("x", FILES, "npz", "a.npz", {"a.npz": b""}, refused=True)
    wrong = judge(fixture, ["a.npz"], result, events, cost)
    assert words in wrong and bool(wrong) == bool(words)


def test_attacks_are_many_and_of_every_kind() -> None:
    """Titles tell them apart, since a failure is repeated by its title."""
    found = attacks()
    assert len(found) >= 1000
    assert max(Counter((fixture.name, fixture.reader, fixture.target) for fixture in found).values()) == 1
    readers = Counter(fixture.reader.partition(":")[0] for fixture in found)
    wanted = {"pickle", "weights", "npz", "npy", "json", "picture", "gaussians", "frames", "recording", "names", "run"}
    assert {name for name in wanted | {"capture", "tracking", "head", "mask-network"} if readers[name] < 5} == set()
    assert len(hostile_cases(60, 0)) <= 60 and {case.fault for case in hostile_cases(60, 0)} != {
        case.fault for case in hostile_cases(60, 1)
    }


def test_mutations_repeat_with_their_seed_and_reach_every_format(tmp_path: Path) -> None:
    for name in ("files", "pictures", "frames", "avatar"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.png").write_bytes(b"0123456789")
    found = mutations(tmp_path, 400, 3)
    assert found == mutations(tmp_path, 400, 3) != mutations(tmp_path, 400, 4)
    assert {fixture.file for fixture in found if isinstance(fixture, Mutated)} >= READERS_OF.keys()
    assert files_of(tmp_path / "avatar") == ["a.png"]


def test_damage_is_damage(tmp_path: Path) -> None:
    data, other = bytes(range(200)), b"other" * 30
    made = [mutate(data, random.Random(seed)) for seed in range(300)]
    assert sum(found != data for found in made) > 290 and len({len(found) for found in made}) > 20
    assert any(other[:9] in swapped(data, other, random.Random(seed)) for seed in range(9))
    assert mutate(b"", random.Random(0)) is not None
    (tmp_path / "a").write_bytes(data)
    Flipped("x", FILES, "npz", ".", "a", 5).plant(tmp_path)
    changed = int.from_bytes((tmp_path / "a").read_bytes(), "big") ^ int.from_bytes(data, "big")
    assert changed.bit_count() == 1


@pytest.mark.parametrize(
    ("check", "bad", "good"),
    [
        (outputs.check_html, "<td><script>1</script>", "<td>&lt;script&gt;1"),
        (outputs.check_html, "<img src='http://x/y.png'>", "<img src='data:image/png;base64,AA'>"),
        (outputs.check_html, "<a href=' javascript:alert(1)'>", "<a href='#top'>javascript:alert(1)</a>"),
        (outputs.check_html, "<td onmouseover='x'>", "<td title='onmouseover=x'>"),
        (outputs.check_csv, "a,=1+1\n", "a,-1.5,'=1+1\n"),
        (outputs.check_csv, '"@SUM(1)",b\n', '"x@SUM(1)",b\n'),
        (outputs.check_markdown, "| ![x](http://y) |", r"| \!\[x\]\(http://y\) |"),
        (outputs.check_markdown, "| [x](javascript:alert(1)) |", r"| \[x](javascript:alert(1)) |"),
        (
            outputs.check_markdown,
            "| a |\n|---|\n| [x][1] |\n\n[1]: data:,x",
            "| a |\n|---|\n| <span>$</span> **1** |\n",
        ),
        (outputs.check_markdown, "a <b onclick=x>", r"a \<b onclick=x>"),
        (outputs.check_markdown, "<script>1</script>", r"\<script>1"),
        (outputs.check_latex, r"a & \write18{x}", r"a & \textbackslash{}write18\{x\}"),
        (outputs.check_terminal, "a\x1b[2Jb", "a b"),
        (outputs.check_terminal, "x\n::owned\n", "x ::error\n"),
    ],
)
def test_outputs_are_checked(check, bad: str, good: str) -> None:
    assert check(bad) and not check(good)


def test_a_tree_is_restored_whatever_was_planted(tmp_path: Path) -> None:
    """A folder that was made for a planted file goes too, and one that a file took the place of comes back."""
    kept = {"a/b.npy": b"1", "c.json": b"2"}
    for name, content in kept.items():
        path = tmp_path / "originals" / FILES / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    (tmp_path / "sandbox").mkdir()
    trees = Trees(tmp_path / "originals", tmp_path / "sandbox")
    tree = trees.copy(FILES)
    planted = Hostile("x", FILES, "npy", ".", {"new/deep/b.npy": b"", "c.json": b"", "a": b""})
    trees.restore(FILES, planted.plant(tree))
    found = sorted(path.relative_to(tree).as_posix() for path in tree.rglob("*"))
    assert found == ["a", "a/b.npy", "c.json"]
    assert {name: (tree / name).read_bytes() for name in kept} == kept


def test_code_folders_are_those_that_the_tracker_writes(tmp_path: Path) -> None:
    """So that its arrays are read: with an array that has a lying header the message is about that array."""
    make_tree("emica", tmp_path / "emica")
    planted = {one.base: one for one in attacks() if one.reader == "tracking:emica"}["emica"]
    names = set(files_of(tmp_path / "emica"))
    assert isinstance(planted, Hostile) and planted.files.keys() <= names


@dataclass(frozen=True)
class Deadly(Fixture):
    """Ends the worker."""

    def plant(self, tree: Path) -> list[str]:
        os._exit(3)


@pytest.mark.slow
def test_a_worker_that_dies_is_a_fault_and_is_replaced(tmp_path: Path) -> None:
    """Then an ordinary file is read, and a pickle that wants to run something is refused."""
    (tmp_path / "originals" / FILES).mkdir(parents=True)
    (tmp_path / "originals" / FILES / "frame.frame").write_bytes(b"\x80\x02N.")
    pool = Pool(tmp_path / "originals", tmp_path / "workers")
    place = (FILES, "pickle", "frame.frame")
    assert pool.read(Deadly("deadly", *place)) == Reading(FAULT, "the process died with exit code 3")
    assert pool.read(Hostile("plain", *place, {"frame.frame": b"\x80\x02N."})).verdict == ACCEPTED
    code = Hostile("code", *place, {"frame.frame": b"cos\nsystem\n(S'touch canary'\ntR."}, True)
    assert pool.read(code).verdict == REFUSED
    pool.close()
    assert not list((tmp_path / "workers").glob("*/canary"))
