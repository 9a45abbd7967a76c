"""Subjects of the evaluations that a call will make, known before anything is rendered or scored."""

from __future__ import annotations

from pathlib import Path

from evaluate.options import Options
from evaluate.protocols.results import METRICS_FILE, read_results
from evaluate.scoring.pictures import find_pictures
from ggavatar.data.capture import Capture
from ggavatar.formats.source_options import is_gaussian_file
from ggavatar.text.names import clean_name
from ggavatar.training.run_folder import find_capture, read_config


def subjects_of(options: Options) -> list[str]:
    """The subjects of the runs, folders and pictures of a call, without repetition.

    Raises:
        InputError: A run, a capture or a result cannot be read.
    """
    if options.folders.gt is not None:
        return [options.folders.subject or clean_name(options.folders.gt.resolve().parent.name)]
    found = [_subject(path, options) for path in options.runs]
    if options.folders.pred is not None or options.folders.pred_as:
        found += [options.folders.subject or one.capture.subject for one in find_pictures(options)]
    return list(dict.fromkeys(found))


def _subject(path: Path, options: Options) -> str:
    """The subject of a run, of stored scores, or of the capture of a file of Gaussians."""
    moved = options.source.capture
    if is_gaussian_file(path) and moved is not None:
        return Capture.open(moved).subject
    if path.is_file() or (path / METRICS_FILE).is_file():
        return read_results(path).subject
    config = read_config(path)
    return Capture.open(moved or find_capture(path, config)).subject
