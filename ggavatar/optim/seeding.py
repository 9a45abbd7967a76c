"""Random generators that a resumed training can recreate."""

from __future__ import annotations

import torch


def seeded(seed: int, *stream: int) -> torch.Generator:
    """A CPU generator that depends only on a seed and on what it is used for (a step, an epoch).

    A resumed training therefore needs no saved generator state.
    """
    mixed = seed & 0xFFFFFFFFFFFFFFFF
    for number in stream:
        mixed = (mixed * 6364136223846793005 + number * 1442695040888963407 + 1) & 0xFFFFFFFFFFFFFFFF
        mixed ^= mixed >> 33
    return torch.Generator().manual_seed(mixed & 0x7FFFFFFFFFFFFFFF)
