"""Evaluations with given values, for tests of tables and gates."""

from __future__ import annotations

from collections.abc import Sequence

from evaluate.protocols.protocol import Protocol, protocol_by_name
from evaluate.protocols.results import Evaluation
from evaluate.protocols.setup import Setup

UNKNOWN = Setup()
PROTOCOL = protocol_by_name("folders").override(metrics=("psnr", "ssim", "lpips_alex"))


def evaluation(
    subject: str,
    method: str,
    psnr: Sequence[float | None] = (30.0, 31.0),
    ssim: Sequence[float | None] = (0.9, 0.92),
    lpips: Sequence[float | None] = (0.1, 0.08),
    seed: int | None = None,
    protocol: Protocol = PROTOCOL,
    setup: Setup = UNKNOWN,
) -> Evaluation:
    """An evaluation of frames 0, 1, … with the given values; an empty `lpips` counts as missing weights."""
    values = {
        "mse": tuple(None if v is None else 10 ** (-v / 10) for v in psnr),
        "psnr": tuple(psnr),
        "ssim": tuple(ssim),
    }
    values |= {"lpips_alex": tuple(lpips)} if lpips else {}
    return Evaluation(
        subject, method, protocol, tuple(range(len(psnr))), values, seed,
        missing={} if lpips else {"lpips_alex": "no weights: alexnet_features.pth not found"},
        hashes={"ground_truth": f"truth of {subject}", "predictions": f"{method} {seed}"}, setup=setup,
    )  # fmt: skip
