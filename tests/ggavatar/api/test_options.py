"""Options of the public functions: names, types and choices. References: the commands' flags, Python's own rules."""

from __future__ import annotations

import dataclasses
import typing
from typing import Any, Literal

import numpy as np
import pytest

from evaluate.api.scores import ScoreOptions
from evaluate.options import Override
from ggavatar.api.exporting import ExportOptions
from ggavatar.api.options import check_options
from ggavatar.api.performances import DriveOptions
from ggavatar.api.runs import TrainOptions
from ggavatar.errors import InputError
from ggavatar.formats.driving_options import DrivingOptions
from ggavatar.training.plan import PRESET_NAMES


@pytest.mark.parametrize(
    ("options", "given", "message"),
    [
        (TrainOptions, {"preset": "fas"}, r"f\(preset=…\): expected one of default, fast, paper, found 'fas'.*fast\?"),
        (DriveOptions, {"pose": "x"}, "expected one of relative, absolute, still, found 'x'"),
        (DriveOptions, {"transfer": "x"}, "expected one of matched, relative, absolute"),
        (DriveOptions, {"smooth": None}, "expected one of none, one-euro, savgol, found None"),
        (ScoreOptions, {"mask": "binry"}, "expected one of as-stored, binary, found 'binry'.*binary"),
    ],
)
def test_other_choices_are_refused(options: type, given: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        check_options("f", given, options)


@pytest.mark.parametrize(
    ("options", "given", "message"),
    [
        (TrainOptions, {"steps": "a"}, r"^f\(steps=…\): expected int, found str$"),
        (TrainOptions, {"steps": True}, "expected int, found bool"),
        (TrainOptions, {"split": 3}, "expected str, found int"),
        (TrainOptions, {"settings": "a=1"}, "expected Mapping, found str"),
        (DriveOptions, {"limit": "1"}, "expected float, found str"),
        (ScoreOptions, {"metrics": "psnr"}, "expected Sequence, found str"),
        (ExportOptions, {"frames": 3}, "expected tuple, found int"),
        (TrainOptions, {"stepz": 3}, r"f\(\) got an unexpected keyword argument 'stepz' \(did you mean steps\?\)"),
    ],
)
def test_other_names_and_types_are_type_errors(options: type, given: dict[str, Any], message: str) -> None:
    with pytest.raises(TypeError, match=message):
        check_options("f", given, options)


def test_what_fits_passes() -> None:
    check_options("f", {"steps": np.int64(3), "preset": "paper", "settings": {"a": 1}, "resume": True}, TrainOptions)
    check_options("f", {"limit": 2, "fps": np.float32(30), "pose": "still"}, DriveOptions)
    check_options("f", {"metrics": ["psnr"], "regions": ("face",), "learned": False}, ScoreOptions)


def test_choices_are_those_of_the_commands() -> None:
    assert typing.get_args(typing.get_type_hints(TrainOptions)["preset"]) == PRESET_NAMES
    driving, scoring = typing.get_type_hints(DrivingOptions), typing.get_type_hints(Override)
    for name in ("transfer", "pose", "smooth"):
        assert typing.get_type_hints(DriveOptions)[name] == driving[name]
    assert typing.get_type_hints(ScoreOptions)["mask"] in typing.get_args(scoring["mask"])
    assert {field.name for field in dataclasses.fields(DrivingOptions)} | {"fps"} == set(DriveOptions.__annotations__)
    assert Literal["as-stored", "binary"] == typing.get_type_hints(ScoreOptions)["mask"]
