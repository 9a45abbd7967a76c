"""Tables of results, and videos."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import UInt8

from evaluate.figures.video import video_writer
from evaluate.protocols.results import Evaluation
from evaluate.tables import write
from evaluate.tables.table import Table
from ggavatar.api.options import check_value
from ggavatar.errors import InputError
from ggavatar.text.names import clean_name


def make_tables(
    evaluations: Sequence[Evaluation],
    layout: str = "auto",
    with_paper: bool = False,
    paper_subjects: Mapping[str, str] | None = None,
    labels: Sequence[str] = (),
) -> list[Table]:
    """The tables of some evaluations, as `ggavatar-eval` makes them: first the main one, then details.

    Args:
        evaluations: In the order in which subjects and methods appear.
        layout: `subjects` (the paper's Table 1), `ablation` (its Table 2), or `auto`.
        with_paper: Add the paper's rows below ours; its protocol is not stated.
        paper_subjects: The paper's subject for each of ours; its numbers then stand in the same lines, marked.
        labels: Names of the methods, one for each evaluation; their own if not given.

    Raises:
        InputError: Two evaluations of one subject, method, seed and protocol, or an unknown subject.
    """
    check_value("make_tables(layout=…)", layout, Literal["auto", "subjects", "ablation"])
    if labels and len(labels) != len(evaluations):
        raise InputError(f"expected one label for each of {len(evaluations)} evaluations, found {len(labels)}")
    if labels:
        pairs = zip(evaluations, labels, strict=True)
        evaluations = [dataclasses.replace(one, method=clean_name(label)) for one, label in pairs]
    pairs_of_subjects = [f"{ours}={theirs}" for ours, theirs in (paper_subjects or {}).items()]
    return write.build_tables(evaluations, layout, with_paper, pairs_of_subjects)


def write_tables(tables: Sequence[Table], folder: Path | str) -> list[Path]:
    """Write table.md, .tex, .csv, .json and .html and return their paths.

    Args:
        tables: Tables of `make_tables`.
        folder: Where to write them; it is made if it is missing.
    """
    return write.write_tables(tables, Path(folder), [])


def write_video(path: Path | str, images: UInt8[np.ndarray, "N H W 3"], fps: float = 25.0) -> Path:
    """Write images as an MP4 video (H.264) that browsers play, and return its path.

    Args:
        path: The file.
        images: 8-bit sRGB, at least one.
        fps: Frames per second, above 0.

    Raises:
        InputError: There is no image, or `fps` is not above 0.
    """
    if not fps > 0:
        raise InputError(f"write_video(fps=…): expected frames per second above 0, found {fps:g}")
    with video_writer(Path(path), fps) as append:
        for image in images:
            append(image)
    return Path(path)
