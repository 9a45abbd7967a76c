"""ggavatar-eval from the outside: exit codes, files, gates, and what it does not import."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from evaluate.cli.evaluate import Evaluated, _require_current, main
from evaluate.options import parse
from evaluate.protocols.results import read_results
from ggavatar.errors import InputError
from ggavatar.io.folder_lock import lock_output
from tests.support.image_pairs import pair, write, write_folders
from tests.support.toy_run import HEIGHT, WIDTH, write_capture

PLAIN = ["--no-report", "--quiet", "--metrics", "psnr", "ssim"]


def score(folder: Path, *extra: str, method: str = "ours") -> int:
    """Score the folders written by `write_folders` into `folder/METHOD`."""
    folders = ["--pred", str(folder / "pred"), "--gt", str(folder / "gt"), "--subject", "Anna", "--method", method]
    return main([*folders, "-o", str(folder / method), *PLAIN, *extra])


def test_folders_give_a_table_and_all_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_folders(tmp_path, [1, 2, 3])
    assert score(tmp_path, "--table", "--json") == 0
    captured = capsys.readouterr()
    lines = captured.out.splitlines()
    assert any("PSNR ↑" in line for line in lines)
    summary = json.loads(lines[-1])
    assert summary["evaluations"][0]["protocol"].startswith("folders-v1+metrics=psnr-ssim")
    assert {Path(path).name for path in summary["files"]} == {
        "metrics.json", "per_frame.csv", "table.md", "table.tex", "table.csv", "table.json", "table.html",
    }  # fmt: skip
    assert all(Path(path).is_file() for path in summary["files"])
    shown = f"{summary['evaluations'][0]['metrics']['psnr']:.2f}"
    assert any(shown in line for line in lines)


def test_the_paths_written_are_the_last_lines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_folders(tmp_path, [1])
    folders = ["--pred", str(tmp_path / "pred"), "--gt", str(tmp_path / "gt")]
    assert main([*folders, "--no-report", "--metrics", "psnr", "--table"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"wrote {tmp_path / 'pred-evaluation' / 'table.json'}"


def test_pictures_against_a_folder_and_against_a_capture_do_not_overwrite_each_other(tmp_path: Path) -> None:
    capture = write_capture(tmp_path / "capture")
    _, truth = write_folders(tmp_path, [10, 15], HEIGHT, WIDTH)
    common = ["--pred", str(tmp_path / "pred"), "--no-report", "--quiet", "--no-lpips", "--metrics", "psnr"]
    tables = {}
    for flags in (["--gt", str(truth)], ["--capture", str(capture.folder), "--regions", "foreground"]):
        assert main([*common, *flags]) == 0
        tables[flags[0]] = {path for path in (tmp_path / "pred-evaluation").rglob("table.*")}
        tables[flags[0], "text"] = (tmp_path / "pred-evaluation" / "table.json").read_text()
    assert len(tables["--gt"]) == 5 and len(tables["--capture"]) == 10
    assert tables["--gt", "text"] == tables["--capture", "text"]
    (beside,) = {path.parent for path in tables["--capture"] - tables["--gt"]}
    assert (beside / "metrics.json").is_file()


def test_missing_frames_and_sizes_end_with_code_2_and_one_message(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    predictions, _ = write_folders(tmp_path, [1, 2])
    (predictions / "frame_0002.png").unlink()
    assert score(tmp_path) == 2
    assert "no prediction for 1 frames: 2" in capsys.readouterr().err
    write(predictions / "frame_0002.png", pair(40, 64)[1])
    assert score(tmp_path) == 2
    error = capsys.readouterr().err
    assert "frame 2" in error
    assert error.count("\n") == 1
    assert not (tmp_path / "ours").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "expected a run folder"),
        (["--pred", "a"], "no --gt"),
        (["run", "--pred", "a", "--gt", "b"], "found both"),
        (["absent"], "absent"),
        (["--pred", "a", "--gt", "b", "--protocol", "papr"], "paper"),
        (["--pred", "a", "--gt", "b", "--fail-below", "pnsr=3"], "did you mean psnr?"),
        (["--pred", "a", "--gt", "b", "--tolerance", "psnr=3"], "--compare FILE"),
        (["--pred", "a", "--gt", "b", "--github"], "to report, found none"),
        (["--pred", "a", "--gt", "b", "--compare", "gone.json"], "gone.json: no such file"),
        (["--pred", "a", "--gt", "b", "--metrics", "psnrr"], "did you mean psnr?"),
        (["--pred", "absent", "--gt", "absent"], "expected a folder"),
        (["run", "--device", "gpu"], "run: no such file or folder; expected a run folder"),
    ],
)
def test_bad_input_ends_with_code_2(
    arguments: list[str],
    message: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    assert message in capsys.readouterr().err


def test_an_absent_cuda_device_is_one_line_and_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    (tmp_path / "run").mkdir()
    assert main([str(tmp_path / "run"), "--device", "cuda", "--no-lpips"]) == 2
    error = capsys.readouterr().err
    assert "--device cuda: torch finds no CUDA device" in error and error.count("\n") == 1


def test_an_unknown_flag_ends_with_code_2_and_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--protocl", "paper"]) == 2
    assert "(did you mean --protocol?)" in capsys.readouterr().err


def test_gates_end_with_code_3_and_say_what_failed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    predictions, _ = write_folders(tmp_path, [1, 2])
    assert score(tmp_path, "--fail-below", "psnr=5", "ssim=0.1") == 0
    junit = tmp_path / "checks" / "junit.xml"
    assert score(tmp_path, "--fail-below", "psnr=90", "--junit", str(junit), "--github") == 3
    captured = capsys.readouterr()
    assert "the floor 90 is missed by" in captured.err
    assert "::error title=Anna/ours/psnr::" in captured.out
    assert 'failures="1"' in junit.read_text()
    baseline = (tmp_path / "ours" / "metrics.json").rename(tmp_path / "baseline.json")
    assert score(tmp_path, "--compare", str(baseline)) == 0
    write(predictions / "frame_0002.png", pair(shift=9)[0])
    assert score(tmp_path, "--compare", str(baseline), "--tolerance", "psnr=0.1") == 3
    assert "worse by" in capsys.readouterr().err
    assert score(tmp_path, "--compare", str(baseline), "--tolerance", "psnr=90", "psnr_pooled=90", "ssim=2") == 0
    kept = tmp_path / "kept.json"
    assert score(tmp_path, "--fail-below", "psnr=90", "--write-baseline", str(kept)) == 3 and not kept.exists()
    assert score(tmp_path, "--write-baseline", str(kept)) == 0
    capsys.readouterr()
    assert score(tmp_path, "--compare", str(kept), "--github") == 0
    printed = [line for line in capsys.readouterr().out.splitlines() if line.startswith("::")]
    assert len(printed) == 1 and "checks passed" in printed[0]
    write(tmp_path / "gt" / "000001.png", pair(shift=30)[0])
    assert score(tmp_path, "--compare", str(kept)) == 2
    assert "--allow-other ground-truth" in capsys.readouterr().err
    assert score(tmp_path, "--compare", str(kept), "--allow-other", "ground-truth") == 3


@pytest.mark.parametrize("color", [0, 128, 255])
def test_flat_predictions_are_named_also_when_stored_scores_are_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], color: int
) -> None:
    predictions, _ = write_folders(tmp_path, [1, 2, 3])
    assert score(tmp_path) == 0
    assert "flat" not in capsys.readouterr().err
    for frame in (1, 3):
        write(predictions / f"frame_{frame:04d}.png", np.full((48, 64, 3), color, np.uint8))
    assert score(tmp_path) == 0
    line = "warning: Anna/ours: the prediction is one flat color in 2 frames (1, 3)\n"
    assert capsys.readouterr().err == line
    assert main([str(tmp_path / "ours"), "-o", str(tmp_path / "table"), "--no-report", "--quiet"]) == 0
    assert capsys.readouterr().err == line


def test_results_of_several_methods_make_one_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    predictions, _ = write_folders(tmp_path, [1, 2])
    assert score(tmp_path, method="one") == 0
    write(predictions / "frame_0002.png", pair(shift=2)[0])
    write(predictions / "frame_0001.png", pair(shift=2)[0])
    assert score(tmp_path, method="two") == 0
    results = [str(tmp_path / "one"), str(tmp_path / "two" / "metrics.json")]
    assert main([*results, "-o", str(tmp_path / "all"), "--table", "--no-report", "--with-paper"]) == 0
    text = capsys.readouterr().out
    assert "paper (protocol not stated)" in text
    assert "33.61" in text
    assert "one − two" in text
    assert len((tmp_path / "all" / "table.csv").read_text().splitlines()) > 100
    copies = json.loads((tmp_path / "all" / "table.json").read_text())["results"]
    assert copies == ["results/00-Anna-one.json", "results/01-Anna-two.json"]
    assert main([*results, "-o", str(tmp_path / "again"), "--no-report", "--quiet", "--labels", "x", "y"]) == 0
    assert "x − y" in (tmp_path / "again" / "table.md").read_text()
    assert json.loads((tmp_path / "again" / "results" / "01-Anna-y.json").read_text())["method"] == "y"
    assert main([*results, "--labels", "x"]) == 2


def test_without_runs_the_papers_tables_stand_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--with-paper", "--table", "-o", str(tmp_path / "out")]) == 0
    text = capsys.readouterr().out
    for number in ("33.61*", "24.99*", "24.76'", "33.41'"):
        assert number in text
    cells = (tmp_path / "out" / "table.csv").read_text().splitlines()[1:]
    assert [sum(line.startswith(name) for line in cells) for name in ("paper-1,", "paper-2,")] == [60, 15]
    assert main(["--with-paper", "--fail-below", "psnr=3"]) == 2


def test_masks_and_region_masks_become_columns(tmp_path: Path) -> None:
    write_folders(tmp_path, [1])
    write(tmp_path / "masks" / "1.png", np.pad(np.full((20, 20), 255, np.uint8), ((10, 18), (10, 34))))
    write(tmp_path / "parts" / "face" / "1.png", np.full((48, 64), 255, np.uint8))
    assert score(tmp_path, "--masks", str(tmp_path / "masks"), "--region-masks", str(tmp_path / "parts")) == 0
    summary = json.loads((tmp_path / "ours" / "metrics.json").read_text())["summary"]
    for region in ("foreground", "boundary", "face"):
        assert summary[f"psnr@{region}"]["count"] == 1
    assert summary["psnr@face"]["mean"] == pytest.approx(summary["psnr"]["mean"], rel=1e-6)


def test_strange_paths_work(tmp_path: Path) -> None:
    folder = tmp_path / "mit Leerzeichen ☃"
    write_folders(folder, [1])
    assert score(folder) == 0
    assert (folder / "ours" / "table.html").is_file()


def test_a_path_with_a_leading_dash(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_folders(tmp_path / "-dash", [1])
    monkeypatch.chdir(tmp_path)
    assert main(["--pred=-dash/pred", "--gt=-dash/gt", "--output=-dash/out", *PLAIN]) == 0
    assert (tmp_path / "-dash" / "out" / "metrics.json").is_file()


SCRIPT = """
import sys
from evaluate.cli.evaluate import main
from evaluate.options import parse
try:
    code = main(sys.argv[1:])
except SystemExit as caught:
    code = caught.code
sys.stderr.write(repr(sorted({"torch", "numba", "matplotlib", "pandas", "scipy"} & set(sys.modules))))
sys.exit(code)
"""


def imported(arguments: list[str]) -> tuple[int, str]:
    """Exit code and the heavy modules that a fresh interpreter imports."""
    done = subprocess.run([sys.executable, "-c", SCRIPT, *arguments], capture_output=True, text=True, check=False)
    return done.returncode, done.stderr.splitlines()[-1]


def test_help_and_scoring_without_learned_metrics_import_no_torch(tmp_path: Path) -> None:
    assert imported(["--help"]) == (0, "[]")
    write_folders(tmp_path, [1, 2])
    folders = ["--pred", str(tmp_path / "pred"), "--gt", str(tmp_path / "gt"), "-o", str(tmp_path / "out")]
    assert imported([*folders, *PLAIN, "--table", "--with-paper"]) == (0, "[]")
    nothing = ["--models", str(tmp_path), "--no-report", "--quiet"]
    code, modules = imported([*folders, *nothing, "--no-lpips"])
    assert (code, modules) == (0, "[]")


def test_the_commands_of_the_ci_document_are_understood() -> None:
    text = (Path(__file__).parents[3] / "docs" / "ci.md").read_text(encoding="utf-8")
    commands = [line.split("ggavatar-eval ")[1].split() for line in text.splitlines() if "ggavatar-eval run" in line]
    gate, write = (parse(words) for words in commands)
    assert gate.gates.github and gate.gates.compare == (write.gates.write_baseline,)


@pytest.mark.weights
def test_lpips_is_a_number_with_its_weights_and_a_dash_with_a_reason_without(
    pretrained: Callable[[str], Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pretrained("alexnet"), pretrained("lpips_alex")
    write_folders(tmp_path, [1])
    words = ["--pred", str(tmp_path / "pred"), "--gt", str(tmp_path / "gt"), "-o", str(tmp_path / "out"), "--no-report"]

    def measured() -> tuple[float | None, str]:
        assert main([*words, "--metrics", "psnr", "lpips_alex", "--json", "--quiet", "--offline"]) == 0
        (found,) = json.loads(capsys.readouterr().out.splitlines()[-1])["evaluations"]
        return found["metrics"].get("lpips_alex"), found["missing"].get("lpips_alex", "")

    value, reason = measured()
    assert value is not None and value > 0 and reason == ""
    monkeypatch.setenv("GGAVATAR_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("GGAVATAR_MODELS", raising=False)
    value, reason = measured()
    assert value is None and "(offline)" in reason and "ggavatar-models --fetch alexnet" in reason
    assert main([*words, "--models", "nowhere"]) == 2
    assert "--models nowhere: no such folder" in capsys.readouterr().err


@pytest.mark.parametrize("place", ["table", "baseline.json"])
def test_tables_and_baselines_have_one_writer(tmp_path: Path, capsys: pytest.CaptureFixture[str], place: str) -> None:
    write_folders(tmp_path, [1])
    words = ["--write-baseline", str(tmp_path / "ours" / "baseline.json")]
    (tmp_path / "ours").mkdir()
    with lock_output(tmp_path / "ours" / place):
        assert score(tmp_path, *words) == 2
    assert f"{tmp_path / 'ours' / place}: " in capsys.readouterr().err
    assert score(tmp_path, *words) == 0
    assert not [path.name for path in (tmp_path / "ours").iterdir() if path.name.startswith(".")]


def test_figures_are_not_drawn_from_what_another_command_has_scored_meanwhile(tmp_path: Path) -> None:
    write_folders(tmp_path, [1])
    assert score(tmp_path) == 0
    results = tmp_path / "ours" / "metrics.json"
    ours = Evaluated(read_results(results), results)
    _require_current(ours)
    changed = dataclasses.replace(ours.evaluation, hashes={**ours.evaluation.hashes, "predictions": "00"})
    with pytest.raises(InputError, match="scored it again meanwhile"):
        _require_current(Evaluated(changed, results))
