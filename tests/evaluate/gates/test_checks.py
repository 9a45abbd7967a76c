"""Gates: floors and ceilings.

Also covers `evaluate/gates/limits.py`.
"""

from __future__ import annotations

import math

import pytest

from evaluate.gates.checks import check_limits, full_metric_name, parse_limits
from evaluate.gates.limits import read_limits
from evaluate.options import Gates
from evaluate.protocols.protocol import protocol_by_name
from ggavatar.errors import InputError
from tests.support.evaluations import evaluation


def test_floors_and_ceilings_say_by_how_much() -> None:
    checks = check_limits([evaluation("Anna", "m")], {"psnr": 30.0, "ssim": 0.95}, {"lpips": 0.05})
    assert [(check.case, check.passed) for check in checks] == [
        ("Anna/m/psnr", True),
        ("Anna/m/ssim", False),
        ("Anna/m/lpips_alex", False),
    ]
    assert checks[0].message == "psnr is 30.5, the floor 30 holds by 0.5"
    assert checks[1].message == "ssim is 0.91, the floor 0.95 is missed by 0.04"
    assert checks[2].message == "lpips_alex is 0.09, the ceiling 0.05 is missed by 0.04"


def test_a_metric_that_was_not_measured_fails_with_the_reason() -> None:
    (check,) = check_limits([evaluation("Anna", "m", lpips=())], {}, {"lpips_alex": 0.5})
    assert not check.passed
    assert "alexnet_features.pth" in check.message


def test_identical_images_pass_any_floor() -> None:
    (check,) = check_limits([evaluation("Anna", "m", (math.inf, math.inf))], {"psnr": 100.0}, {})
    assert check.passed


def test_limits_are_parsed_and_unknown_metrics_get_the_nearest() -> None:
    assert parse_limits(["psnr=30", "ssim=.9", "psnr@face=25"], "--fail-below") == {
        "psnr": 30,
        "ssim": 0.9,
        "psnr@face": 25,
    }
    assert parse_limits(["lpips=1e-1"], "--fail-above") == {"lpips": 0.1}
    with pytest.raises(InputError, match="did you mean psnr"):
        parse_limits(["pnsr=30"], "--fail-below")
    for text in ("psnr", "psnr=high", "psnr=", "psnr=nan", "psnr=inf"):
        with pytest.raises(InputError, match="METRIC=NUMBER"):
            parse_limits([text], "--fail-below")


@pytest.mark.parametrize("name", ["lpips", "lpips_vgg", "l1@face", "flicker", "expression_distance"])
def test_a_floor_of_a_metric_of_which_lower_is_better_is_refused(name: str) -> None:
    message = f"--fail-below: {name} is lower-is-better, found {name}=1; use --fail-above {name}=1"
    with pytest.raises(InputError, match=f"^{message}$"):
        parse_limits([f"{name}=1"], "--fail-below")
    assert parse_limits([f"{name}=1"], "--fail-above") == {name: 1}


@pytest.mark.parametrize("name", ["psnr", "ssim", "ssim_3dgs", "psnr@face", "identity"])
def test_a_ceiling_of_a_metric_of_which_higher_is_better_is_refused(name: str) -> None:
    with pytest.raises(InputError, match=f"{name} is higher-is-better, .*; use --fail-below {name}=1"):
        parse_limits([f"{name}=1"], "--fail-above")
    assert parse_limits([f"{name}=1"], "--fail-below") == {name: 1}


def test_short_names_stand_for_the_variant_in_the_main_table() -> None:
    paper = evaluation("Anna", "m", protocol=protocol_by_name("paper"))
    assert full_metric_name("ssim", paper) == "ssim"
    assert full_metric_name("lpips", paper) == "lpips_alex"
    lineage = evaluation("Anna", "m", protocol=protocol_by_name("gaussian-avatars"))
    assert full_metric_name("ssim", lineage) == "ssim_3dgs"
    with pytest.raises(InputError, match="does not measure"):
        full_metric_name("flicker", lineage)


@pytest.mark.parametrize(
    ("gates", "message"),
    [
        (Gates(tolerance=("psnr=1",)), "--tolerance: expected --compare"),
        (Gates(allow_other=("preset",)), "--allow-other: expected --compare"),
        (Gates(github=True), "to report, found none"),
        (Gates(fail_below=("pnsr=1",)), "did you mean psnr"),
    ],
)
def test_gates_that_make_no_sense_are_refused(gates: Gates, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_limits(gates)
