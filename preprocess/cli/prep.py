"""`ggavatar-prep`: from a portrait video to a capture.

Heavy modules are imported only after the arguments are parsed.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from ggavatar.cli.given import A_VIDEO, check_given
from ggavatar.cli.page import CommandPage, parse
from ggavatar.cli.progress import announce_start
from ggavatar.cli.run import run_command
from ggavatar.cli.typed import one_of
from ggavatar.errors import GateError
from preprocess.options import PrepOptions


def _formats() -> list[str]:
    from preprocess.formats.registry import importer_names

    return [f"formats of --tracking: {', '.join(importer_names())}"]


def _check_format(name: str) -> None:
    """Raise an `InputError` for a format that is not installed."""
    from preprocess.formats.registry import importer_names

    known = [one.replace("_", "-") for one in importer_names()]
    one_of("--format", ("auto", *known))(name.replace("_", "-"))


PAGE = CommandPage(
    program="ggavatar-prep",
    options=PrepOptions,
    summary="Make a capture from a portrait video: frames, crop, masks, tracking, and a check of the result.",
    examples=(
        ("ggavatar-prep alice.mp4 -o captures/alice", "a video, with our own masks and tracking"),
        ("ggavatar-prep alice.mp4 -o captures/alice --start 2 --end 30 --size 384", "a part of it, smaller"),
        (
            "ggavatar-prep frames -o captures/alice --tracking vhap --head-model flame2023.pkl --masks masks",
            "frames with masks and the tracking of another program",
        ),
    ),
    groups={
        "what is written": ("output_dir", "size", "crop", "split", "subject"),
        "frames of the video": ("start", "end", "frames", "fps", "camera"),
        "frames that are left out": ("keep_faceless", "cut", "drop_repeated"),
        "masks": ("masks", "invert_masks"),
        "tracking by another program": ("tracking", "format", "head_model", "frame_offset", "fix"),
        "tracking by this program": ("focal", "expressions", "smooth", "refine"),
        "an earlier capture in the folder": ("resume", "overwrite"),
        "files of pretrained models": ("models", "offline"),
        "output": ("strict", "quiet", "json"),
    },
    listing=_formats,
    checks={"format": _check_format},
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `ggavatar-prep`; returns the exit code."""
    return run_command(
        lambda: _prepare_resumable(_parse(sys.argv[1:] if arguments is None else arguments)), PrepOptions
    )


def _parse(arguments: Sequence[str]) -> PrepOptions:
    return parse(PAGE, _refine_as_value(_protect_dashed_paths(arguments)))


def _protect_dashed_paths(arguments: Sequence[str]) -> list[str]:
    """Prefix `./` to existing files and to an output folder whose names begin with a dash, so they parse as paths."""
    result: list[str] = []
    for argument in arguments:
        after_output = bool(result) and result[-1] in ("-o", "--output-dir")
        dashed = argument.startswith("-") and (
            Path(argument).exists() or (after_output and not argument.startswith("--"))
        )
        result.append(f"./{argument}" if dashed else argument)
    return result


def _refine_as_value(arguments: Sequence[str]) -> list[str]:
    """`--refine` without a value and `--no-refine` as the values that they stand for; a flag has no third state."""
    result: list[str] = []
    for place, argument in enumerate(arguments):
        if argument == "--no-refine":
            result += ["--refine", "no"]
        elif argument == "--refine" and not (set(arguments[place + 1 : place + 2]) & {"auto", "yes", "no"}):
            result += ["--refine", "yes"]
        else:
            result.append(argument)
    return result


def _prepare_resumable(options: PrepOptions) -> int:
    """Prepare; an interrupt tells the user how to resume."""
    try:
        return _prepare(options)
    except KeyboardInterrupt as stop:
        raise type(stop)("finished stages are kept; run the same command with --resume to continue") from None


def _prepare(options: PrepOptions) -> int:
    """Run the pipeline and report what was written."""
    # The fit's matrices are small and our own threads already keep the cores busy: OpenBLAS threads would compete.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    check_given(options.input, A_VIDEO)
    announce_start(options.quiet or options.json)
    from ggavatar.data.capture import Capture
    from preprocess.cli.terminal import Terminal
    from preprocess.pipeline.pipeline import run_pipeline

    terminal = Terminal(options.quiet or options.json)
    results = run_pipeline(options, terminal.stage)
    Capture.open(options.output_dir)  # files of skipped stages may have been deleted since they were written
    terminal.summary(options, results)
    if options.json:
        summary = {"capture": str(options.output_dir), **results["pack"], "doctor": results["doctor"]}
        sys.stdout.write(json.dumps(summary) + "\n")
    if options.strict and not results["doctor"]["healthy"]:
        raise GateError(f"{options.output_dir}: the doctor found a fault (--strict)")
    return 0
