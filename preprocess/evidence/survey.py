"""One pass over a clip's images: thumbnails, faces and repeats, from which frames without evidence are told."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

from ggavatar.io.npz import read_npz, write_npz
from ggavatar.io.ordered_map import ordered_map
from ggavatar.landmarks.tracker import Landmarks, LandmarkTracker
from preprocess.evidence.blank import blank_frames, faded_frames, thumbnail
from preprocess.evidence.clip_faces import ClipFaces, stack_faces
from preprocess.evidence.cuts import LARGE_CHANGE

BLACK, BLANK, FADED, NO_FACE, REPEATED = "black", "blank", "faded in or out", "no face", "repeats the frame before"
OTHER_PART = "another part of the clip"
"""Reasons in capture.json."""
MAX_BLACK = 32.0
"""Brightness, in 8-bit levels, up to which a blank frame is black."""
SPARSE_STEP = 8
"""Where another tracker has found the face, it is looked for in every so many frames, and around those without one."""
MIN_FOUND = 0.5
"""Fraction of the frames looked at that must show a face before one without is dropped: some are never recognized."""
MAX_REPEAT_DIFFERENCE = 0.15
"""Mean difference of neighboring frames, in 8-bit levels, below which the second counts as a repeat."""


@dataclass(frozen=True)
class Survey:
    """What the frames of a clip show.

    Attributes:
        thumbnails: 32 × 32 px.
        faces: Landmarks.
        looked: Frames in which the face was looked for; the others lie between two that show one.
        repeated: Frames that repeat the one before.
    """

    thumbnails: UInt8[np.ndarray, "T 32 32 3"]
    faces: ClipFaces
    looked: Bool[np.ndarray, " T"]
    repeated: Bool[np.ndarray, " T"]

    def write(self, path: Path) -> None:
        """Store as npz."""
        faces = {"points": self.faces.points, "depth": self.faces.depth, "blendshapes": self.faces.blendshapes}
        rest = {"thumbnails": self.thumbnails, "looked": self.looked, "repeated": self.repeated}
        write_npz(path, faces | rest)

    @cached_property
    def blank(self) -> Bool[np.ndarray, " T"]:
        """Frames of a single color."""
        return blank_frames(self.thumbnails)

    @cached_property
    def without_picture(self) -> Bool[np.ndarray, " T"]:
        """Frames that are blank or part of a fade."""
        return self.blank | faded_frames(self.thumbnails, self.blank)

    @property
    def missing(self) -> Bool[np.ndarray, " T"]:
        """Frames in which no face was found where one was looked for."""
        return self.looked & ~self.faces.found

    @property
    def faces_are_reliable(self) -> bool:
        """Whether most frames with a picture show a face, so that one without is an exception."""
        seen = ~self.without_picture
        searched = bool((self.looked & seen).any())
        return searched and bool((self.missing & seen).sum() <= (1 - MIN_FOUND) * seen.sum())

    def reasons(self) -> dict[int, str]:
        """Why a frame shows no person, by position."""
        brightness = self.thumbnails.mean(axis=(1, 2, 3))
        found = dict.fromkeys(np.flatnonzero(self.missing).tolist(), NO_FACE) if self.faces_are_reliable else {}
        found |= dict.fromkeys(np.flatnonzero(self.without_picture).tolist(), FADED)
        return found | {
            row: BLACK if brightness[row] <= MAX_BLACK else BLANK for row in np.flatnonzero(self.blank).tolist()
        }

    def repeats(self) -> dict[int, str]:
        """The frames that repeat the one before, by position."""
        return {int(row): REPEATED for row in np.flatnonzero(self.repeated)}


def read_survey(path: Path) -> Survey:
    """What `Survey.write` stored; `InputError` if it is damaged."""
    found = read_npz(path, ("points", "depth", "blendshapes", "thumbnails", "looked", "repeated"))
    faces = ClipFaces(found["points"], found["depth"], found["blendshapes"])
    return Survey(found["thumbnails"], faces, found["looked"], found["repeated"])


def survey(
    images: Iterable[np.ndarray], read: Callable[[int], np.ndarray], tracker: LandmarkTracker | None, every_frame: bool
) -> Survey:
    """Look at every frame of a clip.

    Args:
        images: The frames in order.
        read: Reads a frame again, for the second look that a search in only some of them needs.
        tracker: The landmark networks; None looks for no faces.
        every_frame: Whether the face is looked for in every frame, else in every `SPARSE_STEP`-th.
    """
    thumbnails: list[np.ndarray] = []
    faces: list[Landmarks | None] = []
    looked: list[bool] = []
    repeated: list[bool] = []
    before: np.ndarray | None = None
    for row, (image, small, gray) in enumerate(ordered_map(_reduced, images)):
        look = tracker is not None and (every_frame or row % SPARSE_STEP == 0)
        if tracker is not None and row and _change(small, thumbnails[-1]) > LARGE_CHANGE:
            tracker.reset()
        faces.append(tracker.landmarks(image) if look and tracker is not None and not _is_blank(small) else None)
        thumbnails.append(small)
        looked.append(look)
        repeated.append(before is not None and float(cv2.absdiff(gray, before).mean()) < MAX_REPEAT_DIFFERENCE)
        before = gray
    if tracker is not None and not every_frame:
        _look_around_gaps(faces, looked, thumbnails, read, tracker)
    return Survey(np.stack(thumbnails), stack_faces(faces), np.array(looked), np.array(repeated))


def _reduced(image: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The image, its thumbnail, and it in gray."""
    return image, thumbnail(image), cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)


def _change(small: np.ndarray, before: np.ndarray) -> float:
    return float(np.abs(small.astype(np.int16) - before).mean())


def _is_blank(small: np.ndarray) -> bool:
    return bool(blank_frames(small[None])[0])


def _look_around_gaps(
    faces: list[Landmarks | None],
    looked: list[bool],
    thumbnails: Sequence[np.ndarray],
    read: Callable[[int], np.ndarray],
    tracker: LandmarkTracker,
) -> None:
    """Look at all frames between one with and one without a face; between two without, all are without."""
    sampled = [row for row, was in enumerate(looked) if was]
    if sum(faces[row] is not None for row in sampled) < MIN_FOUND * len(sampled):
        looked[:] = [True] * len(looked)
        return
    for first, second in zip(sampled, [*sampled[1:], len(faces)], strict=True):
        last = second if second < len(faces) else first
        if faces[first] is not None and faces[last] is not None:
            continue
        search = faces[first] is not None or faces[last] is not None
        tracker.reset()
        for row in range(first + 1, second):
            looked[row] = True
            if search and not _is_blank(thumbnails[row]):
                faces[row] = tracker.landmarks(read(row))
