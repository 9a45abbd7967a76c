"""Third stage: looks at every image once, for the face, for blank pictures and for repeats."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ggavatar.io.images import read_rgb
from ggavatar.io.ordered_map import ordered_map
from ggavatar.landmarks.tracker import LandmarkTracker
from preprocess.evidence.faces import local_landmark_tracker, open_landmark_tracker
from preprocess.evidence.survey import survey
from preprocess.options import PrepOptions
from preprocess.pipeline.stage import RECORDS, Stage, StageContext
from preprocess.video.crop import crop_from_json

SURVEY = f"{RECORDS}/survey.npz"


def inputs(options: PrepOptions) -> Mapping[str, Any]:
    """Whether the face is needed in every frame."""
    return {"every_frame": options.tracking is None}


def run(context: StageContext) -> Mapping[str, Any]:
    """Write what the images show, one row per frame.

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

    def images() -> Iterator[np.ndarray]:
        for done, image in enumerate(ordered_map(read_rgb, paths), start=1):
            context.reporter.advance(done, len(paths))
            yield image

    found = survey(images(), lambda row: read_rgb(paths[row]), tracker, every_frame=needed)
    found.write(context.folder / SURVEY)
    return {"looked_for": int(found.looked.sum()), "found": int(found.faces.found.sum())}


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


STAGE = Stage("faces", "Finding the face", inputs, run, outputs=(SURVEY,))
