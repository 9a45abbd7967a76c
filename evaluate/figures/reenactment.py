"""The reenactment figure: the driver's frames in the row above, what each avatar makes of them below."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, UInt8

from evaluate.figures.contact_sheet import Row, contact_sheet, resize_to_width
from evaluate.motion.driving_sequence import DrivingSequence


def reenactment(
    driver: Sequence[np.ndarray],
    results: Mapping[str, Sequence[np.ndarray]],
    captions: Sequence[str] = (),
    width: int = 256,
) -> UInt8[np.ndarray, "H W 3"]:
    """One column a frame.

    Args:
        driver: Frames of the driving person, 8-bit RGB; empty when there are only parameters.
        results: The avatars' pictures of the same frames, by the label of their row.
        captions: Under the driver's frames, such as frame numbers.
        width: Of one picture, px.
    """
    rows = [Row([resize_to_width(image, width) for image in driver], "driver", captions)] if driver else []
    rows += [Row([resize_to_width(image, width) for image in images], name) for name, images in results.items()]
    return contact_sheet(
        rows, note="Expression and pose carried over relative to the neutral frames of driver and avatar"
    )


def representative_rows(motion: DrivingSequence, count: int) -> list[int]:
    """Rows that differ most from the neutral and from each other: farthest-point choice, in order of time.

    Args:
        motion: The performance.
        count: How many rows; all of a shorter one.

    References:
        Gonzalez 1985, farthest-first traversal, on expression in deviations and jaw and lids in comparable units.
    """
    features = _features(motion)
    chosen = [int(np.argmax(np.linalg.norm(features, axis=1)))]
    while len(chosen) < min(count, len(features)):
        nearest = np.min([np.linalg.norm(features - features[row], axis=1) for row in chosen], axis=0)
        nearest[chosen] = -1.0
        chosen.append(int(np.argmax(nearest)))
    return sorted(set(chosen))


def _features(motion: DrivingSequence) -> Float[np.ndarray, "T D"]:
    """What the eye notices, in units of about one: expression weighted by its energy, joints and lids."""
    centered = motion.expression - motion.expression.mean(axis=0)
    scale = max(float(np.sqrt(np.square(centered).sum(axis=1).mean())), 1e-9)
    joints = motion.joint_rotations.reshape(len(centered), -1) / 0.2
    return np.concatenate((centered / scale, joints - joints.mean(axis=0), motion.eyelids / 0.5), axis=1)
