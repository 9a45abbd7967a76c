"""Baselines come from runs, folders and files, and are written into small files."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from evaluate.gates.baselines import baseline_of, read_baselines, write_baseline
from evaluate.protocols.results import write_results
from evaluate.protocols.setup import Setup
from ggavatar.errors import InputError
from ggavatar.io.images import write_png
from tests.support.evaluations import PROTOCOL, evaluation

FAST = Setup("run", "ggavatar", "fast", 1500, "random", {"latent": 3})


def test_a_run_a_folder_and_a_file_give_the_same(tmp_path: Path) -> None:
    made = evaluation("Anna", "m", seed=3, setup=FAST)
    home = tmp_path / "run" / "eval" / "folders-v1"
    write_results(made, home)
    write_results(made, tmp_path / "tables" / "other")
    (tmp_path / "tables" / "other" / "metrics.json").rename(tmp_path / "tables" / "x.json")
    (tmp_path / "tables" / "other").rename(tmp_path / "tables" / "results")
    (tmp_path / "tables" / "x.json").rename(tmp_path / "tables" / "results" / "00-Anna-m.json")
    write_baseline(tmp_path / "baseline.json", [made])
    places = (tmp_path / "run", home, home / "metrics.json", tmp_path / "tables", tmp_path / "baseline.json")
    for place in places:
        assert read_baselines(place) == [baseline_of(made)], place
    assert (tmp_path / "baseline.json").stat().st_size < 2000


def test_a_run_with_several_protocols_gives_all(tmp_path: Path) -> None:
    for name, protocol in (("a", PROTOCOL), ("b", PROTOCOL.override(background="black"))):
        write_results(evaluation("Anna", "m", protocol=protocol), tmp_path / "eval" / name)
    assert len({one.digest for one in read_baselines(tmp_path)}) == 2


def test_a_folder_with_results_of_gt_and_of_a_capture_gives_both(tmp_path: Path) -> None:
    """PRED-evaluation/ holds the scores of --gt itself, and those under a capture's protocol in eval/."""
    write_results(evaluation("Anna", "m"), tmp_path)
    write_results(evaluation("Anna", "m", protocol=PROTOCOL.override(background="black")), tmp_path / "eval" / "b")
    assert len({one.digest for one in read_baselines(tmp_path)}) == 2


def test_identical_images_are_kept_apart_from_missing_values(tmp_path: Path) -> None:
    made = evaluation("Anna", "m", (math.inf, math.inf), lpips=())
    write_baseline(tmp_path / "b.json", [made])
    (found,) = read_baselines(tmp_path / "b.json")
    assert found.means["psnr"] is None and "lpips_alex" not in found.means


def test_what_is_no_result_is_refused_with_a_way_out(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    with pytest.raises(InputError, match=r"score it first: ggavatar-eval .*run"):
        read_baselines(tmp_path / "run")
    with pytest.raises(InputError, match="no such file"):
        read_baselines(tmp_path / "gone.json")
    (tmp_path / "other.json").write_text('{"schema": "something"}')
    with pytest.raises(InputError, match="--write-baseline"):
        read_baselines(tmp_path / "other.json")
    write_baseline(tmp_path / "b.json", [evaluation("Anna", "m")])
    content = json.loads((tmp_path / "b.json").read_text())
    for field, value in (("means", 3), ("seed", "x"), ("setup", {"origin": "moon"}), ("means", {"psnr": "high"})):
        broken = {**content, "evaluations": [{**content["evaluations"][0], field: value}]}
        (tmp_path / "broken.json").write_text(json.dumps(broken))
        with pytest.raises(InputError, match="write it again"):
            read_baselines(tmp_path / "broken.json")


def test_scores_whose_images_changed_are_no_baseline(tmp_path: Path) -> None:
    home = tmp_path / "eval" / "x"
    write_results(evaluation("Anna", "m"), home)
    for name in ("predictions", "ground_truth"):
        for frame in (0, 1):
            write_png(home / name / f"{frame:06d}.png", np.zeros((2, 2, 3), np.uint8))
    with pytest.raises(InputError, match=r"found others \(SHA-256\) in ground_truth, predictions"):
        read_baselines(tmp_path)
