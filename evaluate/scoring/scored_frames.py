"""Which frames of a capture a protocol scores, at which size, and how their ground truth is made."""

from __future__ import annotations

from typing import NamedTuple

from evaluate.protocols.protocol import CAPTURE_REGIONS, GIVEN, Protocol
from evaluate.scoring.ground_truth import GroundTruth
from ggavatar.data.background import Color
from ggavatar.data.capture import Capture
from ggavatar.data.splits import split_name
from ggavatar.errors import InputError, nearest
from ggavatar.training.run_folder import choose_split


class ScoredFrames(NamedTuple):
    """Test frames and where they come from.

    Attributes:
        split: Name of a split or the rule that made it.
        frames: Source frame numbers.
    """

    split: str
    frames: tuple[int, ...]


def choose_frames(
    capture: Capture, protocol: Protocol, rule: str | None = None, own: ScoredFrames | None = None
) -> ScoredFrames:
    """The test frames of a protocol.

    Args:
        capture: The capture that is scored.
        protocol: Names the split.
        rule: `file:PATH` if the protocol's split is a list in a file.
        own: Test frames of the run, used if they belong to the protocol's split.

    Raises:
        InputError: The capture has too few frames for the split, or the protocol needs a list and there is none.
    """
    if rule is None and own is not None and protocol.split in (GIVEN, own.split, split_name(own.split)):
        return own
    wanted = rule or protocol.split
    if wanted == "file" and "file" not in capture.splits:
        raise InputError(
            f"{capture.folder}: protocol {protocol.id} scores a list of test frames that comes with its data, and "
            'neither the run nor the capture has one; write it to a file, {"train": [0, 1, …], "test": [2, …]}, train '
            "with ggavatar-train --split file:PATH, and score that run; pictures made elsewhere (--pred) are scored "
            "with ggavatar-eval --split file:PATH"
        )
    name, split = choose_split(capture, wanted)
    return ScoredFrames(name, split.test)


def ground_truth_of(protocol: Protocol, background: Color) -> GroundTruth:
    """How a protocol makes ground truth; `background` is used if the protocol leaves its own open."""
    return GroundTruth(protocol.background_rgb or background, protocol.size, protocol.mask == "binary")


def for_capture(protocol: Protocol, capture: Capture) -> Protocol:
    """The protocol, at the capture's own resolution if its own would enlarge or distort the ground truth.

    Raises:
        InputError: It has a region that cannot be found in a capture.
    """
    for region in protocol.regions:
        if region not in CAPTURE_REGIONS:
            known = f"{nearest(region, CAPTURE_REGIONS)}; those of a capture are {', '.join(CAPTURE_REGIONS)}"
            raise InputError(f"unknown region {region!r}{known}")
    own = capture.width, capture.height
    if protocol.size is None:
        return protocol
    width, height = protocol.size
    distorted = abs(own[0] * height - own[1] * width) > 0.01 * own[0] * height
    if own[0] < width or own[1] < height or distorted:
        return protocol.override(resolution=f"{own[0]}x{own[1]}")
    return protocol
