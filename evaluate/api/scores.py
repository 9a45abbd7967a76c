"""Scores of runs and of images, under a stated protocol."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack

from evaluate.metrics.catalogue import find_metric, metric_names
from evaluate.metrics.metric import Metric
from evaluate.options import Folders, Options, Override
from evaluate.protocols.results import Evaluation, read_results
from evaluate.scoring.folders import score_folders as score_image_folders
from evaluate.scoring.pictures import Pictures, evaluate_pictures
from evaluate.scoring.run import evaluate_run
from ggavatar.api.options import check_options
from ggavatar.cli.progress import show_progress
from ggavatar.data.capture import Capture
from ggavatar.data.capture_without_images import CaptureWithoutImages
from ggavatar.errors import InputError
from ggavatar.formats.source_options import GaussianFileOptions
from ggavatar.text.names import clean_name
from ggavatar.training.run_folder import Run

_OVERRIDES = ("split", "background", "mask", "region", "resolution", "metrics", "table_metrics", "regions")


class ScoreOptions(TypedDict, total=False):
    """How images are scored; what is left out is the protocol's."""

    protocol: str
    """paper, strict, insta-350, flash-500, imavatar-face256, gaussian-avatars or folders; auto goes by the split."""
    metrics: Sequence[str]
    """Names of `list_metrics()`."""
    table_metrics: Sequence[str]
    """Those of the main table."""
    regions: Sequence[str]
    """Regions measured in addition: face, mouth, eyes, hair, boundary, foreground."""
    region: str
    """Measure only inside this region."""
    split: str
    """Name of the split whose test frames are scored."""
    background: str
    """white, black, or R,G,B from 0 to 1."""
    mask: Literal["as-stored", "binary"]
    """as-stored or binary."""
    resolution: str
    """WIDTHxHEIGHT in px, or native."""
    learned: bool
    """Whether to measure with networks (LPIPS, faces); True."""
    device: str
    """Device on which runs are rendered."""
    threads: int
    """Threads for scoring."""
    again: bool
    """Render and score again even if the results are up to date."""
    progress: bool
    """Show the progress."""


def score_run(
    run: Run | Path | str, capture: Capture | Path | str | None = None, **options: Unpack[ScoreOptions]
) -> Evaluation:
    """Render the test frames of a run and score them, as `ggavatar-eval RUN` does.

    Results are kept in `RUN/eval/PROTOCOL/` and read from there while nothing has changed.

    Args:
        run: The run or its folder, or a file of Gaussians with its capture.
        capture: Where the capture is, if it was moved, or with a file of Gaussians.
        **options: As in `ScoreOptions`.

    Raises:
        InputError: It is no run, or the protocol cannot be applied to it.
    """
    folder = run.folder if isinstance(run, Run) else Path(run)
    place = _folder(capture)
    if isinstance(run, Run):
        if isinstance(run.capture, CaptureWithoutImages):
            raise InputError(
                f"{run.folder}: expected a run, found an avatar file, which holds no photographs to compare with; "
                "score the run that it was made of"
            )
        place = place or run.capture.folder
    chosen = _options("score_run", dict(options), source=GaussianFileOptions(capture=place))
    with contextlib.ExitStack() as stack:
        return evaluate_run(folder, chosen, _Reporter(stack, chosen.quiet))[0]


def score_pictures(
    pictures: Path | str, capture: Capture | Path | str, label: str | None = None, **options: Unpack[ScoreOptions]
) -> Evaluation:
    """Score images that any program has rendered as a run of their capture is scored, as `--pred --capture` does.

    Args:
        pictures: Folder of images named by source frame number.
        capture: The capture that they show.
        label: Name of the method in tables; that of the folder if not given.
        **options: As in `ScoreOptions`.

    Raises:
        InputError: Frames are missing, or an image has another size than the ground truth.
    """
    folder = Path(pictures)
    opened = capture if isinstance(capture, Capture) else Capture.open(capture)
    name = clean_name(label or folder.resolve().name)
    chosen = _options("score_pictures", dict(options), folders=Folders(pred=folder, method=name))
    with contextlib.ExitStack() as stack:
        reporter = _Reporter(stack, chosen.quiet)
        return evaluate_pictures(Pictures(name, folder, opened), chosen, reporter)[0]


def score_folders(
    predictions: Path | str,
    truth: Path | str,
    masks: Path | str | None = None,
    label: str | None = None,
    subject: str | None = None,
    **options: Unpack[ScoreOptions],
) -> Evaluation:
    """Score a folder of images against a folder of ground truth, as `--pred --gt` does; nothing is written.

    Args:
        predictions: Images named by frame number.
        truth: Images of the same names.
        masks: Masks of the person.
        label: Name of the method in tables; that of the folder if not given.
        subject: Name of the subject; that of the folder above the ground truth if not given.
        **options: As in `ScoreOptions`.

    Raises:
        InputError: The folders do not fit together, or an image is damaged.
    """
    folders = Folders(
        pred=Path(predictions),
        gt=Path(truth),
        masks=None if masks is None else Path(masks),
        method=None if label is None else clean_name(label),
        subject=None if subject is None else clean_name(subject),
    )
    chosen = _options("score_folders", dict(options), folders=folders)
    with show_progress("scoring", chosen.quiet) as progress:
        return score_image_folders(chosen, progress)


def read_scores(path: Path | str) -> Evaluation:
    """Read an evaluation that was written before.

    Args:
        path: A `metrics.json`, or the folder that holds it.

    Raises:
        InputError: There is none, or it is damaged.
    """
    return read_results(Path(path))


def list_metrics() -> dict[str, Metric]:
    """The definitions of all metrics by name, those of installed plug-ins included; one that is broken is left out."""
    found: dict[str, Metric] = {}
    for name in metric_names():
        try:
            metric = find_metric(name)
        except InputError as error:
            warnings.warn(str(error), stacklevel=2)
            continue
        if metric is not None:
            found[name] = metric
    return found


def _folder(capture: Capture | Path | str | None) -> Path | None:
    if isinstance(capture, Capture):
        return capture.folder
    return None if capture is None else Path(capture)


def _options(function: str, given: dict[str, Any], **parts: Any) -> Options:
    """The options of ggavatar-eval for those of a function; quiet unless progress is asked for."""
    check_options(function, given, ScoreOptions)
    changes = {name: given[name] for name in _OVERRIDES if name in given}
    for name in ("metrics", "table_metrics", "regions"):
        if name in changes:
            changes[name] = tuple(changes[name])
    return Options(
        protocol=given.get("protocol", "auto"),
        override=Override(**changes),
        no_learned=not given.get("learned", True),
        device=given.get("device", "auto"),
        threads=given.get("threads"),
        again=bool(given.get("again")),
        quiet=not given.get("progress", False),
        **parts,
    )


class _Reporter:
    """Progress if it is asked for; what the command warns of are Python's warnings."""

    def __init__(self, stack: contextlib.ExitStack, quiet: bool) -> None:
        self._stack, self._quiet = stack, quiet

    def progress(self, title: str) -> Any:
        """A progress bar that ends with the stack."""
        return self._stack.enter_context(show_progress(title, self._quiet))

    def warn(self, text: str) -> None:
        """A warning, which `warnings.filterwarnings` can hide."""
        warnings.warn(text, stacklevel=2)
