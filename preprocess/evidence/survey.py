"""Where a clip shows a face, and what its pictures are, from which frames without evidence are told."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Bool, UInt8

from ggavatar.io.npz import read_npz, write_npz
from ggavatar.landmarks.tracker import Landmarks, LandmarkTracker
from preprocess.evidence.blank import blank_frames, faded_frames
from preprocess.evidence.clip_faces import ClipFaces, stack_faces
from preprocess.evidence.cuts import LARGE_CHANGE, changes
from preprocess.evidence.pictures import Pictures

BLACK, BLANK, FADED, NO_FACE, REPEATED = "black", "blank", "faded in or out", "no face", "repeats the frame before"
OTHER_PART = "another part of the clip"
"""Reasons in capture.json."""
MAX_BLACK = 32.0
"""Brightness, in 8-bit levels, up to which a blank frame is black."""
SPARSE_STEP = 8
"""Where another tracker has found the face, it is looked for in every so many frames, and around those without one."""
MIN_FOUND = 0.5
"""Fraction of the frames looked at that must show a face before one without is dropped: some are never recognized."""


@dataclass(frozen=True)
class Survey:
    """What the frames of a clip show.

    Attributes:
        pictures: Thumbnails and repeats.
        faces: Landmarks.
        looked: Frames in which the face was looked for; the others lie between two that show one.
    """

    pictures: Pictures
    faces: ClipFaces
    looked: Bool[np.ndarray, " T"]

    def write_faces(self, path: Path) -> None:
        """Store the faces and where they were looked for, as npz; the pictures have a file of their own."""
        faces = {"points": self.faces.points, "depth": self.faces.depth, "blendshapes": self.faces.blendshapes}
        write_npz(path, faces | {"looked": self.looked})

    @property
    def thumbnails(self) -> UInt8[np.ndarray, "T 32 32 3"]:
        """All frames at 32 × 32 px."""
        return self.pictures.thumbnails

    @property
    def repeated(self) -> Bool[np.ndarray, " T"]:
        """Frames that repeat the one before."""
        return self.pictures.repeated

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


def read_survey(pictures: Pictures, path: Path) -> Survey:
    """What `Survey.write_faces` stored; `InputError` if it is damaged."""
    found = read_npz(path, ("points", "depth", "blendshapes", "looked"))
    return Survey(pictures, ClipFaces(found["points"], found["depth"], found["blendshapes"]), found["looked"])


def survey(
    pictures: Pictures,
    read: Callable[[Sequence[int]], Iterable[np.ndarray]],
    tracker: LandmarkTracker | None,
    every_frame: bool,
) -> Survey:
    """Look for the face in the frames of a clip.

    Args:
        pictures: What is known of every frame.
        read: Reads the images of some frames, in their order.
        tracker: The landmark networks; None looks for no faces.
        every_frame: Whether the face is looked for in every frame, else in every `SPARSE_STEP`-th and, where one of
            two neighbors shows none, in all between them.
    """
    count = len(pictures.thumbnails)
    faces: list[Landmarks | None] = [None] * count
    looked = [False] * count
    if tracker is not None:
        blank, cut = blank_frames(pictures.thumbnails), changes(pictures.thumbnails) > LARGE_CHANGE
        rows = range(0, count, 1 if every_frame else SPARSE_STEP)
        before = 0
        for row, image in zip(rows, read(rows), strict=True):
            if cut[before + 1 : row + 1].any():
                tracker.reset()
            before, looked[row] = row, True
            faces[row] = None if blank[row] else tracker.landmarks(image)
        if not every_frame:
            _look_around_gaps(faces, looked, blank, read, tracker)
    return Survey(pictures, stack_faces(faces), np.array(looked, bool))


def _look_around_gaps(
    faces: list[Landmarks | None],
    looked: list[bool],
    blank: Bool[np.ndarray, " T"],
    read: Callable[[Sequence[int]], Iterable[np.ndarray]],
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
        between = range(first + 1, second)
        looked[first + 1 : second] = [True] * len(between)
        seen = [row for row in between if search and not blank[row]]
        for row, image in zip(seen, read(seen), strict=True):
            faces[row] = tracker.landmarks(image)
