"""Third stage: finds the face in every image, and which frames show the person that the capture is of."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ggavatar.errors import GateError, InputError
from ggavatar.io.images import read_rgb
from ggavatar.io.ordered_map import ordered_map
from ggavatar.landmarks.tracker import LandmarkTracker
from preprocess.evidence.blank import runs
from preprocess.evidence.clip_faces import read_clip_faces
from preprocess.evidence.cuts import find_cuts
from preprocess.evidence.faces import local_landmark_tracker, open_landmark_tracker
from preprocess.evidence.parts import choose_part, find_parts, parse_cut
from preprocess.evidence.survey import OTHER_PART, REPEATED, Survey, survey
from preprocess.options import PrepOptions
from preprocess.pipeline.stage import RECORDS, Stage, StageContext

FACES = f"{RECORDS}/faces.npz"
MINIMUM_FRAMES = 8
"""Fewest frames with a face that the built-in tracker works with."""


def inputs(options: PrepOptions) -> Mapping[str, Any]:
    """What is dropped, and whether faces are needed in every frame.

    Raises:
        InputError: `--cut` is malformed.
    """
    return {
        "every_frame": options.tracking is None,
        "keep_faceless": options.keep_faceless,
        "drop_repeated": options.drop_repeated,
        "cut": parse_cut(options.cut),
    }


def run(context: StageContext) -> Mapping[str, Any]:
    """Write the landmarks; the result lists the frames to work on, those of them to drop in the end, and the reasons.

    Raises:
        InputError: Too few frames show a face, or another person follows.
        GateError: Frames are dropped, with `--strict`.
    """
    options, numbers = context.options, list(context.results["frames"]["numbers"])
    if options.tracking is None and len(numbers) < MINIMUM_FRAMES:
        raise InputError(
            f"{options.input}: too few frames: expected at least {MINIMUM_FRAMES}, and several hundred for a good "
            f"avatar, found {len(numbers)}; record longer, or check --fps, --start, --end and --frames"
        )
    found = _survey(context, numbers)
    found.faces.write(context.folder / FACES)
    dropped = {} if options.keep_faceless else found.reasons()
    if options.drop_repeated:
        dropped = {**found.repeats(), **dropped}
    cuts = [row for row in find_cuts(found.thumbnails) if not {row, row - 1} & set(found.reasons())]
    dropped = {**dropped, **_other_parts(context, found, cuts, numbers)}
    kept = [row for row in range(len(numbers)) if row not in dropped]
    _report(context, numbers, found, dropped, kept)
    # The tracker needs frames without a face in between, since it smooths over time; they are dropped after it.
    between = range(kept[0], kept[-1] + 1) if options.tracking is None else kept
    return {
        "numbers": [numbers[row] for row in between if dropped.get(row) != REPEATED],
        "dropped": [[numbers[row], dropped[row]] for row in sorted(dropped)],
        "cuts": [numbers[row] for row in cuts],
        "faces_reliable": found.faces_are_reliable,
    }


def faces_by_frame(context: StageContext) -> dict[int, np.ndarray]:
    """Landmarks by frame number, px; empty if the networks find the face in too few frames to rely on them."""
    faces, result = read_clip_faces(context.folder / FACES), context.results["faces"]
    numbers = context.results["frames"]["numbers"]
    if not result["faces_reliable"]:
        return {}
    return {int(numbers[row]): faces.points[row] for row in np.flatnonzero(faces.found)}


def _survey(context: StageContext, numbers: Sequence[int]) -> Survey:
    """Look at all images."""
    options = context.options
    needed = options.tracking is None
    tracker: LandmarkTracker | None = (
        open_landmark_tracker(options.models, options.offline) if needed else local_landmark_tracker(options.models)
    )
    paths = [context.folder / "images" / f"{number:06d}.png" for number in numbers]

    def images() -> Any:
        for done, image in enumerate(ordered_map(read_rgb, paths), start=1):
            context.reporter.advance(done, len(paths))
            yield image

    return survey(images(), lambda row: read_rgb(paths[row]), tracker, every_frame=needed)


def _other_parts(context: StageContext, found: Survey, cuts: Sequence[int], numbers: Sequence[int]) -> dict[int, str]:
    """Frames of the parts that `--cut` does not keep, by position."""
    # A new shot may also begin after a blank or faded frame.
    borders = {*cuts, *(last + 1 for _, last in runs(found.without_picture))}
    parts = find_parts(found.thumbnails, found.faces, found.missing, sorted(borders))
    chosen = choose_part(parts, context.options.cut, numbers, context.options.input)
    if chosen is None:
        if cuts:
            listed = ", ".join(str(numbers[row]) for row in cuts)
            context.reporter.note(f"{context.options.input}: cuts at frames {listed}; the person is the same")
        return {}
    return {row: OTHER_PART for row in range(len(numbers)) if not chosen.first <= row <= chosen.last}


def _report(
    context: StageContext, numbers: Sequence[int], found: Survey, dropped: Mapping[int, str], kept: Sequence[int]
) -> None:
    """Say which frames are left out and why; raise if too few are left, or with `--strict`."""
    options, source = context.options, context.options.input
    missing = int(found.missing.sum())
    if options.keep_faceless and options.tracking is None and missing:
        context.reporter.warn(
            f"no face in {missing} of {len(numbers)} frames; their poses are taken from neighboring frames "
            "(--keep-faceless)"
        )
    words = describe_dropped([(numbers[row], dropped[row]) for row in sorted(dropped)])
    with_face = int(found.faces.found[list(kept)].sum()) if kept else 0
    if options.tracking is None and with_face < MINIMUM_FRAMES:
        raise InputError(
            f"{source}: expected a face in at least {MINIMUM_FRAMES} frames, found one in {with_face} of "
            f"{len(numbers)}" + (f" ({words})" if words else "") + "; is the clip a portrait video?"
        )
    if len(kept) < 2:
        raise InputError(f"{source}: expected at least two frames that show the person, found {len(kept)} ({words})")
    if not dropped:
        return
    message = f"{source}: {len(dropped)} of {len(numbers)} frames show nothing to learn from: {words}"
    if options.strict:
        raise GateError(f"{message} (--strict)")
    context.reporter.warn(f"{message}; they are left out (--keep-faceless keeps those without a face)")


def describe_dropped(dropped: Sequence[tuple[int, str]]) -> str:
    """Dropped frames in words: how many for which reason, and their numbers as ranges."""
    counts = Counter(reason for _, reason in dropped)
    return ", ".join(
        f"{count} {reason} ({ranges([number for number, other in dropped if other == reason])})"
        for reason, count in counts.items()
    )


def ranges(numbers: Sequence[int], limit: int = 6) -> str:
    """Ascending numbers as ranges, such as `0–14, 37`; the middle is left out if there are many."""
    if not len(numbers):
        return ""
    groups = np.split(np.asarray(numbers), np.flatnonzero(np.diff(numbers) > 1) + 1)
    words = [f"{group[0]}" if len(group) == 1 else f"{group[0]}–{group[-1]}" for group in groups]
    return ", ".join(words if len(words) <= limit else [*words[: limit - 1], "…", words[-1]])


STAGE = Stage("faces", "Finding the face", inputs, run, outputs=(FACES,))
