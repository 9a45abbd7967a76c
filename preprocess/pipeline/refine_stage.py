"""Seventh stage: the tracking is refined against the pictures, or taken over as it is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ggavatar.data.capture import HEAD, TRACKING, Tracking
from ggavatar.data.capture_schema import read_tracking
from ggavatar.io.images import read_gray, read_rgb
from ggavatar.io.npz import write_npz
from preprocess.options import PrepOptions
from preprocess.pipeline.stage import Stage, StageContext
from preprocess.pipeline.tracking_stage import TRACKED
from preprocess.tracking.geometry.projection import one_torch_thread
from preprocess.tracking.geometry.rigid import evenly_spaced

if TYPE_CHECKING:
    from preprocess.refinement.refine import Refined

LEAST_FRAMES = 48
"""Fewer show the person from too few sides for an avatar that corrects the tracking."""
PICTURES = 250
"""Most pictures that are compared, evenly spaced; it bounds the time, whatever the length of the clip."""
SIDE = 160
"""Longer side of the compared pictures, px."""


def inputs(options: PrepOptions) -> Mapping[str, Any]:
    """Whether refinement is wanted, which also depends on where the tracking is from."""
    return {"refine": options.refine}


def run(context: StageContext) -> Mapping[str, Any]:
    """Write tracking.npz, refined or as tracked; the result says which, and why not."""
    tracking = Tracking(**read_tracking(context.folder / TRACKED))
    numbers = list(context.results["tracking"]["numbers"])
    reason = why_not(context.options, len(numbers))
    if reason is not None:
        write_npz(context.folder / TRACKING, tracking.arrays())
        if context.options.refine != "no":
            context.reporter.note(f"the tracking is not refined against the pictures: {reason}")
        return {"refined": False, "reason": reason}
    found = _refine(context, tracking, numbers)
    if not found.settled:
        write_npz(context.folder / TRACKING, tracking.arrays())
        context.reporter.warn("the tracking is not refined: the short avatar and the tracking drifted apart")
        return {"refined": False, "reason": "it did not settle"}
    write_npz(context.folder / TRACKING, found.tracking.arrays())
    context.reporter.note(in_words(found.report))
    return {"refined": True, **found.report}


def why_not(options: PrepOptions, frames: int) -> str | None:
    """Why a clip is not refined; None if it is."""
    if options.refine == "no":
        return "--no-refine"
    if options.refine == "auto" and options.tracking is not None:
        return "it was made elsewhere; --refine corrects it"
    if frames < LEAST_FRAMES:
        return f"{frames} frames are too few, it takes {LEAST_FRAMES}"
    return None


def in_words(report: Mapping[str, Any]) -> str:
    """One line on what was refined, and how to do without."""
    return (
        f"the tracking is refined against {report['pictures']} of the pictures, test frames among them (as by every "
        f"photometric tracker): the head moved by {report['head_degrees']:.2f}° and {report['head_mm']:.1f} mm "
        "(medians); --no-refine keeps it as tracked"
    )


def _refine(context: StageContext, tracking: Tracking, numbers: list[int]) -> Refined:
    from ggavatar.head.files import load_head
    from preprocess.refinement.pictures import face_points, read_pictures
    from preprocess.refinement.refine import refine

    def read(row: int) -> tuple[np.ndarray, np.ndarray]:
        name = f"{numbers[row]:06d}.png"
        return read_rgb(context.folder / "images" / name), read_gray(context.folder / "masks" / name)

    rows = evenly_spaced(len(numbers), PICTURES).tolist()
    head, fps = load_head(context.folder / HEAD), float(context.results["evidence"]["fps"])
    with one_torch_thread():
        pictures = read_pictures(rows, read, SIDE, lambda row: face_points(head, tracking, row))
        return refine(head, tracking, pictures, fps, advance=context.reporter.advance)


STAGE = Stage("refinement", "Refining", inputs, run, outputs=(TRACKING,))
