"""What was scored: the frames of every evaluation and the digests of its images."""

from __future__ import annotations

from collections.abc import Sequence

from evaluate.protocols.method_names import display_name
from evaluate.protocols.results import Evaluation
from evaluate.tables.setups import COMPARED
from evaluate.tables.study import Study
from evaluate.tables.table import DASH, Cell, Column, Row, Table, missing_cell

DIGEST_CHARACTERS = 16
"""Leading characters of a SHA-256 that are printed; the cell's reason contains the full digest."""


def sources_table(study: Study) -> Table:
    """One row per evaluation: how it was trained, its test frames and the SHA-256 of predictions and ground truth."""
    titles = (*COMPARED, "test frames", "protocol digest", "renders", "ground truth")
    columns = tuple(Column(title) for title in titles)
    rows = tuple(Row(_label(run), _cells(run)) for run in study.evaluations)
    caption = f"What was scored under {study.protocol.id}: SHA-256 of the protocol and of the images."
    notes = (
        f"For images it is taken over the lines FRAME SHA256-OF-FILE in ascending order. Cut to {DIGEST_CHARACTERS} "
        "characters; metrics.json contains the full digests.",
    )
    return Table("sources", caption, "Evaluation", columns, rows, notes, protocol=study.protocol.id)


def _label(run: Evaluation) -> str:
    return f"{run.subject} · {display_name(run.method)}" + ("" if run.seed is None else f", seed {run.seed}")


def _cells(run: Evaluation) -> tuple[Cell, ...]:
    digests = [run.protocol.digest, *(run.hashes.get(kind, "") for kind in ("predictions", "ground_truth"))]
    known = [
        Cell(digest[:DIGEST_CHARACTERS], reason=digest) if digest else missing_cell("not recorded")
        for digest in digests
    ]
    facts = [Cell(run.setup.facts.get(name, DASH), reason=run.setup.describe()) for name in COMPARED]
    return *facts, Cell(ranges(run.frames, 8), reason=ranges(run.frames)), *known


def ranges(frames: Sequence[int], most: int | None = None) -> str:
    """Frame numbers with consecutive ones joined, such as 0, 20, 40–43; more than `most` parts are elided."""
    runs: list[list[int]] = []
    for frame in frames:
        if runs and frame == runs[-1][1] + 1:
            runs[-1][1] = frame
        else:
            runs.append([frame, frame])
    words = [str(first) if first == last else f"{first}–{last}" for first, last in runs]
    if most is None or len(words) <= most:
        return ", ".join(words)
    return ", ".join([*words[: most // 2], "…", *words[-most // 2 :]])
