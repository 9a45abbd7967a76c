"""Every table says how its runs were trained, and what differs between runs that share a column.

Also covers `evaluate/protocols/setup.py`.
"""

from __future__ import annotations

import dataclasses
import io
import json
import re
from pathlib import Path

import pytest
from rich.console import Console

from evaluate.cli.evaluate import headline
from evaluate.protocols.results import read_results, write_results
from evaluate.protocols.setup import Setup, setup_from_dict
from evaluate.tables.format_data import to_csv, to_json
from evaluate.tables.format_html import to_page
from evaluate.tables.format_latex import to_latex
from evaluate.tables.format_markdown import to_markdown
from evaluate.tables.format_terminal import show
from evaluate.tables.write import build_tables
from ggavatar.errors import InputError
from ggavatar.io.json_files import read_json
from tests.support.evaluations import evaluation

FAST = Setup("run", "ggavatar", "fast", 1500, "random")
DEFAULT = Setup("run", "ggavatar", "default", 6000, "vgg16")
FLASH = Setup("run", "flash_avatar", "fast", 1500, "random")
ELSEWHERE = Setup("elsewhere")


def terminal(tables: list) -> str:
    console = Console(width=400, record=True, file=io.StringIO())
    for table in tables:
        show(table, console)
    return console.export_text()


FORMATS = {
    "terminal": terminal,
    "md": to_markdown,
    "tex": to_latex,
    "csv": to_csv,
    "json": to_json,
    "html": to_page,
}


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_names_preset_length_and_features_of_every_method(name: str) -> None:
    runs = [evaluation("Anna", "ggavatar", setup=FAST), evaluation("Anna", "mine", setup=ELSEWHERE)]
    text = FORMATS[name](build_tables(runs)[:1])
    assert "preset fast, 1500 steps, perceptual loss random" in text
    assert "rendered elsewhere" in text


def test_runs_of_different_presets_lengths_and_features_in_one_column_are_said() -> None:
    runs = [evaluation("Anna", "ggavatar", setup=FAST), evaluation("Bert", "ggavatar", setup=DEFAULT)]
    for table in build_tables(runs):
        if table.name in ("comparison", "detail"):
            (note,) = [note for note in table.notes if note.startswith("Not alike")]
            assert "GGAvatar that differ in preset, length and perceptual loss stand together" in note
            assert "Anna preset fast, 1500 steps" in note and "Bert preset default, 6000 steps" in note
    alike = build_tables([evaluation(name, "ggavatar", setup=FAST) for name in ("Anna", "Bert")])
    assert not any("Not alike" in note for table in alike for note in table.notes)


def test_a_refined_tracking_is_named_and_told_from_one_as_tracked() -> None:
    refined, plain = (dataclasses.replace(FAST, tracking=words) for words in ("refined", "as tracked"))
    runs = [evaluation("Anna", "ggavatar", setup=refined), evaluation("Bert", "ggavatar", setup=plain)]
    (note,) = [note for note in build_tables(runs)[0].notes if note.startswith("Not alike")]
    assert "differ in tracking" in note and "perceptual loss random, refined tracking" in note
    methods = [evaluation("Anna", "ggavatar", setup=refined), evaluation("Anna", "flash_avatar", setup=FLASH)]
    assert any("the methods differ in tracking (GGAvatar refined" in note for note in build_tables(methods)[0].notes)
    assert "tracking" in [column.title for column in build_tables(runs)[-1].columns]
    assert setup_from_dict(refined.as_dict()) == refined


def test_seeds_of_one_cell_that_were_trained_differently_are_said() -> None:
    longer = Setup("run", "ggavatar", "fast", 3000, "random")
    runs = [evaluation("Anna", "ggavatar", seed=k, setup=setup) for k, setup in enumerate((FAST, longer))]
    (note,) = [note for note in build_tables(runs)[0].notes if note.startswith("Not alike")]
    assert "differ in length" in note and "Anna, seed 0, preset fast, 1500 steps" in note


def test_changed_settings_are_shown_and_told_apart() -> None:
    changed = Setup("run", "ggavatar", "fast", 1500, "random", {"latent": 3})
    runs = [evaluation("Anna", "ggavatar", setup=FAST), evaluation("Bert", "ggavatar", setup=changed)]
    (note,) = [note for note in build_tables(runs)[0].notes if note.startswith("Not alike")]
    assert "differ in changed settings" in note and "random, latent=3" in note


def test_methods_that_were_trained_differently_are_said() -> None:
    longer = Setup("run", "flash_avatar", "fast", 2300, "vgg16")
    runs = [evaluation("Anna", "ggavatar", setup=FAST), evaluation("Anna", "flash_avatar", setup=longer)]
    notes = build_tables(runs)[0].notes
    assert (
        "Not alike: the methods differ in length (GGAvatar 1500 steps, FlashAvatar 2300 steps) and "
        "perceptual loss (GGAvatar random, FlashAvatar vgg16)."
    ) in notes
    alike = [evaluation("Anna", "ggavatar", setup=FAST), evaluation("Anna", "flash_avatar", setup=FLASH)]
    assert not any("Not alike" in note for note in build_tables(alike)[0].notes)


def test_a_label_does_not_hide_the_method() -> None:
    notes = build_tables([evaluation("Anna", "best ever", setup=FLASH)])[0].notes
    assert "best ever: method flash_avatar, preset fast, 1500 steps, perceptual loss random." in notes


def test_notes_of_a_methods_file_stand_below_tables_that_show_it(monkeypatch: pytest.MonkeyPatch) -> None:
    known = {"ggavatar": ("no hair",), "flash_avatar": ()}
    monkeypatch.setattr("evaluate.tables.setups.table_notes", lambda name: known[name])
    runs = [evaluation(name, "x", setup=FAST) for name in ("Anna", "Bert")]
    runs.append(evaluation("Anna", "flash_avatar", setup=FLASH))
    assert [note for note in build_tables(runs)[0].notes if "hair" in note] == ["x: no hair"]


def test_a_run_and_foreign_pictures_never_share_a_cell() -> None:
    runs = [evaluation("Anna", "a", seed=1, setup=FAST), evaluation("Anna", "a", seed=2, setup=ELSEWHERE)]
    with pytest.raises(InputError, match="another name with --label"):
        build_tables(runs)


def test_metrics_json_keeps_the_setup_and_the_console_shows_it(tmp_path: Path) -> None:
    changed = Setup("run", "ggavatar", "paper", 120_000, "none", {"rates": [1, 2]})
    made = evaluation("Anna", "ggavatar", setup=changed)
    write_results(made, tmp_path)
    stored = json.loads((tmp_path / "metrics.json").read_text())["setup"]
    assert stored == {
        "origin": "run", "method": "ggavatar", "preset": "paper", "steps": 120_000, "perceptual_loss": "none",
        "changed": {"rates": [1, 2]}, "tracking": None,
    }  # fmt: skip
    assert read_results(tmp_path).setup == changed
    line = headline(made)
    assert re.match(
        r"scored Anna · GGAvatar \(preset paper, 120000 steps, perceptual loss none, rates=\[1, 2\]\), ", line
    )
    assert line.endswith("PSNR 30.50, SSIM 0.910, LPIPS 0.090")


def test_results_of_version_0_1_are_read_and_say_so(tmp_path: Path) -> None:
    write_results(evaluation("Anna", "ggavatar", setup=FAST), tmp_path)
    content = json.loads((tmp_path / "metrics.json").read_text())
    del content["setup"], content["content_sha256"]
    (tmp_path / "metrics.json").write_text(json.dumps(content))
    assert read_results(tmp_path).setup.describe() == "setup not recorded"


@pytest.mark.parametrize(
    "broken", [{"origin": "moon"}, {"origin": "run", "steps": "many"}, {"origin": "run", "preset": 3}, {"x": 1}]
)
def test_a_damaged_setup_is_refused(broken: dict[str, object], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="setup: expected"):
        setup_from_dict(broken)
    write_results(evaluation("Anna", "ggavatar", setup=FAST), tmp_path)
    content = read_json(tmp_path / "metrics.json")
    (tmp_path / "metrics.json").write_text(json.dumps({**content, "setup": broken}))
    with pytest.raises(InputError, match="score the images again"):
        read_results(tmp_path)
