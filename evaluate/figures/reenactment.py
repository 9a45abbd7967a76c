"""The reenactment figure: the driver's frames in the top row, those of each avatar below."""

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
    """The figure, with one column per frame.

    Args:
        driver: Frames of the driving person, 8-bit RGB; empty if there are only parameters.
        results: The avatars' images of the same frames, by row label.
        captions: Texts under the driver's frames, such as frame numbers.
        width: Width of one image, px.
    """
    rows = [Row([resize_to_width(image, width) for image in driver], "driver", captions)] if driver else []
    rows += [Row([resize_to_width(image, width) for image in images], name) for name, images in results.items()]
    return contact_sheet(
        rows, note="Expression and pose carried over relative to the neutral frames of driver and avatar"
    )


def representative_rows(sequence: DrivingSequence, count: int) -> list[int]:
    """Rows that differ most from the mean and from each other, in temporal order.

    Args:
        sequence: The driving sequence.
        count: Number of rows; all rows of a shorter sequence.

    References:
        Gonzalez 1985, farthest-first traversal; here over expression, joints and eyelids in comparable units.
    """
    features = _features(sequence)
    chosen = [int(np.argmax(np.linalg.norm(features, axis=1)))]
    while len(chosen) < min(count, len(features)):
        nearest = np.min([np.linalg.norm(features - features[row], axis=1) for row in chosen], axis=0)
        nearest[chosen] = -1.0
        chosen.append(int(np.argmax(nearest)))
    return sorted(set(chosen))


def _features(sequence: DrivingSequence) -> Float[np.ndarray, "T D"]:
    """Expression normalized by its energy, joint rotations and eyelids, each in units of about one."""
    centered = sequence.expression - sequence.expression.mean(axis=0)
    scale = max(float(np.sqrt(np.square(centered).sum(axis=1).mean())), 1e-9)
    joints = sequence.joint_rotations.reshape(len(centered), -1) / 0.2
    return np.concatenate((centered / scale, joints - joints.mean(axis=0), sequence.eyelids / 0.5), axis=1)
