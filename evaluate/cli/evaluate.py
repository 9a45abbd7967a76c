"""The command ggavatar-eval: scores, tables, figures, gates. Imports torch only for runs and learned metrics."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.console import Console

from evaluate.gates.baselines import label_of, write_baseline
from evaluate.gates.checks import Check
from evaluate.gates.limits import read_limits
from evaluate.gates.reports import append_step_summary, to_github, write_junit
from evaluate.metrics.catalogue import metric_of, title_of
from evaluate.metrics.plugged import is_failure
from evaluate.options import Options, parse
from evaluate.protocols.method_names import display_name
from evaluate.protocols.results import FRAMES_FILE, METRICS_FILE, Evaluation, read_results, write_results
from evaluate.scoring.accumulator import flat_notes
from evaluate.scoring.folders import score_folders
from evaluate.tables.format_terminal import show
from evaluate.tables.paper_aligned import parse_paper_subjects
from evaluate.tables.table import Table
from evaluate.tables.write import build_tables, write_copies, write_tables
from ggavatar.cli.given import A_CAPTURE, AN_AVATAR, EVALUATION, Expected, check_given
from ggavatar.cli.progress import announce_start, show_progress
from ggavatar.cli.run import run_command
from ggavatar.errors import GateError, InputError
from ggavatar.formats.avatar_suffix import is_avatar_file
from ggavatar.formats.source_options import is_gaussian_file, results_folder
from ggavatar.io.atomic import remove_partial_files
from ggavatar.io.folder_lock import lock_folder, lock_output
from ggavatar.io.held_folders import hold_folder
from ggavatar.text.terminal import write_err, write_out

TABLES = "table"
"""What tables and figures are locked as in their folder; a run may be trained meanwhile, under a lock of its own."""
SCORED = Expected({EVALUATION, *AN_AVATAR.kinds}, f"{AN_AVATAR.text}, an evaluation folder or a metrics.json")
WIDTH = 160
"""Width of a table that is not printed on a terminal, characters."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command and return its exit code: 0 done, 1 failed, 2 bad input, 3 a gate failed."""
    return run_command(lambda: _evaluate(parse(arguments)), Options)


def _evaluate(options: Options) -> int:
    """Evaluate; a run that is removed meanwhile does not come back as a folder with nothing but tables in it."""
    with ExitStack() as held:
        for run in (path for path in options.runs if path.is_dir()):
            held.enter_context(hold_folder(run))
        return _evaluate_all(options)


def _evaluate_all(options: Options) -> int:
    """Score the given runs or folders, write and print tables and figures, then check the gates."""
    _check_paths(options)
    console = Console(soft_wrap=True, width=None if sys.stdout.isatty() else WIDTH)
    limits = read_limits(options.gates)
    _check_paper_subjects(options)
    evaluated, written = _collect(options)
    evaluations = [one.evaluation for one in evaluated]
    _warn_of_worthless(evaluations)
    tables = build_tables(evaluations, options.layout, options.with_paper, options.paper_subjects)
    folder = _table_folder(options, evaluated)
    written += _write_tables(options, evaluated, tables, folder)
    if options.table:
        console.print()
        for table in (table for table in tables if table.name not in ("detail", "sources")):
            show(table, console)
    written += _reenact(options, folder, console)
    checks = limits.checks(evaluations)
    if options.gates.junit:
        write_junit(options.gates.junit, checks)
        written.append(options.gates.junit)
    if options.gates.write_baseline and all(check.passed for check in checks):
        write_baseline(options.gates.write_baseline, evaluations)
        written.append(options.gates.write_baseline)
    if not options.quiet:
        for one in evaluations:
            write_out(headline(one))
        for check in checks if not options.gates.github else ():
            write_out(f"{'pass' if check.passed else 'FAIL'} {check.case}: {check.message}")
        write_out(*(f"wrote {path}" for path in written))
    return _finish(options, evaluations, written, checks)


def _check_paths(options: Options) -> None:
    """Raise `InputError` for a path that is surely of the wrong kind."""
    for path in options.runs:
        check_given(path, SCORED)
    for capture in (options.source.capture, *options.reenact):
        if capture is not None:
            check_given(capture, A_CAPTURE)


def _reenact(options: Options, folder: Path, console: Console) -> list[Path]:
    """Drive the runs by the captures of --reenact, print what arrives, and return the files written."""
    if not options.reenact:
        return []
    from evaluate.reenactment.pairs import measure_pairs
    from evaluate.reenactment.table import reenactment_table, write_reenactments

    found = measure_pairs(options, lambda title: show_progress(title, options.quiet))
    if options.table or not options.quiet:
        console.print()
        show(reenactment_table(found), console)
    return write_reenactments(found, folder)


def _write_tables(options: Options, evaluated: list[Evaluated], tables: list[Table], folder: Path) -> list[Path]:
    """Write tables, the results behind them, and figures."""
    with lock_output(folder / TABLES):
        for name in (TABLES, "comparison", "report", METRICS_FILE, FRAMES_FILE):
            remove_partial_files(folder, begin=name)
        written = write_tables(tables, folder, _result_files(evaluated, bool(options.labels), folder))
        return written if options.no_report else written + _write_figures(options, evaluated, folder)


def _check_paper_subjects(options: Options) -> None:
    """Raise `InputError` for a subject that will not be in the table, before anything is rendered."""
    if options.paper_subjects:
        from evaluate.scoring.subjects import subjects_of

        parse_paper_subjects(options.paper_subjects, subjects_of(options))


def _warn_of_worthless(evaluations: Sequence[Evaluation]) -> None:
    """A line on stderr for predictions of one color and for metrics whose packages failed, even with --quiet."""
    for one in evaluations:
        for note in (*flat_notes(one), *filter(is_failure, one.missing.values())):
            write_err(f"warning: {label_of(one.subject, one.method, one.seed)}: {note}")


def _result_files(evaluated: Sequence[Evaluated], labels: bool, folder: Path) -> list[Path]:
    """The result files behind the tables: the single one scored or read, or copies of several beside the table."""
    if len(evaluated) != 1 or labels:
        return write_copies([one.evaluation for one in evaluated], folder)
    return [evaluated[0].results]


def _finish(options: Options, evaluations: list[Evaluation], written: list[Path], checks: list[Check]) -> int:
    """Print annotations and the summary line, and return the exit code."""
    if options.gates.github:
        sys.stdout.write(to_github(checks))
        append_step_summary(checks)
    if options.json:
        sys.stdout.write(json.dumps(_summary(evaluations, written, checks), allow_nan=False) + "\n")
    sys.stdout.flush()
    if failed := [check for check in checks if not check.passed]:
        raise GateError("; ".join(f"{check.case}: {check.message}" for check in failed))
    return 0


@dataclass(frozen=True)
class Evaluated:
    """An evaluation and where it lies.

    Attributes:
        evaluation: The scores.
        results: Its metrics.json.
        images: Folders of predictions and ground truth; None where they are those beside the results.
    """

    evaluation: Evaluation
    results: Path
    images: tuple[Path, Path] | None = None


@dataclass(frozen=True)
class ConsoleReporter:
    """Progress bars and warnings on stderr."""

    stack: ExitStack
    quiet: bool

    def progress(self, title: str) -> Callable[[int, int], None] | None:
        """A progress bar that ends with the stack."""
        return self.stack.enter_context(show_progress(title, self.quiet))

    def warn(self, text: str) -> None:
        """One line on stderr, even with --quiet."""
        write_err(f"warning: {text}")


def _collect(options: Options) -> tuple[list[Evaluated], list[Path]]:
    """Evaluations of the given runs, folders and pictures, and the files written for them."""
    if options.folders.pred and options.folders.gt:
        with show_progress("scoring", options.quiet) as progress:
            evaluation = score_folders(options, progress)
        folder = _table_folder(options)
        images = options.folders.pred, options.folders.gt
        with lock_output(folder / TABLES):
            return [Evaluated(evaluation, folder / METRICS_FILE, images)], write_results(evaluation, folder)
    found: list[Evaluated] = []
    written: list[Path] = []
    for path in options.runs:
        is_avatar = is_gaussian_file(path) or is_avatar_file(path)
        if not is_avatar and (path.is_file() or (path / METRICS_FILE).is_file()):
            found.append(_stored(path))
            continue
        announce_start(options.quiet)
        from evaluate.scoring.run import evaluate_run

        with ExitStack() as stack:
            evaluation, files = evaluate_run(path, options, ConsoleReporter(stack, options.quiet))
        found.append(Evaluated(evaluation, files[0]))
        written += files
    if options.labels:
        pairs = zip(found, options.labels, strict=True)
        found = [replace(one, evaluation=replace(one.evaluation, method=label)) for one, label in pairs]
    pictures, files = _collect_pictures(options)
    return found + pictures, written + files


def _stored(path: Path) -> Evaluated:
    """Stored scores; `InputError` if the images beside them are not those that were scored."""
    from evaluate.scoring.touched import require_untouched

    evaluation = read_results(path)
    results = path if path.is_file() else path / METRICS_FILE
    require_untouched(evaluation, results.parent)
    return Evaluated(evaluation, results)


def _collect_pictures(options: Options) -> tuple[list[Evaluated], list[Path]]:
    """Evaluations of pictures made elsewhere, and the files written for them."""
    if not options.folders.pred and not options.folders.pred_as:
        return [], []
    announce_start(options.quiet)
    from evaluate.scoring.pictures import evaluate_pictures, find_pictures

    found: list[Evaluated] = []
    written: list[Path] = []
    for pictures in find_pictures(options):
        with ExitStack() as stack:
            evaluation, files = evaluate_pictures(pictures, options, ConsoleReporter(stack, options.quiet))
        found.append(Evaluated(evaluation, files[0]))
        written += files
    return found, written


def _write_figures(options: Options, evaluated: Sequence[Evaluated], folder: Path) -> list[Path]:
    """Write report, comparison, video and curves of every evaluation with images, and comparisons of methods."""
    from evaluate.figures.evaluation_images import EvaluationImages
    from evaluate.figures.write import write_comparisons, write_figures

    found = []
    for one in evaluated:
        home = one.results.parent
        images = EvaluationImages.in_folder(one.evaluation, home)
        if one.images is not None:
            images = EvaluationImages(one.evaluation, *one.images)
        if images.predictions.is_dir() and images.truth.is_dir():
            found.append((one, images))
    written: list[Path] = []
    for one, images in found:
        home = one.results.parent
        with lock_folder(home), show_progress("drawing", options.quiet) as progress:
            _require_current(one)
            written += write_figures(images, home, progress)
    return written + write_comparisons([images for _, images in found], folder)


def _require_current(one: Evaluated) -> None:
    """Raise `InputError` if another command has scored other images in the same folder since this one did."""
    if read_results(one.results).hashes != one.evaluation.hashes:
        raise InputError(f"{one.results.parent}: another command has scored it again meanwhile; run this one again")


def _table_folder(options: Options, evaluated: Sequence[Evaluated] = ()) -> Path:
    """Output folder of the tables: that of the options, beside a single result, or `evaluation/`."""
    if options.output:
        return options.output
    if options.folders.pred and not options.folders.gt:
        return evaluated[0].results.parent  # PRED-evaluation/ has the tables of --gt
    if options.folders.pred:
        return options.folders.pred.resolve().parent / f"{options.folders.pred.resolve().name}-evaluation"
    if len(options.runs) == 1 and not options.folders.pred_as:
        path = results_folder(options.runs[0])
        return path.parent if path.is_file() else path
    return Path("evaluation")


def headline(evaluation: Evaluation) -> str:
    """One line on an evaluation: what was scored, how it was trained, and the means of the main table."""
    means = []
    for name in evaluation.protocol.table_metrics:
        mean, metric = evaluation.summary(name).mean, metric_of(name)
        means.append(f"{title_of(name)} {'–' if mean is None else f'{mean:.{metric.digits}f}'}")
    label = f"{evaluation.subject} · {display_name(evaluation.method)}"
    return f"scored {label} ({evaluation.setup.describe()}), {evaluation.protocol.id}: {', '.join(means)}"


def _summary(evaluations: Sequence[Evaluation], written: Sequence[Path], checks: Sequence[Check]) -> dict[str, Any]:
    """The JSON summary for a calling program."""
    found = [
        {
            "subject": e.subject,
            "method": e.method,
            "seed": e.seed,
            "setup": e.setup.as_dict(),
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
