"""Eighth stage: writes splits and capture.json, which make the folder a capture, and checks it by opening it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ggavatar.data.capture import TRACKING, Capture, Tracking
from ggavatar.data.capture_schema import read_tracking
from ggavatar.data.splits import split_frames, split_name
from ggavatar.io.held_folders import make_folder
from ggavatar.text.names import clean_name
from preprocess.options import PrepOptions
from preprocess.pipeline.stage import RECORDS, Stage, StageContext, file_state

FOLDERS = ("images", "masks")
DROPPED = f"{RECORDS}/dropped"
"""Where images and masks of dropped frames are kept."""


def inputs(options: PrepOptions) -> Mapping[str, Any]:
    """The subject's name and the splits."""
    return {"subject": options.subject, "split": options.split, "files": _split_files(options)}


def _split_files(options: PrepOptions) -> list[Any]:
    return [file_state(Path(rule.removeprefix("file:"))) for rule in options.split if rule.startswith("file:")]


def run(context: StageContext) -> Mapping[str, Any]:
    """Write capture.json and put images and masks of dropped frames aside."""
    source, crop = context.results["frames"], context.results["crop"]["crop"]
    numbers, tracked = tuple(source["numbers"]), context.results["tracking"]
    frames = tuple(tracked["numbers"])
    rules = ["every-20th", *(rule for rule in context.options.split if rule != "every-20th")]
    capture = Capture(
        folder=context.folder,
        subject=clean_name(context.options.subject or context.options.input.stem),
        width=crop["out_width"],
        height=crop["out_height"],
        fps=context.results["evidence"]["fps"],
        frames=frames,
        splits={split_name(rule): split_frames(frames, rule) for rule in rules},
        tracking=Tracking(**read_tracking(context.folder / TRACKING)),
        head_version=tracked["version"],
        source=_provenance(context),
        dropped=_dropped(numbers, context),
    )
    capture.write_metadata()
    Capture.open(context.folder)
    _put_aside(capture)
    context.reporter.advance(1, 1)
    reasons = Counter(str(item["reason"]) for item in capture.dropped)
    return {"frames": len(frames), "dropped": len(capture.dropped), "dropped_reasons": dict(reasons)}


def _put_aside(capture: Capture) -> None:
    """Move images and masks of dropped frames into the records, where they are no part of the capture."""
    for folder in FOLDERS:
        aside = capture.folder / DROPPED / folder
        make_folder(aside)
        for item in capture.dropped:
            path = capture.image_path(folder, item["frame"])
            if path.exists():
                path.replace(aside / path.name)


def restore_dropped(folder: Path) -> None:
    """Move them back: another run of a stage may drop other frames."""
    for name in FOLDERS:
        for path in sorted((folder / DROPPED / name).glob("[0-9]*.png")):
            make_folder(folder / name)
            path.replace(folder / name / path.name)


def _dropped(numbers: tuple[int, ...], context: StageContext) -> tuple[dict[str, Any], ...]:
    """Dropped frames with the reason that the first stage to drop them gave."""
    tracked = set(context.results["tracking"]["numbers"])
    reasons = dict(context.results["masks"]["dropped"]) | dict(context.results["evidence"]["dropped"])
    lost = [number for number in numbers if number not in tracked]
    return tuple({"frame": number, "reason": reasons.get(number, "no tracking")} for number in lost)


def _provenance(context: StageContext) -> dict[str, Any]:
    """Provenance of the capture."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        tool = version("ggavatar")
    except PackageNotFoundError:
        tool = "unknown"
    source, masks, tracking = (context.results[name] for name in ("frames", "masks", "tracking"))
    return {
        "name": source["name"],
        "sha256": source["sha256"],
        "width": source["width"],
        "height": source["height"],
        "crop": context.results["crop"]["crop"],
        "masks": masks["name"],
        "tracking": {key: value for key, value in tracking["report"].items() if key != "warnings"},
        "refinement": dict(context.results["refinement"]),
        "losses": source["losses"],
        "conversions": source["conversions"],
        "tool": f"ggavatar {tool}",
    }


STAGE = Stage("pack", "Packing", inputs, run, outputs=("capture.json",), version=3)
