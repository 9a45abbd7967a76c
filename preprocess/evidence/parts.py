"""Parts of a clip that show one person each, and the one that is kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, UInt8

from ggavatar.errors import InputError
from preprocess.evidence.blank import runs
from preprocess.evidence.clip_faces import ClipFaces
from preprocess.evidence.cuts import color_distance, color_histogram
from preprocess.evidence.identity import face_shape, is_same_person

MIN_GAP = 5
"""Frames without a face after which another person may be there."""
MAX_SCENE_DISTANCE = 0.3
"""Color distance up to which two parts show the same scene."""


@dataclass(frozen=True)
class Part:
    """Consecutive frames with one person.

    Attributes:
        first: Position of the first frame.
        last: Position of the last frame.
        faces: Number of frames with a face.
        person: 0 for the first person of the clip, 1 for the next, …
    """

    first: int
    last: int
    faces: int
    person: int


def find_parts(
    thumbnails: UInt8[np.ndarray, "T h w 3"],
    faces: ClipFaces,
    missing: Bool[np.ndarray, " T"],
    cuts: Sequence[int],
) -> list[Part]:
    """Split a clip at cuts and gaps, compare the faces, and join neighboring parts of one person.

    Args:
        thumbnails: Of all frames.
        faces: Landmarks.
        missing: Frames in which no face was found where one was looked for.
        cuts: Positions of the first frames after cuts.
    """
    found = faces.found
    known: list[tuple[np.ndarray, np.ndarray]] = []
    parts: list[Part] = []
    for first, last in _stretches(found, missing, cuts):
        rows = first + np.flatnonzero(found[first : last + 1])
        shape = face_shape(faces.points[rows], faces.depth[rows])
        colors = color_histogram(thumbnails[rows])
        person = parts[-1].person if parts else 0
        if shape is not None:
            person = _person(shape, colors, known)
        if parts and parts[-1].person == person:
            parts[-1] = Part(parts[-1].first, last, parts[-1].faces + len(rows), person)
        else:
            parts.append(Part(first, last, len(rows), person))
    return parts


def _person(shape: np.ndarray, colors: np.ndarray, known: list[tuple[np.ndarray, np.ndarray]]) -> int:
    """The known person whose face has this shape, or the next new one, who is then known."""
    for person, (other, scene) in enumerate(known):
        if is_same_person(shape, other, color_distance(colors, scene) <= MAX_SCENE_DISTANCE):
            return person
    known.append((shape, colors))
    return len(known) - 1


def _stretches(found: np.ndarray, missing: np.ndarray, cuts: Sequence[int]) -> list[tuple[int, int]]:
    """First and last frame with a face of every stretch without a cut or a long gap."""
    starts = {0, *cuts} | {last + 1 for first, last in runs(missing) if last - first + 1 >= MIN_GAP}
    borders = [*sorted(starts - {len(found)}), len(found)]
    stretches = []
    for start, end in pairwise(borders):
        rows = start + np.flatnonzero(found[start:end])
        if len(rows):
            stretches.append((int(rows[0]), int(rows[-1])))
    return stretches


def choose_part(parts: Sequence[Part], wanted: str, numbers: Sequence[int], source: object) -> Part | None:
    """The part to keep; None keeps all.

    Args:
        parts: All parts.
        wanted: `--cut`: "refuse", "auto" (the longest part), "all", or the number of a part, from 1.
        numbers: Frame numbers.
        source: The video, for messages.

    Raises:
        InputError: There are several persons and `wanted` is "refuse", or there is no such part.
    """
    if wanted == "all" or (len(parts) < 2 and wanted in ("refuse", "auto")):
        return None
    if wanted == "auto":
        return max(parts, key=lambda part: part.faces)
    listed = [f"{place}: frames {numbers[part.first]}–{numbers[part.last]}" for place, part in enumerate(parts, 1)]
    if wanted == "refuse":
        other = parts[1]
        longest = max(parts, key=lambda part: part.faces)
        first, last = numbers[longest.first], numbers[longest.last]
        raise InputError(
            f"{source}: another person from frame {numbers[other.first]} on; parts {'; '.join(listed)}. Keep the "
            f"longest with --resume --cut auto (with --overwrite --frames {first}:{last + 1} it is also cropped by "
            "itself), another one with --cut N, or everything with --cut all if it is the same person"
        )
    if not 1 <= int(wanted) <= len(parts):
        raise InputError(
            f"--cut {wanted}: expected one of the parts {'; '.join(listed)}" if parts else f"--cut {wanted}"
        )
    return parts[int(wanted) - 1]


def parse_cut(text: str) -> str:
    """`--cut`, checked.

    Raises:
        InputError: Neither refuse, auto, all nor a number from 1.
    """
    if text not in ("refuse", "auto", "all") and not (text.isascii() and text.isdigit() and 1 <= int(text) < 10_000):
        raise InputError(f"--cut {text}: expected auto, all, refuse or the number of a part, from 1")
    return text
