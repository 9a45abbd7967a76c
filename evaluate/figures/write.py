"""Writes the figures of an evaluation: report, comparison, side-by-side video, curves, worst frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from evaluate.escaping.file_names import file_stem
from evaluate.figures.comparison import load_comparison_frame, typical_frames, write_comparison
from evaluate.figures.comparison_layout import comparison
from evaluate.figures.curves import write_curves
from evaluate.figures.evaluation_images import EvaluationImages, display_names
from evaluate.figures.report import write_report
from evaluate.figures.video import write_side_by_side
from evaluate.figures.worst_frames import write_worst_frames
from evaluate.protocols.results import METRICS_FILE
from ggavatar.io.images import write_png

REPORT, COMPARISON, VIDEO = "report.html", "comparison.png", "side_by_side.mp4"
CURVES, WORST = "curves.png", "worst.png"


def write_figures(
    evaluated: EvaluationImages, folder: Path, progress: Callable[[int, int], None] | None = None
) -> list[Path]:
    """Write the figures of one evaluation beside its metrics; files newer than the metrics are kept.

    Args:
        evaluated: The evaluation with its images.
        folder: Folder of metrics.json, and of the figures.
        progress: Called with (done, total) after every file.

    Returns:
        The files: report, comparison, side-by-side video, curves and worst frames, if there was anything to show.
    """
    (name,) = display_names([evaluated])
    writers: dict[str, Callable[[Path], object]] = {
        COMPARISON: lambda path: write_comparison(
            path, {name: evaluated.predictions}, evaluated.truth, focus=evaluated.face_masks
        ),
        VIDEO: lambda path: write_side_by_side(path, evaluated.predictions, evaluated.truth, evaluated.fps, name),
        CURVES: lambda path: write_curves(path, [evaluated]),
        WORST: lambda path: write_worst_frames(path, evaluated),
        REPORT: lambda path: write_report(path, [evaluated]),
    }
    for done, (file, write) in enumerate(writers.items(), start=1):
        if _outdated(folder / file, folder / METRICS_FILE):
            write(folder / file)
        if progress:
            progress(done, len(writers))
    return [folder / file for file in (REPORT, COMPARISON, VIDEO, CURVES, WORST) if (folder / file).is_file()]


def write_comparisons(evaluated: Sequence[EvaluationImages], folder: Path) -> list[Path]:
    """Write the figures that compare several evaluations.

    Args:
        evaluated: Evaluations of any subjects and protocols.
        folder: Output folder of `comparison-SUBJECT.png` and `report-SUBJECT.html` for each subject with several
            methods on the same frames, and of `comparison.png` with a row per subject if several have the same methods.

    Returns:
        The files written; none if nothing can be compared.
    """
    groups: dict[tuple[str, str, str], list[EvaluationImages]] = {}
    for one in evaluated:
        truth = one.evaluation.hashes.get("ground_truth", "")
        groups.setdefault((one.evaluation.subject, one.evaluation.protocol.id, truth), []).append(one)
    subjects = [subject for subject, _, _ in groups]
    written: list[Path] = []
    for (subject, protocol, truth), members in groups.items():
        stem = subject if subjects.count(subject) == 1 else f"{subject}-{protocol}-{truth[:6]}"
        if len(members) > 1:
            written += _write_method_comparison(members, folder, stem)
    return written + _write_subject_comparison(list(groups.values()), folder)


def _write_method_comparison(members: Sequence[EvaluationImages], folder: Path, stem: str) -> list[Path]:
    """Comparison and report of several methods on one subject."""
    figure, page = folder / f"comparison-{file_stem(stem)}.png", folder / f"report-{file_stem(stem)}.html"
    write_comparison(figure, _folders(members), members[0].truth, focus=members[0].face_masks)
    write_report(page, members)
    return [figure, page]


def _write_subject_comparison(groups: Sequence[Sequence[EvaluationImages]], folder: Path) -> list[Path]:
    """A hard frame of every subject with the same methods as the first (the layout of the paper's Fig. 3)."""
    comparable = [group for group in groups if display_names(group) == display_names(groups[0])]
    if len({group[0].evaluation.subject for group in comparable}) < 2:
        return []
    frames = []
    for group in comparable:
        methods, truth, subject = _folders(group), group[0].truth, group[0].evaluation.subject
        hard = list(typical_frames(methods, truth))[-1]
        frames.append(load_comparison_frame(hard, methods, truth, f"{subject}, frame {hard}", group[0].face_masks))
    write_png(folder / "comparison.png", comparison(frames))
    return [folder / "comparison.png"]


def _folders(members: Sequence[EvaluationImages]) -> dict[str, Path]:
    """Folders of predictions by display name."""
    return {name: one.predictions for name, one in zip(display_names(members), members, strict=True)}


def _outdated(path: Path, source: Path) -> bool:
    """Whether a file is missing or older than its source."""
    return not path.is_file() or not source.is_file() or path.stat().st_mtime_ns < source.stat().st_mtime_ns
