"""Tolerances: absolute or relative, by metric and region."""

from __future__ import annotations

import pytest

from evaluate.gates.tolerances import Tolerance, parse_tolerances, tolerance_of
from evaluate.metrics.catalogue import METRICS
from ggavatar.errors import InputError


@pytest.mark.parametrize(
    ("column", "before", "allowed"),
    [
        ("psnr", 30.0, 0.1),
        ("psnr@mouth", 30.0, 0.2),
        ("ssim_3dgs", 0.95, 0.002),
        ("lpips_alex", 0.1, 0.003),
        ("l1", 0.005, 0.0001),
        ("l1@face", 0.01, 0.0004),
        ("landmark_jitter", 0.02, 0.001),
        ("identity", 0.9, 0.01),
    ],
)
def test_defaults(column: str, before: float, allowed: float) -> None:
    assert tolerance_of(column, {}).allowed(before) == pytest.approx(allowed)


def test_no_default_hides_a_change_of_a_tenth() -> None:
    """Typical values of this project's results: docs/results.md."""
    typical = {"psnr": 30.0, "psnr_pooled": 30.0, "identity": 0.9}
    typical |= {name: 0.93 for name in METRICS if "ssim" in name} | {n: 0.08 for n in METRICS if "lpips" in n}
    for name, metric in METRICS.items():
        before = typical.get(name, 0.005)
        distance = before if metric.unit == "dB" or not metric.higher_is_better else 1 - before
        assert tolerance_of(name, {}).allowed(before) <= 0.1001 * distance, name


def test_what_is_named_holds_and_reaches_its_regions() -> None:
    given = parse_tolerances(["psnr=0.3", "psnr@mouth=1", "l1=10%"])
    assert tolerance_of("psnr", given) == Tolerance(0.3)
    assert tolerance_of("psnr@face", given) == Tolerance(0.6)
    assert tolerance_of("psnr@mouth", given) == Tolerance(1.0)
    assert tolerance_of("l1", given).allowed(0.05) == pytest.approx(0.005)
    assert tolerance_of("l1", given).words(0.05) == "tolerance 0.005 (10 %)"
    assert tolerance_of("ssim", given) == Tolerance(0.002)


@pytest.mark.parametrize("text", ["psnr", "psnr=", "psnr=much", "psnr=-1", "psnr=nan", "psnr=inf", "l1=%", "=3"])
def test_nonsense_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--tolerance"):
        parse_tolerances([text])
    with pytest.raises(InputError, match="did you mean psnr"):
        parse_tolerances(["pnsr=1"])
