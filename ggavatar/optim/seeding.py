"""Random generators that a resumed training finds again."""

from __future__ import annotations

import torch


def seeded(seed: int, *stream: int) -> torch.Generator:
    """A generator that depends on a seed and on what it is for alone (a step, an epoch).

    A resumed training therefore needs no state of it.
    """
    mixed = seed & 0xFFFFFFFFFFFFFFFF
    for number in stream:
        mixed = (mixed * 6364136223846793005 + number * 1442695040888963407 + 1) & 0xFFFFFFFFFFFFFFFF
        mixed ^= mixed >> 33
    return torch.Generator().manual_seed(mixed & 0x7FFFFFFFFFFFFFFF)
