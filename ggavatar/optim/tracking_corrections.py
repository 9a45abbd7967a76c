"""Corrections of tracked parameters, one set per training frame, learned together with the avatar (GaussianAvatars).

A frame that was never trained on has no correction: test frames and other drives are used as they were tracked.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import nn

from ggavatar.core import Drive


@dataclass(frozen=True)
class CorrectionRates:
    """Learning rates of the corrected parameters."""

    expression: float = 1e-3
    """Rate of the expression coefficients, in their unit (GaussianAvatars)."""
    joint_rotations: float = 1e-5
    """Rate of the axis-angle vectors of all joints, rad (GaussianAvatars)."""
    translation: float = 1e-6
    """Rate of the head's translation, m (GaussianAvatars)."""


class DriveCorrections(nn.Module):
    """Learned offsets of the tracked expression, joint rotations and translation of every training frame.

    Attributes:
        groups: The corrections with their rates, for an optimizer.

    References:
        Qian et al. 2024, Sec. 3.4 and supplement: FLAME's parameters are fine-tuned, shape and offsets are not.
    """

    def __init__(self, drives: Sequence[Drive], rates: CorrectionRates) -> None:
        """Start with corrections of zero for every drive that has a frame number.

        Raises:
            ValueError: No drive has a frame number.
        """
        super().__init__()
        numbered = [drive for drive in drives if drive.frame is not None]
        if not numbered:
            raise ValueError("expected training drives with frame numbers, found none")
        self._row = {drive.frame: row for row, drive in enumerate(numbered)}
        first, count = numbered[0], len(numbered)
        self.expression = nn.Parameter(first.expression.new_zeros(count, *first.expression.shape))
        self.joint_rotations = nn.Parameter(first.joint_rotations.new_zeros(count, *first.joint_rotations.shape))
        self.translation = nn.Parameter(first.translation.new_zeros(count, 3))
        self.groups: list[dict[str, Any]] = [
            {"params": [getattr(self, name)], "lr": rate} for name, rate in dataclasses.asdict(rates).items()
        ]

    @functools.cached_property
    def optimizer(self) -> torch.optim.Optimizer:
        """Adam on all frames at once, ε = 1e-15, made when it is first used.

        A frame's corrections keep moving by their moments between two visits, as in GaussianAvatars.
        """
        return torch.optim.Adam(self.groups, betas=(0.9, 0.999), eps=1e-15, fused=True)

    def corrects(self, drive: Drive) -> bool:
        """Whether the drive belongs to a training frame."""
        return drive.frame in self._row

    def forward(self, drive: Drive) -> Drive:
        """The corrected drive; the drive itself if its frame was never trained on."""
        if not self.corrects(drive):
            return drive
        row = self._row[drive.frame]
        return dataclasses.replace(
            drive,
            expression=drive.expression + self.expression[row],
            joint_rotations=drive.joint_rotations + self.joint_rotations[row],
            translation=drive.translation + self.translation[row],
        )
