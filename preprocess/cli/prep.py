"""`ggavatar-prep`: from a portrait video to a capture.

Nothing heavy is imported before the arguments are understood.
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
    """Entry point; returns the exit code."""
    import tyro

    given = _dashed_paths(sys.argv[1:] if arguments is None else arguments)
    handle_version_flag("ggavatar-prep", given)
    options = tyro.cli(PrepOptions, prog="ggavatar-prep", args=given, description=_description())
    return run_command(lambda: _prepared(options))


def _dashed_paths(arguments: Sequence[str]) -> list[str]:
    """Files that exist under a name with a leading dash, and an output folder with one, are made to look like paths."""
    result: list[str] = []
    for argument in arguments:
        after_output = bool(result) and result[-1] in ("-o", "--output-dir")
        dashed = argument.startswith("-") and (
            Path(argument).exists() or (after_output and not argument.startswith("--"))
        )
        result.append(f"./{argument}" if dashed else argument)
    return result


def _description() -> str:
    """What the help page says first."""
    from preprocess.formats.registry import importer_names

    return (
        "Make a capture from a portrait video: frames, crop, masks, tracking, and a check of all of it.\n\n"
        f"Formats of --tracking: {', '.join(importer_names())}.\n"
        "Example: ggavatar-prep video.mp4 -o alice"
    )


def _prepared(options: PrepOptions) -> int:
    """Prepare; whoever interrupts is told how to go on."""
    try:
        return _prepare(options)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("what is finished is kept; the same command with --resume goes on") from None


def _prepare(options: PrepOptions) -> int:
    """Run the pipeline and say what was written."""
    # The fit's matrices are small, and our own threads keep the cores busy: OpenBLAS's would only be in the way.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from ggavatar.data.capture import Capture
    from preprocess.cli.terminal import Terminal
    from preprocess.pipeline.pipeline import run_pipeline

    terminal = Terminal(options.quiet or options.json)
    results = run_pipeline(options, terminal.stage)
    Capture.open(options.output_dir)  # what stages skipped may have lost pictures since they were written
    terminal.summary(options, results)
    if options.json:
        shown = {"capture": str(options.output_dir), **results["pack"], "doctor": results["doctor"]}
        sys.stdout.write(json.dumps(shown) + "\n")
    if options.strict and not results["doctor"]["healthy"]:
        raise GateError(f"{options.output_dir}: the doctor found a fault (--strict)")
    return 0
