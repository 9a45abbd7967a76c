"""The method that docs/adding-a-method.md ends with is cut out of the page, trained, reopened and measured."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from evaluate.options import Options
from evaluate.scoring.run import evaluate_run
from ggavatar.data.capture import Capture
from ggavatar.training import registry
from ggavatar.training.session import train_run
from tests.support.silent_reporter import SilentReporter

PAGE = Path(__file__).parents[3] / "docs" / "adding-a-method.md"


@pytest.fixture
def method_of_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Its name; it is one file of its own, as a user would save it."""
    import ggavatar.methods

    (name,) = re.findall(r"Saved as `ggavatar/methods/(\w+)\.py`", PAGE.read_text())
    source = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)[-1]
    (tmp_path / f"{name}.py").write_text(source)
    monkeypatch.setattr(registry, "METHODS_FOLDER", tmp_path)
    monkeypatch.setattr(ggavatar.methods, "__path__", [str(tmp_path)])
    yield name
    sys.modules.pop(f"ggavatar.methods.{name}", None)


def test_it_trains_and_is_measured(method_of_the_page: str, toy_capture: Capture, tmp_path: Path) -> None:
    options = {"method": method_of_the_page, "steps": 60, "eval_every": 0, "device": "cpu"}
    scores = {}
    for name, further in {
        "one step": {"steps": 1},
        "sixty": {},
        "variant": {"method": f"{method_of_the_page}_without_dssim"},
    }.items():
        train_run(toy_capture.folder, tmp_path / name, {**options, **further}, quiet=True)
        found, _ = evaluate_run(tmp_path / name, Options(no_learned=True, quiet=True, device="cpu"), SilentReporter())
        scores[name] = sum(found.values["psnr"]) / len(found.frames)
    assert scores["sixty"] > scores["one step"] + 1.5
    assert scores["variant"] != scores["sixty"]
