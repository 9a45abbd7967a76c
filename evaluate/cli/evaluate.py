"""The command ggavatar-eval: scores, tables, figures, gates. Imports torch only for runs and learned metrics."""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from rich.console import Console

from evaluate.gates.checks import Check, to_github, write_junit
from evaluate.gates.limits import read_limits
from evaluate.options import Options, parse
from evaluate.protocols.protocol import Protocol
from evaluate.protocols.results import METRICS_FILE, Evaluation, read_results, write_results
from evaluate.scoring.frame_pairs import pair_folders
from evaluate.scoring.score import Labels, face_metrics, learned_metrics, score
from evaluate.tables.format_terminal import show
from evaluate.tables.write import build_tables, write_copies, write_tables
from ggavatar.cli.progress import show_progress
from ggavatar.cli.run import run_command
from ggavatar.errors import GateError, InputError
from ggavatar.formats.source_options import is_gaussian_file, results_folder
from ggavatar.pretrained.resolve import ModelFinder

WIDTH = 160
"""Width of a table that is not printed on a terminal, characters."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command and return its exit code: 0 done, 1 failed, 2 bad input, 3 a gate failed."""
    return run_command(lambda: _evaluate(parse(arguments)))


def _evaluate(options: Options) -> int:
    """Score the given runs or folders, write and print tables and figures, then check the gates."""
    console = Console(soft_wrap=True, width=None if sys.stdout.isatty() else WIDTH)
    limits = read_limits(options.gates)
    evaluations, written = _collect(options)
    tables = build_tables(evaluations, options.layout, options.with_paper)
    folder = _table_folder(options)
    written += write_tables(tables, folder, _result_files(options, evaluations, folder))
    if not options.no_report:
        written += _write_figures(options, evaluations, folder)
    if options.table:
        console.print()
        for table in (table for table in tables if table.name not in ("detail", "sources")):
            show(table, console)
    checks = limits.checks(evaluations)
    if options.gates.junit:
        write_junit(options.gates.junit, checks)
        written.append(options.gates.junit)
    if not options.quiet:
        for check in checks if not options.gates.github else ():
            console.print(f"{'pass' if check.passed else 'FAIL'} {check.case}: {check.message}", markup=False)
        for path in written:
            console.print(f"wrote {path}", markup=False, highlight=False)
    return _finish(options, evaluations, written, checks)


def _result_files(options: Options, evaluations: Sequence[Evaluation], folder: Path) -> list[Path]:
    """The result files behind the tables: the single one scored or read, or copies of several beside the table."""
    if len(evaluations) != 1 or options.labels:
        return write_copies(evaluations, folder)
    if options.folders.pred:
        return [folder / METRICS_FILE]
    path = results_folder(options.runs[0])
    return [path if path.is_file() else _metrics_folder(path, evaluations[0]) / METRICS_FILE]


def _finish(options: Options, evaluations: list[Evaluation], written: list[Path], checks: list[Check]) -> int:
    """Print annotations and the summary line, and return the exit code."""
    if options.gates.github:
        sys.stdout.write(to_github(checks))
    if options.json:
        sys.stdout.write(json.dumps(_summary(evaluations, written, checks), allow_nan=False) + "\n")
    sys.stdout.flush()
    if failed := [check for check in checks if not check.passed]:
        raise GateError("; ".join(f"{check.case}: {check.message}" for check in failed))
    return 0


def _collect(options: Options) -> tuple[list[Evaluation], list[Path]]:
    """Evaluations of the given runs or folders, and the files written for them."""
    if options.folders.pred:
        with show_progress("scoring", options.quiet) as progress:
            evaluation = score_folders(options, progress)
        return [evaluation], write_results(evaluation, _table_folder(options))
    evaluations: list[Evaluation] = []
    written: list[Path] = []
    for path in options.runs:
        if not is_gaussian_file(path) and (path.is_file() or (path / METRICS_FILE).is_file()):
            evaluations.append(read_results(path))
            continue
        from evaluate.scoring.run import evaluate_run

        with ExitStack() as stack:
            evaluation, files = evaluate_run(
                path, options, lambda title: stack.enter_context(show_progress(title, options.quiet))
            )
        evaluations.append(evaluation)
        written += files
    if options.labels:
        pairs = zip(evaluations, options.labels, strict=True)
        evaluations = [dataclasses.replace(evaluation, method=label) for evaluation, label in pairs]
    return evaluations, written


def score_folders(options: Options, progress: Callable[[int, int], None] | None = None) -> Evaluation:
    """Score the folders of --pred and --gt; `InputError` on any mismatch."""
    folders = options.folders
    if folders.pred is None or folders.gt is None:
        raise InputError("expected --pred and --gt")
    protocol = folder_protocol(options)
    pairs = pair_folders(folders.pred, folders.gt, folders.masks, folders.region_masks)
    names = folders.subject or folders.gt.resolve().parent.name, folders.method or folders.pred.resolve().name
    provenance = {"predictions": str(folders.pred), "ground_truth": str(folders.gt)}
    labels = Labels(*names, seed=folders.seed, provenance=provenance)
    models = ModelFinder(options.models, options.offline)
    learned = None if options.no_learned else learned_metrics(protocol, models)
    faces = None if options.no_learned else face_metrics(protocol, models)
    return score(pairs, protocol, labels, learned, faces, options.threads, progress)


def folder_protocol(options: Options) -> Protocol:
    """The protocol for two folders: fields that they cannot prove are `given`, regions are those with masks."""
    protocol = options.base_protocol()
    if protocol.name != "folders":
        protocol = protocol.override(split="given", resolution="given", mask="given")
    folders = options.folders
    if options.override.regions is not None:
        return protocol
    known: tuple[str, ...] = ("foreground", "boundary") if folders.masks else ()
    if folders.region_masks and folders.region_masks.is_dir():
        known += tuple(sorted(path.name for path in folders.region_masks.iterdir() if path.is_dir()))
    return protocol.override(regions=known)


def _write_figures(options: Options, evaluations: Sequence[Evaluation], folder: Path) -> list[Path]:
    """Write report, comparison, video and curves of every evaluation with images, and comparisons of methods."""
    from evaluate.figures.evaluation_images import EvaluationImages
    from evaluate.figures.write import write_comparisons, write_figures

    if options.folders.pred and options.folders.gt:
        found = [(folder, EvaluationImages(evaluations[0], options.folders.pred, options.folders.gt))]
    else:
        folders = [_metrics_folder(path, one) for path, one in zip(options.runs, evaluations, strict=True)]
        found = [
            (metrics_folder, images)
            for metrics_folder, one in zip(folders, evaluations, strict=True)
            if (images := EvaluationImages.in_folder(one, metrics_folder)).predictions.is_dir()
            and images.truth.is_dir()
        ]
    written: list[Path] = []
    for metrics_folder, images in found:
        with show_progress("drawing", options.quiet) as progress:
            written += write_figures(images, metrics_folder, progress)
    return written + write_comparisons([images for _, images in found], folder)


def _metrics_folder(path: Path, evaluation: Evaluation) -> Path:
    """Folder of the metrics of a command-line argument."""
    path = results_folder(path)
    if path.is_file():
        return path.parent
    return path if (path / METRICS_FILE).is_file() else path / "eval" / evaluation.protocol.id


def _table_folder(options: Options) -> Path:
    """Output folder of the tables: that of the options, beside a single result, or `evaluation/`."""
    if options.output:
        return options.output
    if options.folders.pred:
        return options.folders.pred.resolve().parent / f"{options.folders.pred.resolve().name}-evaluation"
    if len(options.runs) == 1:
        path = results_folder(options.runs[0])
        return path.parent if path.is_file() else path
    return Path("evaluation")


def _summary(evaluations: Sequence[Evaluation], written: Sequence[Path], checks: Sequence[Check]) -> dict[str, Any]:
    """The JSON summary for a calling program."""
    found = [
        {
            "subject": e.subject,
            "method": e.method,
            "seed": e.seed,
            "protocol": e.protocol.id,
            "digest": e.protocol.digest,
            "frames": len(e.frames),
            "metrics": {name: e.summary(name).mean for name in e.columns},
            "missing": dict(e.missing),
        }
        for e in evaluations
    ]
    failed = [{"case": check.case, "message": check.message} for check in checks if not check.passed]
    return {"evaluations": found, "files": [str(path) for path in written], "failed": failed}
