"""Names from outside on their way through the whole command: every output is well-formed and has the structure that
ordinary names give it."""

from __future__ import annotations

import csv
import io
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import av
import pytest
from markdown_it import MarkdownIt

from evaluate.cli.evaluate import main
from evaluate.escaping.latex import COMMANDS
from evaluate.protocols.results import write_results
from evaluate.tables.format_data import FIELDS
from ggavatar.io.images import read_rgb
from ggavatar.io.json_files import read_json
from ggavatar.text.names import clean_name, clean_text
from tests.support.evaluations import evaluation
from tests.support.hostile_names import HOSTILE
from tests.support.image_pairs import write_folders
from tests.support.toy_run import HEIGHT, WIDTH, write_capture

NAMES = [name for name in HOSTILE if clean_text(name)]
CLEAN = list(dict.fromkeys(map(clean_name, NAMES)))
OBEYED = re.compile("[\0-\x09\x0b-\x1f\x7f-\x9f\ud800-\udfff\u202a-\u202e\u2066-\u2069\ufffe\uffff]")


def ordinary(name: str) -> str:
    """A harmless name for each hostile one, the same for those that are the same when they are clean."""
    return f"name {CLEAN.index(clean_name(name)):03d}"


def write_stored(folder: Path, names: list[str]) -> list[str]:
    """Result files with each name as subject, method, setting, note, reason and origin; four names are methods."""
    paths = []
    for seed, name in enumerate(names):
        home = folder / f"{seed:03d}"
        path, _ = write_results(evaluation("s", "m", lpips=(), seed=seed), home)
        content = read_json(path)
        content |= {"subject": name, "method": names[seed % 4], "notes": [name], "provenance": {name: name}}
        content["setup"] = {
            "origin": "run",
            "method": names[seed % 4],
            "preset": name,
            "steps": 5,
            "perceptual_loss": name,
        }
        content["setup"]["changed"] = {name: [name]}
        content["efficiency"] = {"fps": 3.0, "fps_statement": name}
        content["summary"]["lpips_alex"]["missing"] = f"no weights: {name}"
        path.write_text(json.dumps(content))
        paths.append(str(path))
    return paths


class Structure(HTMLParser):
    """The elements of a page in order, each with the names of its attributes and those values that no name is in."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.found: list[tuple[str, list[tuple[str, str | None]]]] = []
        self.feed(path.read_text(encoding="utf-8"))
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, [(key, None if key == "title" else value) for key, value in attrs]))


def markdown_structure(text: str) -> list[tuple[str, list[str]]]:
    """Blocks of a document in order, and the markup within each text."""
    parser = MarkdownIt("commonmark").enable(["table", "strikethrough"])
    return [
        (
            token.type,
            [
                part.content or part.type
                for part in token.children or ()
                if part.type not in ("text", "text_special") and "span>" not in part.content
            ],
        )
        for token in parser.parse(text)
    ]


def latex_structure(text: str) -> list[str]:
    """Commands in order without those that stand for special characters, and where braces open and close."""
    own = {command for value in COMMANDS.values() for command in re.findall(r"\\(?:[a-zA-Z]+|.)", value)}
    return [command for command in re.findall(r"\\(?:[a-zA-Z]+|.)", text) if command not in own]


def run(folder: Path, names: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    folder.mkdir()
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(folder / "summary.md"))
    flags = ["--table", "--layout", "subjects", "--no-report", "--github", "--fail-below", "psnr=90", "ssim=0.5"]
    outputs = ["--junit", str(folder / "junit.xml"), "-o", str(folder / "out")]
    assert main([*write_stored(folder / "stored", names), *flags, *outputs]) == 3


@pytest.mark.slow
def test_stored_names_reach_every_table_and_report_as_text(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    ours, theirs = tmp_path / "ordinary", tmp_path / "hostile"
    run(ours, [ordinary(name) for name in NAMES], monkeypatch)
    expected = capfd.readouterr()
    run(theirs, NAMES, monkeypatch)
    printed = capfd.readouterr()

    for text in printed:
        assert not OBEYED.search(text)
    assert len(printed.err.splitlines()) == len(expected.err.splitlines()) == 1
    commands = [[line for line in out.splitlines() if re.match(r"\s*::", line)] for out in (printed.out, expected.out)]
    assert len(commands[0]) == len(commands[1]) == len(NAMES) + 1
    assert not [line for line in printed.out.splitlines() if "##" in line and not line.startswith("::")]

    assert Structure(theirs / "out" / "table.html").found == Structure(ours / "out" / "table.html").found
    for name in ("out/table.md", "summary.md"):
        texts = [(folder / name).read_text(encoding="utf-8") for folder in (theirs, ours)]
        assert markdown_structure(texts[0]) == markdown_structure(texts[1]), name
    sources = [(folder / "out" / "table.tex").read_text(encoding="utf-8") for folder in (theirs, ours)]
    assert latex_structure(sources[0]) == latex_structure(sources[1])

    tables = [list(csv.reader(io.StringIO((f / "out" / "table.csv").read_text("utf-8")))) for f in (theirs, ours)]
    assert [row[5:7] for row in tables[0]] == [row[5:7] for row in tables[1]]
    assert {len(row) for row in tables[0]} == {len(FIELDS)}
    formulas = [cell for row in tables[0] for cell in row if re.match(r"[=+\-@\t＝＋－＠]", cell)]
    assert not [cell for cell in formulas if not re.fullmatch(r"[-+\d.e ±\[\],*]+", cell)]

    cases = [list(ElementTree.parse(folder / "junit.xml").iter("testcase")) for folder in (theirs, ours)]
    assert len(cases[0]) == len(cases[1]) == 2 * len(NAMES)
    content = json.loads((theirs / "out" / "table.json").read_text(encoding="utf-8"))
    labels = {row["label"] for row in content["tables"][0]["rows"][:-1]}
    assert labels == set(CLEAN)
    copies = {path.name for path in (theirs / "out" / "results").iterdir()}
    assert len(copies) == len(NAMES) and {path.name for path in theirs.iterdir()} == {
        "stored", "out", "junit.xml", "summary.md",
    }  # fmt: skip


FLAGS = (
    "\x1b]0;x\x07An\n::error::na</script><img src=x onerror=alert(1)>\ud800",
    "$\\write18{id}$ $x^$ ../../up \ufffe",
    "_hidden 张三 👩\u200d🦰 \u202e",
)


def test_names_of_flags_reach_figures_and_page(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_folders(tmp_path, [1, 2])
    structures = []
    for given in ("ordinary", *FLAGS):
        folders = ["--pred", str(tmp_path / "pred"), "--gt", str(tmp_path / "gt"), "-o", str(tmp_path / "out")]
        names = ["--subject", given, "--method", given]
        assert main([*folders, *names, "--metrics", "psnr", "--table", "--json", "--again"]) == 0
        captured = capfd.readouterr()
        lines = captured.out.splitlines()
        assert not OBEYED.search(captured.out) and not OBEYED.search(captured.err)
        assert not any(line.startswith("::") for line in lines)
        assert json.loads(lines[-1])["evaluations"][0]["subject"] == clean_name(given)
        stored = json.loads((tmp_path / "out" / "metrics.json").read_text(encoding="utf-8"))
        assert stored["subject"] == stored["method"] == clean_name(given)
        structures.append(Structure(tmp_path / "out" / "report.html").found)
        for figure in ("comparison.png", "curves.png", "worst.png"):
            assert read_rgb(tmp_path / "out" / figure).size
        with av.open(str(tmp_path / "out" / "side_by_side.mp4")) as video:
            assert set(video.metadata) <= {"major_brand", "minor_version", "compatible_brands", "encoder"}
    assert structures[1:] == structures[:1] * len(FLAGS)
    assert {path.name for path in tmp_path.iterdir()} == {"pred", "gt", "out"}


def test_names_of_captures_baselines_and_folders_are_cleaned(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """capture.json, a baseline, --pred-as, --paper-subjects and the folder's own name."""
    name, clean = "An\x1b[2J\n::error::na", "An\ufffd[2J ::error::na"
    capture = write_capture(tmp_path / "capture")
    described = json.loads((capture.folder / "capture.json").read_text())
    (capture.folder / "capture.json").write_text(json.dumps({**described, "subject": name}))
    pictures, _ = write_folders(tmp_path, [10, 15], HEIGHT, WIDTH)
    pictures = pictures.rename(tmp_path / "\x1b[1m\nbold")
    common = [
        "--capture",
        str(capture.folder),
        "--no-report",
        "--no-lpips",
        "--metrics",
        "psnr",
        "--regions",
        "foreground",
    ]
    kept = tmp_path / "kept.json"
    assert main(["--pred", str(pictures), *common, "-o", str(tmp_path / "a"), "--write-baseline", str(kept)]) == 0
    (entry,) = json.loads(kept.read_text())["evaluations"]
    assert (entry["subject"], entry["method"]) == (clean, "\ufffd[1m bold")
    kept.write_text(
        json.dumps({"schema": "ggavatar-baseline", "version": 1, "evaluations": [{**entry, "subject": name}]})
    )
    named = ["--pred-as", f"\n{entry['method']}@{name}={pictures}", "--paper-subjects", f"{name}=1"]
    assert main([*named, *common, "-o", str(tmp_path / "b"), "--compare", str(kept)]) == 0
    assert main([*named[:-1], "x\x1b=1", *common, "-o", str(tmp_path / "c")]) == 2
    assert not any(OBEYED.search(text) for text in capfd.readouterr())


def test_a_region_with_an_unusable_name_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_folders(tmp_path, [1])
    (tmp_path / "regions" / "fa\nce").mkdir(parents=True)
    folders = ["--pred", str(tmp_path / "pred"), "--gt", str(tmp_path / "gt"), "--no-report", "--metrics", "psnr"]
    assert main([*folders, "--region-masks", str(tmp_path / "regions")]) == 2
    assert "the name of a region, such as face, found 'fa\\nce'; rename it" in capfd.readouterr().err
