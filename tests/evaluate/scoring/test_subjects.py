"""The subjects of a call are known before anything is rendered: a wrong --paper-subjects is refused at once."""

from __future__ import annotations

from pathlib import Path

import pytest

from evaluate.cli.evaluate import main
from evaluate.options import Options, parse
from evaluate.protocols.results import write_results
from evaluate.scoring.subjects import subjects_of
from ggavatar.training.run_folder import write_config
from tests.support.evaluations import evaluation
from tests.support.toy_run import toy_run

WRONG = [
    ("foo=ID1", "no subject 'foo' in the table"),
    ("subject-1=ID9", "expected SUBJECT=ID with ID 1"),
    ("subject-1", "expected SUBJECT=ID"),
]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run folder with its capture, of the subject toy; it cannot be rendered, since its method is unknown."""
    made = toy_run(tmp_path)
    write_config(made.folder, made.config, made.split)
    return made.folder


@pytest.mark.parametrize(("wrong", "message"), WRONG)
@pytest.mark.parametrize("kind", ["run", "pictures", "folders", "file"])
def test_a_wrong_subject_is_refused_before_anything_is_read_or_written(
    run: Path, capsys: pytest.CaptureFixture[str], wrong: str, message: str, kind: str
) -> None:
    absent, capture = str(run / "absent"), str(run.parent / "capture")
    (run.parent / "a.ply").write_bytes(b"ply\n")
    sources = {
        "run": [str(run)],
        "pictures": ["--pred", absent, "--capture", capture],
        "folders": ["--pred", absent, "--gt", absent],
        "file": [str(run.parent / "a.ply"), "--capture", capture],
    }
    before = sorted(run.parent.rglob("*"))
    assert main([*sources[kind], "--paper-subjects", wrong]) == 2
    error = capsys.readouterr().err
    assert f"--paper-subjects: {message}" in error and error.count("\n") == 1
    assert sorted(run.parent.rglob("*")) == before


def test_subjects_are_those_of_the_evaluations(run: Path, tmp_path: Path) -> None:
    write_results(evaluation("Anna", "m"), tmp_path / "stored")
    stored = tmp_path / "stored"
    assert subjects_of(Options(runs=(run, stored, stored / "metrics.json", run))) == ["toy", "Anna"]
    capture = str(tmp_path / "capture")
    assert subjects_of(parse(["--pred", "x", "--capture", capture])) == ["toy"]
    assert subjects_of(parse(["--pred", "x", "--capture", capture, "--subject", "Bert"])) == ["Bert"]
    assert subjects_of(parse([str(run), "--pred-as", "theirs=x"])) == ["toy"]
    assert subjects_of(parse(["--pred", "x", "--gt", str(tmp_path / "Carl" / "gt")])) == ["Carl"]
