"""Fifth stage: what makes the folder a capture.

Splits and capture.json are written last and checked by opening the capture.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ggavatar.data.capture import TRACKING, Capture, Tracking
from ggavatar.data.capture_schema import read_tracking
from ggavatar.data.splits import split_frames, split_name
from preprocess.options import PrepOptions
from preprocess.pipeline.stage import Job, Stage, file_state


def inputs(options: PrepOptions) -> Mapping[str, Any]:
    """The subject's name and the splits."""
    return {"subject": options.subject, "split": options.split, "files": _split_files(options)}


def _split_files(options: PrepOptions) -> list[Any]:
    from pathlib import Path

    return [file_state(Path(rule.removeprefix("file:"))) for rule in options.split if rule.startswith("file:")]


def run(job: Job) -> Mapping[str, Any]:
    """Write capture.json and remove pictures of frames that were lost on the way."""
    source, crop = job.results["frames"], job.results["crop"]["crop"]
    numbers, tracked = tuple(source["numbers"]), job.results["tracking"]
    frames = tuple(tracked["numbers"])
    rules = ["every-20th", *(rule for rule in job.options.split if rule != "every-20th")]
    capture = Capture(
        folder=job.folder,
        subject=job.options.subject or job.options.input.stem,
        width=crop["out_width"],
        height=crop["out_height"],
        fps=source["fps"],
        frames=frames,
        splits={split_name(rule): split_frames(frames, rule) for rule in rules},
        tracking=Tracking(**read_tracking(job.folder / TRACKING)),
        head_version=tracked["version"],
        source=_provenance(job),
        dropped=_dropped(numbers, job),
    )
    capture.describe()
    Capture.open(job.folder)
    for item in capture.dropped:
        for folder in ("images", "masks"):
            capture.image_path(folder, item["frame"]).unlink(missing_ok=True)
    job.reporter.advance(1, 1)
    return {"frames": len(frames), "dropped": len(capture.dropped)}


def _dropped(numbers: tuple[int, ...], job: Job) -> tuple[dict[str, Any], ...]:
    """Frames that did not make it, with the reason."""
    masked, tracked = set(job.results["masks"]["numbers"]), set(job.results["tracking"]["numbers"])
    lost = []
    for number in numbers:
        if number not in masked:
            lost.append({"frame": number, "reason": "no mask"})
        elif number not in tracked:
            lost.append({"frame": number, "reason": "no tracking"})
    return tuple(lost)


def _provenance(job: Job) -> dict[str, Any]:
    """Where the capture came from."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        tool = version("ggavatar")
    except PackageNotFoundError:
        tool = "unknown"
    source, masks, tracking = (job.results[name] for name in ("frames", "masks", "tracking"))
    return {
        "name": source["name"],
        "sha256": source["sha256"],
        "width": source["width"],
        "height": source["height"],
        "crop": job.results["crop"]["crop"],
        "masks": masks["name"],
        "tracking": {key: value for key, value in tracking["report"].items() if key != "warnings"},
        "losses": source["losses"],
        "tool": f"ggavatar {tool}",
    }


STAGE = Stage("pack", "Packing", inputs, run, outputs=("capture.json",))
