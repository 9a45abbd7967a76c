"""Comparison with baselines: like with like, or exit code 2; worse than the tolerance fails."""

from __future__ import annotations

import dataclasses
import math

import pytest

from evaluate.gates.baselines import Baseline, baseline_of
from evaluate.gates.checks import Check
from evaluate.gates.regressions import compare_with_baselines
from evaluate.gates.tolerances import parse_tolerances
from evaluate.protocols.results import Evaluation
from evaluate.protocols.setup import Setup
from ggavatar.errors import InputError
from tests.support.evaluations import PROTOCOL, evaluation

FAST = Setup("run", "ggavatar", "fast", 1500, "random")


def compare(
    new: Evaluation | list[Evaluation], old: Evaluation | list[Baseline], *tolerances: str, allow: tuple[str, ...] = ()
) -> list[Check]:
    evaluations = new if isinstance(new, list) else [new]
    baselines = old if isinstance(old, list) else [baseline_of(old)]
    return compare_with_baselines(evaluations, baselines, parse_tolerances(tolerances), allow)


def failed(checks: list[Check]) -> list[str]:
    return [check.case for check in checks if not check.passed]


def test_a_fall_beyond_the_tolerance_fails_and_a_gain_never_does() -> None:
    old = evaluation("Anna", "m", (30.0, 31.0), (0.9, 0.92), (0.1, 0.08))
    new = evaluation("Anna", "m", (29.8, 30.8), (0.95, 0.97), (0.05, 0.05))
    by_case = {check.case: check for check in compare(new, old, "psnr=0.1")}
    assert not by_case["Anna/m/psnr"].passed
    assert by_case["Anna/m/psnr"].message == "psnr was 30.5 and is 30.3: worse by 0.2, tolerance 0.1"
    assert by_case["Anna/m/ssim"].passed
    assert by_case["Anna/m/lpips_alex"].passed
    assert failed(compare(new, old, "psnr=0.3", "psnr_pooled=0.3")) == []
    assert failed(compare(old, old)) == []


def test_default_tolerances_are_those_of_the_catalogue() -> None:
    old = evaluation("Anna", "m", ssim=(0.9, 0.9))
    inside, outside = (evaluation("Anna", "m", ssim=(value, value)) for value in (0.8985, 0.8975))
    assert failed(compare(inside, old)) == []
    assert failed(compare(outside, old)) == ["Anna/m/ssim"]


def test_what_vanished_fails() -> None:
    old = evaluation("Anna", "m")
    assert failed(compare(evaluation("Anna", "m", lpips=()), old)) == ["Anna/m/lpips_alex"]
    (missing,) = compare(evaluation("Bert", "m"), old)
    assert (missing.passed, missing.case) == (False, "Anna/m")


def test_identical_images_are_the_best_there_is() -> None:
    perfect = evaluation("Anna", "m", (math.inf, math.inf))
    assert "Anna/m/psnr" in failed(compare(evaluation("Anna", "m"), perfect))
    assert "Anna/m/psnr" not in failed(compare(perfect, evaluation("Anna", "m")))


def test_seeds_are_compared_with_their_like() -> None:
    seeds = [evaluation("Anna", "m", (30.0 + seed, 31.0 + seed), seed=seed) for seed in (1, 2)]
    checks = compare(seeds[::-1], [baseline_of(one) for one in seeds])
    assert len({check.case for check in checks}) == len(checks)
    assert failed(checks) == []
    assert "Anna/m/seed 1/psnr" in failed(compare(seeds[0], seeds[1]))


SETUP = {"preset": "default", "steps": 6000, "perceptual_loss": "vgg16", "changed": {"latent": 3}}
NAMES = {"preset": "preset", "steps": "length", "perceptual_loss": "features", "changed": "settings"}


@pytest.mark.parametrize("field", SETUP)
def test_another_setup_is_refused_unless_it_is_allowed_by_name(field: str) -> None:
    old = evaluation("Anna", "m", setup=FAST)
    new = dataclasses.replace(old, setup=dataclasses.replace(FAST, **{field: SETUP[field]}))
    name = NAMES[field]
    with pytest.raises(InputError, match=rf"differs from the baseline in {name} \(.*--allow-other {name}$"):
        compare(new, old)
    with pytest.raises(InputError, match=name):
        compare(new, old, allow=("ground-truth", "protocol"))
    checks = compare(new, old, allow=(name,))
    assert failed(checks) == [] and all(f"(another {name})" in check.message for check in checks)


def test_another_method_behind_the_same_label_is_refused() -> None:
    old = evaluation("Anna", "m", setup=FAST)
    other = dataclasses.replace(old, setup=dataclasses.replace(FAST, method="flash_avatar"))
    with pytest.raises(InputError, match=r"method \(ggavatar then, flash_avatar now\)"):
        compare(other, old)
    foreign = dataclasses.replace(old, setup=Setup("elsewhere"))
    with pytest.raises(InputError, match=r"method \(ggavatar then, rendered elsewhere now\)"):
        compare(foreign, old)


def test_a_baseline_of_another_method_is_refused_unless_it_is_allowed() -> None:
    old = evaluation("Anna", "ggavatar", setup=FAST)
    other = evaluation("Anna", "flash_avatar", (20.0, 20.0), setup=dataclasses.replace(FAST, method="flash_avatar"))
    with pytest.raises(InputError, match=r"method \(ggavatar then, flash_avatar now\).*--allow-other method$"):
        compare(other, old)
    checks = compare(other, old, allow=("method",))
    assert "Anna/flash_avatar/psnr" in failed(checks) and len(checks) == len(baseline_of(old).means)
    assert all("(another method)" in check.message for check in checks)
    with pytest.raises(InputError, match=r"method \(a then, b now\)"):
        compare(evaluation("Anna", "b"), evaluation("Anna", "a"))


def test_a_missing_method_beside_one_that_is_there_fails() -> None:
    there, gone = evaluation("Anna", "a"), evaluation("Anna", "b")
    assert failed(compare(there, [baseline_of(there), baseline_of(gone)])) == ["Anna/b"]


def test_a_comparison_across_seeds_says_so() -> None:
    one, two = (evaluation("Anna", "m", seed=seed) for seed in (1, 2))
    assert all("(another seed: 1 then, 2 now)" in check.message for check in compare(two, one))
    assert all("(another seed: none then, 2 now)" in c.message for c in compare(two, evaluation("Anna", "m")))
    assert not any("another" in check.message for check in compare(two, two))
    other = dataclasses.replace(two, hashes={"ground_truth": "another"})
    checks = compare(other, one, allow=("ground-truth",))
    assert all("(another ground truth, seed: 1 then, 2 now)" in check.message for check in checks)


def test_a_setup_that_was_not_recorded_is_not_held_against_a_result() -> None:
    assert failed(compare(evaluation("Anna", "m", setup=FAST), evaluation("Anna", "m"))) == []


def test_another_ground_truth_is_refused_unless_it_is_allowed() -> None:
    old = evaluation("Anna", "m")
    new = dataclasses.replace(old, hashes={"ground_truth": "another"})
    with pytest.raises(InputError, match=r"ground truth \(SHA-256 truth of Ann then, another now\)"):
        compare(new, old)
    checks = compare(new, old, allow=("ground-truth",))
    assert checks and all("(another ground truth)" in check.message for check in checks)


def test_another_protocol_is_refused_unless_it_is_allowed() -> None:
    old = dataclasses.replace(evaluation("Anna", "m"), protocol=PROTOCOL.override(background="black"))
    with pytest.raises(InputError, match="not comparable"):
        compare(evaluation("Anna", "m"), old)
    assert failed(compare(evaluation("Anna", "m"), old, allow=("protocol",))) == []


def test_of_a_run_with_several_protocols_the_right_one_counts() -> None:
    new = evaluation("Anna", "m")
    other = dataclasses.replace(new, protocol=PROTOCOL.override(background="black"))
    assert failed(compare(new, [baseline_of(other), baseline_of(new)])) == []
