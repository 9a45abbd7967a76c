"""What every source of tracking, an importer or the built-in tracker, passes to the rest of the pipeline."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ggavatar.data.capture import Tracking
from ggavatar.head.model import HeadModel


@dataclass(frozen=True)
class TrackedSequence:
    """Tracking of the capture's frames, and the head model it belongs to.

    Attributes:
        tracking: One row for each frame of the capture, intrinsics in px of the capture's images.
        head: Head model with the identity folded in; as many expressions and joints as the tracking.
        report: The tracker's name, version, residuals and warnings, as plain JSON values.
    """

    tracking: Tracking
    head: HeadModel
    report: Mapping[str, Any] = field(default_factory=dict)
