"""Pictures rendered elsewhere are scored exactly as a run of their capture: the same bytes give the same numbers.

Also covers `evaluate/scoring/scored_frames.py`.
"""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from evaluate.options import Folders, Options, Override, parse
from evaluate.protocols.protocol import protocol_by_name
from evaluate.protocols.setup import Setup
from evaluate.scoring import run as run_evaluation
from evaluate.scoring.evaluation_job import Reporter
from evaluate.scoring.pictures import evaluate_pictures, find_pictures, parse_named_folder
from evaluate.scoring.run import evaluate_run
from evaluate.scoring.scored_frames import choose_frames
from evaluate.tables.write import build_tables
from ggavatar.errors import InputError
from ggavatar.formats.source_options import GaussianFileOptions
from ggavatar.io.images import read_rgb, write_png
from ggavatar.training.run_folder import Run, write_config
from tests.support.silent_reporter import SilentReporter
from tests.support.toy_run import COUNT, HEIGHT, WIDTH, head, toy_run

OPTIONS = Options(no_learned=True, quiet=True, device="cpu")


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """The toy run with its files, and a head whose face and mouth are regions."""
    made = toy_run(tmp_path)
    write_config(made.folder, made.config, made.split)
    regions = {"face": torch.tensor([0, 1, 3]), "lips": torch.tensor([0, 2, 3])}
    model = dataclasses.replace(head(), regions=regions)
    monkeypatch.setattr("evaluate.scoring.region_masks.load_head", lambda path: model)
    monkeypatch.setattr(run_evaluation, "open_run", lambda folder, device: made)
    return made


def options_for(run: Run, pictures: Path, **changes: object) -> Options:
    folders = Folders(pred=pictures, method="theirs", seed=5)
    source = GaussianFileOptions(capture=run.capture.folder)
    return dataclasses.replace(OPTIONS, folders=folders, source=source, **changes)


def copied_predictions(run: Run, to: Path) -> Path:
    """Score the run and copy its predictions, as another program might have rendered them."""
    ours, _ = evaluate_run(run.folder, OPTIONS, SilentReporter())
    shutil.copytree(run.folder / "eval" / ours.protocol.id / "predictions", to)
    return to


def score(options: Options, reporter: Reporter | None = None) -> tuple[object, Path]:
    (pictures,) = find_pictures(options)
    evaluation, files = evaluate_pictures(pictures, options, reporter or SilentReporter())
    return evaluation, files[0]


def test_identical_pictures_get_identical_numbers(run: Run, tmp_path: Path) -> None:
    pictures = copied_predictions(run, tmp_path / "their renders")
    before = {path.name: path.read_bytes() for path in pictures.iterdir()}
    _, (our_file, _) = evaluate_run(run.folder, OPTIONS, SilentReporter())
    theirs, their_file = score(options_for(run, pictures))
    first, second = (json.loads(path.read_text()) for path in (our_file, their_file))
    own_words = {"content_sha256", "method", "seed", "setup", "efficiency", "provenance", "notes"}
    assert first.keys() == second.keys()
    for key in first.keys() - own_words:
        assert first[key] == second[key], key
    assert "psnr@face" in first["summary"] and first["summary"]["psnr@mouth"]["count"] == len(run.split.test)
    assert {"predictions", "ground_truth", "masks/foreground", "masks/face", "masks/mouth"} <= set(first["hashes"])
    assert first["provenance"]["capture_sha256"] == second["provenance"]["capture_sha256"] == run.capture.digest()
    assert (theirs.method, theirs.seed, theirs.setup) == ("theirs", 5, Setup("elsewhere"))
    assert {path.name: path.read_bytes() for path in pictures.iterdir()} == before, (
        "nothing is written into their folder"
    )
    assert their_file.is_relative_to(tmp_path / "their renders-evaluation")


def test_they_stand_in_one_table_and_are_ranked_with_ours(run: Run, tmp_path: Path) -> None:
    pictures = copied_predictions(run, tmp_path / "theirs")
    for path in pictures.iterdir():
        write_png(path, np.full_like(read_rgb(path), 255))
    ours, _ = evaluate_run(run.folder, OPTIONS, SilentReporter())
    theirs, _ = score(options_for(run, pictures))
    main = build_tables([ours, theirs])[0]
    assert [column.group for column in main.columns[::3]] == ["toy", "theirs"]
    assert {main.rows[0].cells[0].mark, main.rows[0].cells[3].mark} == {"best", "second"}
    assert any("theirs: rendered elsewhere" in note for note in main.notes)


def test_beside_runs_they_take_the_runs_capture_protocol_and_test_frames(run: Run, tmp_path: Path) -> None:
    pictures = copied_predictions(run, tmp_path / "a")
    options = dataclasses.replace(
        OPTIONS, runs=(run.folder,), folders=Folders(pred_as=(f"a={pictures}",)), output=tmp_path / "out"
    )
    evaluation, file = score(options)
    ours, _ = evaluate_run(run.folder, OPTIONS, SilentReporter())
    assert (evaluation.protocol, evaluation.values) == (ours.protocol, ours.values)
    assert file == tmp_path / "out" / "pictures" / "toy-a" / "eval" / ours.protocol.id / "metrics.json"
    listed = dataclasses.replace(run.config, split="file:/elsewhere.json")
    write_config(run.folder, listed, dataclasses.replace(run.split, test=(12,)))
    shutil.copy(pictures / "000010.png", pictures / "000012.png")
    evaluation, _ = score(options)
    assert evaluation.frames == (12,)


def test_several_subjects_need_names(run: Run, tmp_path: Path) -> None:
    other = toy_run(tmp_path / "other")
    described = other.capture.folder / "capture.json"
    described.write_text(described.read_text().replace('"subject": "toy"', '"subject": "second"'))
    write_config(other.folder, other.config, other.split)

    def found(text: str) -> list[str]:
        options = dataclasses.replace(OPTIONS, runs=(run.folder, other.folder), folders=Folders(pred_as=(text,)))
        return [one.capture.subject for one in find_pictures(options)]

    assert found("a@second=x") == ["second"] and found("a@toy=x") == ["toy"]
    with pytest.raises(InputError, match=r"2 subjects \(toy, second\).*a@toy=x"):
        found("a=x")
    with pytest.raises(InputError, match="did you mean second"):
        found("a@secon=x")
    with pytest.raises(InputError, match="a of toy is named twice"):
        find_pictures(dataclasses.replace(OPTIONS, runs=(run.folder,), folders=Folders(pred_as=("a=x", "a=y"))))
    for text in ("a", "=x", "a="):
        with pytest.raises(InputError, match="NAME=DIR"):
            parse_named_folder(text)
    with pytest.raises(InputError, match="add a run folder, or --capture DIR"):
        find_pictures(dataclasses.replace(OPTIONS, runs=(described,), folders=Folders(pred_as=("a=x",))))


def test_missing_frames_and_names_by_position_are_refused(run: Run, tmp_path: Path) -> None:
    pictures = copied_predictions(run, tmp_path / "p")
    (pictures / "000015.png").rename(pictures / "000016.png")
    with pytest.raises(InputError, match=r"1 of 2 test frames are missing: 000015\.png; render them"):
        score(options_for(run, pictures))
    (pictures / "000010.png").rename(pictures / "000000.png")
    (pictures / "000016.png").rename(pictures / "000001.png")
    with pytest.raises(InputError, match=r"2 of 2 .* 000010\.png, 000015\.png; the names count from 0 to 1.*never by"):
        score(options_for(run, pictures))
    assert not (tmp_path / "p-evaluation").exists()


def test_another_size_is_refused(run: Run, tmp_path: Path) -> None:
    pictures = copied_predictions(run, tmp_path / "p")
    write_png(pictures / "000015.png", np.zeros((HEIGHT, WIDTH + 1, 3), np.uint8))
    with pytest.raises(InputError, match=rf"000015\.png: expected {WIDTH}×{HEIGHT} px.* found {WIDTH + 1}×{HEIGHT}"):
        score(options_for(run, pictures))


def test_a_changed_picture_is_scored_again_and_a_changed_copy_restored(run: Run, tmp_path: Path) -> None:
    pictures = copied_predictions(run, tmp_path / "p")
    options = options_for(run, pictures)
    first, file = score(options)
    copy = file.parent / "predictions" / "000010.png"
    original = copy.read_bytes()
    write_png(copy, np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    reporter = SilentReporter()
    assert score(options, reporter)[0] == first and copy.read_bytes() == original
    assert any("images of 1 frame (10) changed" in line for line in reporter.warnings)
    write_png(pictures / "000010.png", np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    second, _ = score(options)
    assert second.values["psnr"][0] < first.values["psnr"][0] and second.values["psnr"][1] == first.values["psnr"][1]
    for path in sorted(pictures.glob("*.png")):
        shutil.move(path, path.with_name(f"frame-{int(path.stem)}.png"))
    assert score(options)[0] == second


def test_a_list_of_test_frames_can_be_given(run: Run, tmp_path: Path) -> None:
    pictures = copied_predictions(run, tmp_path / "p")
    options = options_for(run, pictures, protocol="gaussian-avatars")
    with pytest.raises(InputError, match=r"scores a list of test frames.*--split file:PATH"):
        score(options)
    (tmp_path / "list.json").write_text(json.dumps({"train": [11, 12], "test": [15]}))
    override = Override(split=f"file:{tmp_path / 'list.json'}")
    evaluation, _ = score(dataclasses.replace(options, override=override))
    assert evaluation.frames == (15,)
    assert evaluation.protocol.split == "file" and "list" not in evaluation.protocol.id


def test_the_same_list_makes_the_same_protocol_wherever_its_file_lies() -> None:
    digests = {
        dataclasses.replace(OPTIONS, override=Override(split=f"file:{place}")).base_protocol("every-20th").digest
        for place in ("a.json", "/b/c.json")
    }
    assert len(digests) == 1


def test_frames_of_a_protocol(run: Run) -> None:
    last = protocol_by_name("paper").override(split="last-2")
    assert choose_frames(run.capture, last).frames == (8 + COUNT, 9 + COUNT)
    assert choose_frames(run.capture, protocol_by_name("paper")).frames == run.split.test


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--pred", "a"], "expected --capture DIR"),
        (["--pred", "a", "--gt", "b", "--capture", "c"], "leave --gt out"),
        (["--pred", "a", "--capture", "c", "--masks", "d"], "leave them out"),
        (["run", "--pred", "a", "--capture", "c"], "--pred-as NAME=DIR"),
        (["--gt", "a"], "found no --pred"),
    ],
)
def test_flags_that_contradict_one_another(arguments: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse(arguments)


def test_label_is_another_name_for_method() -> None:
    assert parse(["--pred", "a", "--capture", "c", "--label", "mine"]).folders.method == "mine"
