"""Third stage: looks for the face in the images; in only some of them if another tracker has found it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ggavatar.io.images import read_rgb
from ggavatar.io.ordered_map import ordered_map
from ggavatar.landmarks.tracker import LandmarkTracker
from preprocess.evidence.faces import local_landmark_tracker, open_landmark_tracker
from preprocess.evidence.survey import Survey, read_survey, survey
from preprocess.options import PrepOptions
from preprocess.pipeline.crop_stage import pictures_of
from preprocess.pipeline.stage import RECORDS, Stage, StageContext
from preprocess.video.crop import crop_from_json

FACES = f"{RECORDS}/faces.npz"


def inputs(options: PrepOptions) -> Mapping[str, Any]:
    """Whether the face is needed in every frame."""
    return {"every_frame": options.tracking is None}


def run(context: StageContext) -> Mapping[str, Any]:
    """Write the faces, one row per frame.

    The face is looked for in only some frames of a clip with imported tracking, and only if the networks are on this
    machine.
    """
    options = context.options
    needed = options.tracking is None
    tracker: LandmarkTracker | None = (
        open_landmark_tracker(options.models, options.offline) if needed else local_landmark_tracker(options.models)
    )
    if tracker is not None:
        tracker.follow(_followed_place(context))
    paths = [context.folder / "images" / f"{number:06d}.png" for number in context.results["frames"]["numbers"]]

    def read(rows: Sequence[int]) -> Iterable[np.ndarray]:
        for row, image in zip(rows, ordered_map(read_rgb, (paths[row] for row in rows)), strict=True):
            context.reporter.advance(row + 1, len(paths))
            yield image

    found = survey(pictures_of(context), read, tracker, every_frame=needed)
    found.write_faces(context.folder / FACES)
    return {"looked_for": int(found.looked.sum()), "found": int(found.faces.found.sum())}


def survey_of(context: StageContext) -> Survey:
    """What the crop and the face stage have found."""
    return read_survey(pictures_of(context), context.folder / FACES)


def _followed_place(context: StageContext) -> tuple[float, float] | None:
    """Where the face that the crop was chosen for is in the first images, px; None if the crop was given."""
    faces = context.results["frames"]["faces"]
    if not faces:
        return None
    crop = crop_from_json(dict(context.results["crop"]["crop"]))
    left, top, right, bottom = faces[0]
    scale = np.array([crop.out_width / crop.width, crop.out_height / crop.height])
    place = (np.array([left + right, top + bottom]) / 2 - [crop.x, crop.y]) * scale
    return float(place[0]), float(place[1])


STAGE = Stage("faces", "Finding the face", inputs, run, outputs=(FACES,), version=2)
