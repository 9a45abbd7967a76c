"""Everything to look at after an evaluation: report, comparison, side-by-side video, curves, worst frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from evaluate.comparison import write_comparison
from evaluate.curves import write_curves
from evaluate.report import write_report
from evaluate.results import METRICS_FILE
from evaluate.shown import Shown, names_of
from evaluate.video import write_side_by_side
from evaluate.worst import write_worst_frames

REPORT, COMPARISON, VIDEO, CURVES, WORST = (
    "report.html",
    "comparison.png",
    "side_by_side.mp4",
    "curves.png",
    "worst.png",
)


def write_visuals(shown: Shown, home: Path, progress: Callable[[int, int], None] | None = None) -> list[Path]:
    """Write what belongs to one evaluation beside its metrics; files newer than the metrics are kept.

    Args:
        shown: The evaluation with its pictures.
        home: Folder of metrics.json.
        progress: Called with (done, total) after every file.

    Returns:
        The files: report, comparison, side-by-side video, curves and worst frames, where there was something to draw.
    """
    (name,) = names_of([shown])
    writers: dict[str, Callable[[Path], object]] = {
        COMPARISON: lambda path: write_comparison(path, {name: shown.predictions}, shown.truth, focus=shown.faces),
        VIDEO: lambda path: write_side_by_side(path, shown.predictions, shown.truth, shown.fps, name),
        CURVES: lambda path: write_curves(path, [shown]),
        WORST: lambda path: write_worst_frames(path, shown),
        REPORT: lambda path: write_report(path, [shown]),
    }
    for done, (file, write) in enumerate(writers.items(), start=1):
        if _outdated(home / file, home / METRICS_FILE):
            write(home / file)
        if progress:
            progress(done, len(writers))
    return [home / file for file in (REPORT, COMPARISON, VIDEO, CURVES, WORST) if (home / file).is_file()]


def write_studies(shown: Sequence[Shown], folder: Path) -> list[Path]:
    """Write a comparison and a report for every subject that several methods were measured on in the same frames.

    Args:
        shown: Evaluations of any subjects and protocols.
        folder: Where `comparison-SUBJECT.png` and `report-SUBJECT.html` go; with the protocol where one subject
            has several.

    Returns:
        The files written; none where nothing can be compared.
    """
    groups: dict[tuple[str, str, str], list[Shown]] = {}
    for one in shown:
        truth = one.evaluation.hashes.get("ground_truth", "")
        groups.setdefault((one.evaluation.subject, one.evaluation.protocol.id, truth), []).append(one)
    written: list[Path] = []
    subjects = [subject for (subject, _, _), members in groups.items() if len(members) > 1]
    for (subject, protocol, truth), members in groups.items():
        if len(members) < 2:
            continue
        stem = subject if subjects.count(subject) == 1 else f"{subject}-{protocol}-{truth[:6]}"
        stem = "".join(letter if letter.isalnum() or letter in "-_.+=" else "_" for letter in stem)
        figure, page = folder / f"comparison-{stem}.png", folder / f"report-{stem}.html"
        folders = {name: one.predictions for name, one in zip(names_of(members), members, strict=True)}
        write_comparison(figure, folders, members[0].truth, focus=members[0].faces)
        write_report(page, members)
        written += [figure, page]
    return written


def _outdated(path: Path, source: Path) -> bool:
    """Whether a file is missing or older than what it was made from."""
    return not path.is_file() or not source.is_file() or path.stat().st_mtime_ns < source.stat().st_mtime_ns
