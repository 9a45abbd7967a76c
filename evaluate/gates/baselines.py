"""Earlier results to compare with: a run, an evaluation folder, metrics.json, or a file of means for a repository.

A baseline file (`ggavatar-baseline`, written by --write-baseline) holds the means of one or more evaluations, and what
they must be compared under: protocol, ground truth, preset, length and features.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evaluate.protocols.results import MAX_BYTES, METRICS_FILE, Evaluation, read_results
from evaluate.protocols.results import SCHEMA as RESULTS_SCHEMA
from evaluate.protocols.setup import Setup, setup_from_dict
from evaluate.scoring.touched import require_untouched
from ggavatar.errors import InputError
from ggavatar.io.folder_lock import lock_output
from ggavatar.io.json_files import read_json, write_json
from ggavatar.text.names import clean_name, clean_values

SCHEMA, VERSION = "ggavatar-baseline", 1


@dataclass(frozen=True)
class Baseline:
    """The means of an earlier evaluation.

    Attributes:
        subject: Row of the table.
        method: Column of the table.
        seed: Of the training, if known.
        setup: How the images came about.
        protocol: Id of the protocol.
        digest: Its SHA-256.
        ground_truth: SHA-256 of the ground truth; empty if unknown.
        means: By metric; None if all images were identical.
    """

    subject: str
    method: str
    seed: int | None
    setup: Setup
    protocol: str
    digest: str
    ground_truth: str
    means: Mapping[str, float | None]

    @property
    def label(self) -> str:
        """Subject and method, and the seed if known."""
        return label_of(self.subject, self.method, self.seed)

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON values."""
        return {**vars(self), "setup": self.setup.as_dict(), "means": dict(self.means)}


def label_of(subject: str, method: str, seed: int | None) -> str:
    """A name of an evaluation."""
    return f"{subject}/{method}" + ("" if seed is None else f"/seed {seed}")


def baseline_of(evaluation: Evaluation) -> Baseline:
    """The means of an evaluation."""
    summaries = {name: evaluation.summary(name) for name in evaluation.columns}
    return Baseline(
        evaluation.subject,
        evaluation.method,
        evaluation.seed,
        evaluation.setup,
        evaluation.protocol.id,
        evaluation.protocol.digest,
        evaluation.hashes.get("ground_truth", ""),
        {name: found.mean for name, found in summaries.items() if found.mean is not None or found.identical},
    )


def write_baseline(path: Path, evaluations: Sequence[Evaluation]) -> None:
    """Write the means of evaluations as a baseline file.

    Raises:
        InputError: Another process is writing it.
    """
    listed = [baseline_of(evaluation).as_dict() for evaluation in evaluations]
    with lock_output(path):
        write_json(path, {"schema": SCHEMA, "version": VERSION, "evaluations": listed})


def read_baselines(path: Path) -> list[Baseline]:
    """The earlier results at a path.

    Args:
        path: A run folder (all its evaluations), an evaluation folder, a folder of tables, metrics.json, or a file of
            --write-baseline.

    Raises:
        InputError: Nothing of the kind is there, or the images beside the scores are not those that were scored.
    """
    if not path.is_dir():
        return _read_file(path)
    own = [path / METRICS_FILE] if (path / METRICS_FILE).is_file() else []
    files = own + sorted(path.glob(f"eval/*/{METRICS_FILE}")) or sorted(path.glob("results/*.json"))
    if not files:
        raise InputError(
            f"{path}: expected a run that was scored, an evaluation folder or a {METRICS_FILE}, found neither; score "
            f"it first: ggavatar-eval {path}"
        )
    return [baseline for file in files for baseline in _read_file(file)]


def _read_file(path: Path) -> list[Baseline]:
    content = clean_values(read_json(path, MAX_BYTES))
    if content.get("schema") == RESULTS_SCHEMA:
        evaluation = read_results(path)
        require_untouched(evaluation, path.parent)
        return [baseline_of(evaluation)]
    if content.get("schema") != SCHEMA or content.get("version") != VERSION:
        found = f"{content.get('schema')!r} version {content.get('version')!r}"
        raise InputError(
            f"{path}: expected a {METRICS_FILE}, or a baseline ({SCHEMA!r} version {VERSION}), found {found}; write "
            "one with ggavatar-eval --write-baseline"
        )
    try:
        return [_from_dict(values) for values in content["evaluations"]]
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise InputError(
            f"{path}: a field is missing or has the wrong type ({error!r}); write it again with --write-baseline"
        ) from error


def _from_dict(values: Mapping[str, Any]) -> Baseline:
    names = {name: clean_name(str(values[name])) for name in ("subject", "method")}
    texts = {name: str(values[name]) for name in ("protocol", "digest", "ground_truth")}
    means = {str(name): None if mean is None else float(mean) for name, mean in values["means"].items()}
    seed = values["seed"] if values["seed"] is None else int(values["seed"])
    return Baseline(seed=seed, setup=setup_from_dict(values["setup"]), means=means, **names, **texts)
