"""`ggavatar-doctor`: examine an existing capture, or this computer."""

from __future__ import annotations

import errno
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from ggavatar.cli.given import A_CAPTURE, check_given
from ggavatar.cli.page import CommandPage, parse
from ggavatar.cli.progress import announce_start
from ggavatar.cli.run import run_command
from ggavatar.errors import GateError, InputError
from ggavatar.text.clocked_lines import waiting
from ggavatar.text.terminal import write_out

if TYPE_CHECKING:
    from ggavatar.data.capture import Capture
    from ggavatar.head.model import HeadModel
    from preprocess.doctor.diagnosis import Diagnosis


@dataclass(frozen=True)
class DoctorOptions:
    """Report what is wrong with a capture and which flag fixes it, or what this computer has."""

    capture: tyro.conf.Positional[Path | None] = None
    """Capture folder to examine; not with --environment."""

    environment: bool = False
    """Report on this computer instead: versions, device, rasterizers, model files, caches, what is missing."""

    strict: bool = False
    """Exit with code 3 if the doctor finds a fault."""

    json: bool = False
    """Print the whole report as JSON."""

    dry_run: bool = False
    """Write nothing into the capture folder."""


PAGE = CommandPage(
    program="ggavatar-doctor",
    options=DoctorOptions,
    summary=(
        "Report what is wrong with a capture and which flag fixes it, and write doctor.json and preview.jpg into "
        "it; or report on this computer."
    ),
    examples=(
        ("ggavatar-doctor captures/alice", "the findings, worst first, and the flags that fix them"),
        ("ggavatar-doctor captures/alice --strict --dry-run", "for a script: exit code 3 for a fault, nothing written"),
        ("ggavatar-doctor --environment", "what this computer has for the commands, and what is missing"),
    ),
    groups={"another report": ("environment",), "what is done with the report": ("strict", "json", "dry_run")},
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `ggavatar-doctor`; returns the exit code."""
    return run_command(lambda: _examine(parse(PAGE, arguments)), DoctorOptions)


def _write(capture: Capture, head: HeadModel, diagnosis: Diagnosis) -> None:
    """Write report and preview into the capture."""
    from ggavatar.io.folder_lock import lock_folder
    from preprocess.doctor.diagnosis import write_report
    from preprocess.doctor.preview import write_preview

    try:
        with lock_folder(capture.folder):
            write_report(capture, diagnosis)
            write_preview(capture, head)
    except OSError as error:
        if error.errno not in (errno.EACCES, errno.EPERM, errno.EROFS):
            raise
        what = f"{capture.folder}: cannot be written ({error.strerror})"
        raise OSError(f"{what}; add --dry-run to examine it without writing") from error


def _examine_environment(options: DoctorOptions) -> int:
    """Print what this computer has."""
    import json

    if options.capture is not None or options.strict or options.dry_run:
        raise InputError("--environment examines this computer; leave out CAPTURE, --strict and --dry-run")
    announce_start(options.json)
    from ggavatar.cli.environment import environment, environment_lines

    with waiting("examining", options.json):
        report = environment()
    if options.json:
        sys.stdout.write(json.dumps(report) + "\n")
    else:
        write_out(*environment_lines(report))
    return 0


def _examine(options: DoctorOptions) -> int:
    import json

    if options.environment:
        return _examine_environment(options)
    if options.capture is None:
        raise InputError(
            "expected CAPTURE (capture folder to examine) or --environment, found neither; see ggavatar-doctor --help"
        )
    check_given(options.capture, A_CAPTURE)
    announce_start(options.json)
    from ggavatar.data.capture import Capture
    from ggavatar.head.files import load_head
    from preprocess.cli.terminal import report_lines
    from preprocess.doctor.diagnosis import examine

    capture = Capture.open(options.capture)
    head = load_head(capture.head_path)
    with waiting("examining", options.json):
        diagnosis = examine(capture, head)
    if not options.dry_run:
        _write(capture, head, diagnosis)
    if options.json:
        sys.stdout.write(json.dumps(diagnosis.json(), default=float) + "\n")
    else:
        write_out(*report_lines(diagnosis.json()))
    if options.strict and not diagnosis.healthy:
        raise GateError(f"{options.capture}: the doctor found a fault (--strict)")
    return 0
