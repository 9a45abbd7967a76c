"""The files of learned metrics: which models of the catalogue a metric needs. Imports no torch."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ggavatar.pretrained.resolve import ModelFinder, ModelUnavailable

NO_WEIGHTS = "no weights"
"""Beginning of the reason given for a metric whose weights are missing."""

BACKBONES = {"alex": "alexnet", "vgg": "vgg16", "squeeze": "squeezenet"}
"""Models of the networks of LPIPS; the linear heads are `lpips_alex`, `lpips_vgg` and `lpips_squeeze`."""

UNIT_RANGE = "_unit_range"
"""End of the name of a metric that is fed RGB in [0, 1]."""


@dataclass(frozen=True)
class LpipsFiles:
    """The two files of one LPIPS network."""

    backbone: Path
    head: Path


def network_of(name: str) -> str:
    """The network of a metric's name: `alex`, `vgg` or `squeeze`."""
    return name.removeprefix("lpips_").removesuffix(UNIT_RANGE)


def find_lpips(names: Iterable[str], models: ModelFinder) -> dict[str, LpipsFiles | str]:
    """The files of every network that metrics need, by network, or the reason why they cannot be had.

    Raises:
        InputError: A file has other contents than its name says.
    """
    found: dict[str, LpipsFiles | str] = {}
    for net in dict.fromkeys(network_of(name) for name in names):
        try:
            found[net] = LpipsFiles(models.find(BACKBONES[net]), models.find(f"lpips_{net}"))
        except ModelUnavailable as missing:
            found[net] = f"{NO_WEIGHTS}: {missing}"
    return found
