"""Fifth stage: writes splits and capture.json, which make the folder a capture, and checks it by opening it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ggavatar.data.capture import TRACKING, Capture, Tracking
from ggavatar.data.capture_schema import read_tracking
from ggavatar.data.splits import split_frames, split_name
from preprocess.options import PrepOptions
from preprocess.pipeline.stage import Stage, StageContext, file_state


def inputs(options: PrepOptions) -> Mapping[str, Any]:
    """The subject's name and the splits."""
    return {"subject": options.subject, "split": options.split, "files": _split_files(options)}


def _split_files(options: PrepOptions) -> list[Any]:
    from pathlib import Path

    return [file_state(Path(rule.removeprefix("file:"))) for rule in options.split if rule.startswith("file:")]


def run(context: StageContext) -> Mapping[str, Any]:
    """Write capture.json and remove images and masks of dropped frames."""
    source, crop = context.results["frames"], context.results["crop"]["crop"]
    numbers, tracked = tuple(source["numbers"]), context.results["tracking"]
    frames = tuple(tracked["numbers"])
    rules = ["every-20th", *(rule for rule in context.options.split if rule != "every-20th")]
    capture = Capture(
        folder=context.folder,
        subject=context.options.subject or context.options.input.stem,
        width=crop["out_width"],
        height=crop["out_height"],
        fps=source["fps"],
        frames=frames,
        splits={split_name(rule): split_frames(frames, rule) for rule in rules},
        tracking=Tracking(**read_tracking(context.folder / TRACKING)),
        head_version=tracked["version"],
        source=_provenance(context),
        dropped=_dropped(numbers, context),
    )
    capture.write_metadata()
    Capture.open(context.folder)
    for item in capture.dropped:
        for folder in ("images", "masks"):
            capture.image_path(folder, item["frame"]).unlink(missing_ok=True)
    context.reporter.advance(1, 1)
    return {"frames": len(frames), "dropped": len(capture.dropped)}


def _dropped(numbers: tuple[int, ...], context: StageContext) -> tuple[dict[str, Any], ...]:
    """Dropped frames with the reason that the first stage to drop them gave."""
    tracked = set(context.results["tracking"]["numbers"])
    reasons = dict(context.results["masks"]["dropped"])
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
        "losses": source["losses"],
        "conversions": source["conversions"],
        "tool": f"ggavatar {tool}",
    }


STAGE = Stage("pack", "Packing", inputs, run, outputs=("capture.json",))
