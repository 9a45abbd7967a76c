"""Fourth stage: which frames show the person that the capture is of; the others are dropped, with the reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ggavatar.errors import GateError, InputError
from preprocess.evidence.blank import runs
from preprocess.evidence.cuts import find_cuts
from preprocess.evidence.parts import choose_part, find_parts, parse_cut
from preprocess.evidence.repeats import rate_without_repeats
from preprocess.evidence.survey import OTHER_PART, REPEATED, Survey
from preprocess.options import PrepOptions
from preprocess.pipeline.face_stage import survey_of
from preprocess.pipeline.read_stage import MINIMUM_FRAMES
from preprocess.pipeline.stage import Stage, StageContext


def inputs(options: PrepOptions) -> Mapping[str, Any]:
    """What is dropped.

    Raises:
        InputError: `--cut` is malformed.
    """
    return {
        "keep_faceless": options.keep_faceless,
        "drop_repeated": options.drop_repeated,
        "cut": parse_cut(options.cut),
    }


def run(context: StageContext) -> Mapping[str, Any]:
    """Decide from the survey; the result lists the frames to work on, and those to drop in the end with the reasons.

    Raises:
        InputError: Too few frames show a face, or another person follows.
        GateError: Frames are dropped, with `--strict`.
    """
    options, numbers = context.options, list(context.results["frames"]["numbers"])
    found, fps = survey_of(context), float(context.results["frames"]["fps"])
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
        "fps": rate_without_repeats(fps, found.repeated) if options.drop_repeated else fps,
    }


def faces_by_frame(context: StageContext) -> dict[int, np.ndarray]:
    """Landmarks by frame number, px; empty if the networks find the face in too few frames to rely on them."""
    found, numbers = survey_of(context), context.results["frames"]["numbers"]
    if not found.faces_are_reliable:
        return {}
    return {int(numbers[row]): found.faces.points[row] for row in np.flatnonzero(found.faces.found)}


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
    # What the user has asked to leave out is nothing to warn about.
    lost = set(dropped.values()) - {OTHER_PART, REPEATED}
    message = f"{source}: {len(dropped)} of {len(numbers)} frames are left out: {words}"
    if options.strict and lost:
        raise GateError(f"{message} (--strict)")
    (context.reporter.warn if lost else context.reporter.note)(
        f"{message}; --keep-faceless keeps those without a face" if lost else message
    )


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


STAGE = Stage("evidence", "Choosing frames", inputs, run)
