"""Captures by functions: wrong options are named. That a person is made, prepared and examined, the notebooks show."""

from __future__ import annotations

from pathlib import Path

import pytest

import ggavatar
from preprocess.api import captures
from preprocess.doctor.diagnosis import Diagnosis, Finding
from preprocess.pipeline import pipeline


def test_wrong_options_are_named_before_anything_is_read(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match=r"unexpected keyword argument 'sise' \(did you mean size\?\)"):
        ggavatar.prepare_capture("none.mp4", tmp_path / "out", sise=3)
    with pytest.raises(TypeError, match=r"make_demo\(\) got an unexpected keyword argument 'frame'"):
        ggavatar.make_demo(tmp_path / "demo", frame=3)
    with pytest.raises(ggavatar.InputError, match="an even --size from 32 to 4096 px, found 31"):
        ggavatar.make_demo(tmp_path / "demo", size=31)
    with pytest.raises(ggavatar.InputError, match=r"none\.mp4"):
        ggavatar.prepare_capture(tmp_path / "none.mp4", tmp_path / "out")
    with pytest.raises(ggavatar.InputError, match="capture"):
        ggavatar.check_capture(tmp_path)
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("progress", [False, True])
def test_what_a_stage_warns_of_is_a_warning_of_python(progress: bool, capsys: pytest.CaptureFixture[str]) -> None:
    stage = pipeline.STAGES[0]
    with (
        pytest.warns(UserWarning, match="most frames are dark"),
        captures._reporting(progress)(stage, False) as reporter,
    ):
        reporter.advance(1, 2)
        reporter.note("an assumption")
        reporter.warn("most frames are dark")
    assert (stage.title in capsys.readouterr().err) == progress


def test_a_diagnosis_is_read_at_a_glance() -> None:
    found = Diagnosis((Finding("short", "warning", "only 3 frames"), Finding("x", "fault", "y", "--fix x")), {})
    assert repr(found) == "Diagnosis(not healthy)\n  warning: only 3 frames\n  fault: y [--fix x]"
