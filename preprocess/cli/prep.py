"""`ggavatar-prep`: from a portrait video to a capture.

Heavy modules are imported only after the arguments are parsed.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from ggavatar.cli.run import run_command
from ggavatar.cli.version import handle_version_flag
from ggavatar.errors import GateError
from preprocess.options import PrepOptions


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `ggavatar-prep`; returns the exit code."""
    return run_command(lambda: _prepare_resumable(_parse(sys.argv[1:] if arguments is None else arguments)))


def _parse(arguments: Sequence[str]) -> PrepOptions:
    import tyro

    given = _refine_as_value(_protect_dashed_paths(arguments))
    handle_version_flag("ggavatar-prep", given)
    return tyro.cli(PrepOptions, prog="ggavatar-prep", args=given, description=_description())


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


def _description() -> str:
    """The introduction of the help page."""
    from preprocess.formats.registry import importer_names

    return (
        "Make a capture from a portrait video: frames, crop, masks, tracking, and a check of the result.\n\n"
        f"Formats of --tracking: {', '.join(importer_names())}.\n"
        "Example: ggavatar-prep video.mp4 -o alice"
    )


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
