"""Reports of checks: JUnit XML, and workflow commands as GitHub's documentation defines them."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pytest

from evaluate.gates.baselines import baseline_of
from evaluate.gates.checks import Check
from evaluate.gates.limits import Limits
from evaluate.gates.reports import append_step_summary, to_github, to_junit
from tests.support.evaluations import evaluation

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
    assert failure.get("message") == "100% bad: <x>, worse\nby 1"
    assert cases[0].find("failure") is None


def test_no_two_junit_cases_have_the_same_name() -> None:
    old, new = evaluation("Anna", "m", lpips=(0.2, 0.2)), evaluation("Anna", "m")
    limits = Limits({"psnr": 3.0}, {"lpips": 1.0, "lpips_alex": 2.0}, [baseline_of(old)] * 2, {})
    cases = ElementTree.fromstring(to_junit(limits.checks([new]))).findall("testsuite/testcase")
    names = [(case.get("classname"), case.get("name")) for case in cases]
    assert len(set(names)) == len(names)
    assert {name for _, name in names} >= {
        "psnr floor", "psnr against baseline", "psnr against baseline (2)", "lpips_alex ceiling",
        "lpips_alex ceiling (2)",
    }  # fmt: skip


def test_github_gets_an_error_per_failure_and_one_summary() -> None:
    assert to_github(CHECKS).splitlines() == [
        "::error title=Anna/m/ssim::100%25 bad: <x>, worse%0Aby 1",
        "::notice title=ggavatar-eval::1 of 2 checks passed, 1 failed",
    ]
    assert to_github(CHECKS[:1]) == "::notice title=ggavatar-eval::1 of 1 checks passed\n"
    first, _ = to_github([Check("a:b,c%/m/psnr", False, "x")]).splitlines()
    assert first == "::error title=a%3Ab%2Cc%25/m/psnr::x"


def test_the_step_summary_is_appended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GITHUB_STEP_SUMMARY", raising=False)
    assert append_step_summary(CHECKS) is None
    path = tmp_path / "summary.md"
    path.write_text("before\n")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(path))
    append_step_summary([*CHECKS, Check("a|b", True, "*x*")])
    lines = path.read_text().splitlines()
    assert lines[:2] == ["before", "### ggavatar-eval: 2 of 3 checks passed, 1 failed"]
    assert lines[5] == "| **FAIL** | Anna/m/ssim | 100% bad: \\<x>, worse by 1 |"
    assert lines[7] == "| pass | a\\|b | \\*x\\* |"
