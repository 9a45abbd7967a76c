"""Gates: floors, ceilings and baselines, and their reports.

Also covers `evaluate/gates/limits.py`.
"""

from __future__ import annotations

import dataclasses
import math
from xml.etree import ElementTree

import pytest

from evaluate.gates.checks import (
    Check,
    check_limits,
    compare_with_baselines,
    full_metric_name,
    parse_limits,
    to_github,
    to_junit,
)
from evaluate.protocols.protocol import protocol_by_name
from ggavatar.errors import InputError
from tests.support.evaluations import PROTOCOL, evaluation


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
    assert parse_limits(["psnr=30", "ssim=.9", "psnr@face=25", "lpips=1e-1"], "--fail-below") == {
        "psnr": 30,
        "ssim": 0.9,
        "psnr@face": 25,
        "lpips": 0.1,
    }
    with pytest.raises(InputError, match="did you mean psnr"):
        parse_limits(["pnsr=30"], "--fail-below")
    for text in ("psnr", "psnr=high", "psnr=", "psnr=nan", "psnr=inf"):
        with pytest.raises(InputError, match="METRIC=NUMBER"):
            parse_limits([text], "--fail-below")


def test_short_names_stand_for_the_variant_in_the_main_table() -> None:
    paper = evaluation("Anna", "m", protocol=protocol_by_name("paper"))
    assert full_metric_name("ssim", paper) == "ssim"
    assert full_metric_name("lpips", paper) == "lpips_alex"
    lineage = evaluation("Anna", "m", protocol=protocol_by_name("gaussian-avatars"))
    assert full_metric_name("ssim", lineage) == "ssim_3dgs"
    with pytest.raises(InputError, match="does not measure"):
        full_metric_name("flicker", lineage)


def test_a_fall_beyond_the_tolerance_fails_and_a_gain_never_does() -> None:
    old = evaluation("Anna", "m", (30.0, 31.0), (0.9, 0.92), (0.1, 0.08))
    new = evaluation("Anna", "m", (29.8, 30.8), (0.95, 0.97), (0.05, 0.05))
    by_case = {check.case: check for check in compare_with_baselines([new], [old], {"psnr": 0.1})}
    assert not by_case["Anna/m/psnr"].passed
    assert by_case["Anna/m/psnr"].message == "psnr was 30.5 and is 30.3: worse by 0.2, tolerance 0.1"
    assert by_case["Anna/m/ssim"].passed
    assert by_case["Anna/m/lpips_alex"].passed
    assert all(check.passed for check in compare_with_baselines([new], [old], {"psnr": 0.3, "psnr_pooled": 0.3}))
    assert all(check.passed for check in compare_with_baselines([old], [old], {}))


def test_default_tolerances_are_those_of_the_catalogue() -> None:
    old = evaluation("Anna", "m", ssim=(0.9, 0.9))
    inside, outside = (evaluation("Anna", "m", ssim=(value, value)) for value in (0.8985, 0.8975))
    assert all(check.passed for check in compare_with_baselines([inside], [old], {}))
    assert [check.case for check in compare_with_baselines([outside], [old], {}) if not check.passed] == ["Anna/m/ssim"]


def test_what_vanished_fails() -> None:
    old = evaluation("Anna", "m")
    gone = compare_with_baselines([evaluation("Anna", "m", lpips=())], [old], {})
    assert [check.case for check in gone if not check.passed] == ["Anna/m/lpips_alex"]
    (missing,) = compare_with_baselines([evaluation("Bert", "m")], [old], {})
    assert not missing.passed
    assert missing.case == "Anna/m"


def test_seeds_have_names_of_their_own_and_are_compared_with_their_like() -> None:
    seeds = [evaluation("Anna", "m", (30.0 + seed, 31.0 + seed), seed=seed) for seed in (1, 2)]
    assert [check.case for check in check_limits(seeds, {"psnr": 1.0}, {})] == [
        "Anna/m/seed 1/psnr",
        "Anna/m/seed 2/psnr",
    ]
    checks = compare_with_baselines(seeds[::-1], seeds, {})
    assert len({check.case for check in checks}) == len(checks)
    assert all(check.passed for check in checks)
    (lower,) = [c for c in compare_with_baselines([seeds[0]], [seeds[1]], {}) if c.case == "Anna/m/seed 1/psnr"]
    assert not lower.passed


def test_another_ground_truth_is_pointed_out() -> None:
    old = evaluation("Anna", "m")
    new = dataclasses.replace(old, hashes={"ground_truth": "another"})
    assert all("(of another ground truth)" in check.message for check in compare_with_baselines([new], [old], {}))
    assert not any("another" in check.message for check in compare_with_baselines([old], [old], {}))


def test_other_protocols_do_not_compare() -> None:
    old = dataclasses.replace(evaluation("Anna", "m"), protocol=PROTOCOL.override(background="black"))
    with pytest.raises(InputError, match="not comparable"):
        compare_with_baselines([evaluation("Anna", "m")], [old], {})


CHECKS = [Check("Anna/m/psnr", True, "fine"), Check("Anna/m/ssim", False, "100% bad: <x>, worse\nby 1")]


def test_junit_holds_every_check() -> None:
    root = ElementTree.fromstring(to_junit(CHECKS))
    suite = root.find("testsuite")
    assert suite is not None
    assert (suite.get("tests"), suite.get("failures")) == ("2", "1")
    cases = suite.findall("testcase")
    assert [(case.get("classname"), case.get("name")) for case in cases] == [("Anna/m", "psnr"), ("Anna/m", "ssim")]
    failure = cases[1].find("failure")
    assert failure is not None
    assert failure.get("message") == "100% bad: <x>, worse\nby 1".replace("\n", "\n")
    assert cases[0].find("failure") is None


def test_github_annotations_are_one_line_each() -> None:
    lines = to_github(CHECKS).splitlines()
    assert lines[0] == "::notice title=Anna/m/psnr::fine"
    assert lines[1] == "::error title=Anna/m/ssim::100%25 bad: <x>, worse%0Aby 1"
    (line,) = to_github([Check("a:b,c/m/psnr", False, "x")]).splitlines()
    assert line == "::error title=a%3Ab%2Cc/m/psnr::x"
