"""Metrics of other packages are measured, shown and guarded; a broken one costs nothing but itself.

The reference is a closed form: images of constant levels whose difference is known.
"""

from __future__ import annotations

import re
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from evaluate.gates.checks import parse_limits
from evaluate.gates.tolerances import parse_tolerances, tolerance_of
from evaluate.metrics import catalogue, plugged
from evaluate.options import Override
from evaluate.protocols.protocol import protocol_by_name
from evaluate.protocols.results import Evaluation, read_results, write_results
from evaluate.scoring.accumulator import Labels
from evaluate.scoring.frame_pairs import pair_folders
from evaluate.scoring.score import score
from evaluate.tables.write import build_tables
from ggavatar.errors import InputError
from ggavatar.io.images import write_png
from ggavatar.plugins.entry_points import METRICS
from tests.support.plugin_packages import install

LEVELS = """
import numpy as np
from evaluate.metrics.metric import Metric

METRIC = Metric("levels", "Levels", False, 1, "1", "mean difference in levels", 0.05, True)


def measure(prediction, truth, foreground):
    inside = np.ones(truth.shape[:2]) if foreground is None else foreground
    difference = np.abs(prediction.astype(float) - truth).mean(axis=2)
    return (difference * inside).sum() / inside.sum()
"""


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], None]]:
    """Installs the source of a metric `levels`."""
    monkeypatch.syspath_prepend(str(tmp_path / "site"))

    def put(source: str, name: str = "levels") -> None:
        install(tmp_path / "site", "mine", {"of_a_test_levels": source}, {METRICS: {name: "of_a_test_levels"}}, "2.0")

    yield put
    sys.modules.pop("of_a_test_levels", None)
    plugged._loaded.cache_clear()


def scored(tmp_path: Path, *names: str, frames: int = 2) -> Evaluation:
    """Gray levels 100 + frame against 90, with a mask of the left half, which differs by 20 more."""
    for frame in range(frames):
        prediction = np.full((12, 12, 3), 100 + frame, np.uint8)
        prediction[:, :6] += 20
        for folder, image in (("pred", prediction), ("gt", np.full((12, 12, 3), 90, np.uint8))):
            write_png(tmp_path / folder / f"{frame:06d}.png", image)
        mask = np.zeros((12, 12), np.uint8)
        mask[:, :6] = 255
        write_png(tmp_path / "masks" / f"{frame:06d}.png", mask)
    protocol = Override(metrics=names).apply_to(protocol_by_name("folders"))
    pairs = pair_folders(tmp_path / "pred", tmp_path / "gt", tmp_path / "masks", None)
    return score(pairs, protocol, Labels("s", "m"))


def test_it_is_a_column_of_the_table_and_of_the_files(site: Callable[[str], None], tmp_path: Path) -> None:
    site(LEVELS)
    assert catalogue.metric_names()[-1] == "levels" and "of_a_test_levels" not in sys.modules
    found = scored(tmp_path, "psnr", "levels")
    assert found.values["levels"] == (30.0, 31.0)
    assert found.protocol.table_metrics == ("psnr", "levels")
    assert found.protocol.definitions()["metric_definitions"]["levels"] == "mean difference in levels"
    assert found.provenance["versions"]["mine"] == "2.0" and len(found.weights["levels"]) == 64
    table = build_tables([found])[0]
    column = next(place for place, column in enumerate(table.columns) if column.title.startswith("Levels"))
    assert table.columns[column].title == "Levels ↓" and table.rows[0].cells[column].text == "30.5"
    write_results(found, tmp_path / "out")
    assert read_results(tmp_path / "out").values["levels"] == (30.0, 31.0)


def test_gates_know_it(site: Callable[[str], None]) -> None:
    site(LEVELS)
    assert parse_limits(["levels=3"], "--fail-above") == {"levels": 3.0}
    with pytest.raises(InputError, match="levels is lower-is-better"):
        parse_limits(["levels=3"], "--fail-below")
    assert tolerance_of("levels", parse_tolerances([])).amount == 0.05


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("    return 1 / (int(prediction[0, 0, 0]) - 121)", r"metric 'levels' of the package mine 2.0: failed when it "
         r"measured frames: ZeroDivisionError: .*\(of_a_test_levels.py:9\); update mine"),
        ("    return 'high'", "ValueError: could not convert string"),
        ("    prediction[:] = 0\n    return 0.0", "ValueError: assignment destination is read-only"),
        ("    return float('nan')", "^it gave no number for any frame$"),
        ("    return None", "^it gave no number for any frame$"),
    ],
)  # fmt: skip
def test_one_that_fails_has_no_value_and_a_reason(
    body: str, reason: str, site: Callable[[str], None], tmp_path: Path
) -> None:
    site(LEVELS.split("def measure")[0] + "def measure(prediction, truth, foreground):\n" + body + "\n")
    found = scored(tmp_path, "psnr", "levels")
    assert "levels" not in found.values and len(found.values["psnr"]) == 2
    assert re.search(reason, found.missing["levels"])
    assert plugged.is_failure(found.missing["levels"]) == ("failed" in reason or "ValueError" in reason)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("import no_such_module_of_a_test", "failed when it was imported: ModuleNotFoundError"),
        ("METRIC = 3\ndef measure(*_): return 1", "expected METRIC to be a Metric, found int"),
        (LEVELS.replace('"levels"', '"others"'), "expected METRIC of this name, found 'others'"),
        (LEVELS.replace("0.05", "-1.0"), "a tolerance of 0 or more"),
        (LEVELS.replace("def measure", "def measures"), "found no measure"),
    ],
)
def test_one_that_cannot_be_used_is_refused_before_anything_is_scored(
    source: str, message: str, site: Callable[[str], None]
) -> None:
    site(source)
    with pytest.raises(InputError, match=message):
        Override(metrics=("psnr", "levels")).apply_to(protocol_by_name("paper"))
    assert Override(metrics=("psnr",)).apply_to(protocol_by_name("paper")).metrics == ("psnr",)


@pytest.mark.parametrize("name", ["psnr", "mse", "lpips"])
def test_names_of_ours_are_ours(name: str, site: Callable[..., None]) -> None:
    site(LEVELS.replace('"levels"', f'"{name}"'), name)
    assert name not in catalogue.metric_names()[len(catalogue.METRICS) :]


def test_a_definition_that_has_changed_is_noticed(site: Callable[[str], None], tmp_path: Path) -> None:
    """What was scored under other words is not read as if it had been scored under these."""
    site(LEVELS)
    write_results(scored(tmp_path, "levels"), tmp_path / "out")
    source = (tmp_path / "site" / "of_a_test_levels.py").read_text()
    (tmp_path / "site" / "of_a_test_levels.py").write_text(source.replace("mean difference", "median difference"))
    sys.modules.pop("of_a_test_levels")
    shutil.rmtree(tmp_path / "site" / "__pycache__", ignore_errors=True)
    plugged._loaded.cache_clear()
    with pytest.raises(InputError, match=r"metrics.json: the metric levels was 'mean .* and is 'median "):
        read_results(tmp_path / "out")


def test_a_result_without_its_package_says_so(site: Callable[[str], None], tmp_path: Path) -> None:
    site(LEVELS)
    write_results(scored(tmp_path, "levels"), tmp_path / "out")
    (tmp_path / "site" / "mine-2.0.dist-info" / "entry_points.txt").write_text("")
    plugged._loaded.cache_clear()
    with pytest.raises(InputError, match=r"unknown metric 'levels'.*Install the package"):
        read_results(tmp_path / "out")
