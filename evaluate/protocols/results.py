"""The result of one evaluation: a value in memory, `metrics.json` and `per_frame.csv` on disk (docs/evaluation.md)."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from evaluate.metrics.catalogue import metric_of
from evaluate.metrics.pixels import pooled_psnr
from evaluate.protocols.protocol import Protocol, protocol_from_dict
from evaluate.protocols.statistics import Summary, summarize
from ggavatar.errors import InputError
from ggavatar.io.atomic import write_atomically

SCHEMA, VERSION = "ggavatar-evaluation", 1
METRICS_FILE, FRAMES_FILE = "metrics.json", "per_frame.csv"
MAX_BYTES = 1 << 28

Value = float | None


@dataclass(frozen=True)
class Evaluation:
    """One method on one subject with one seed, scored under one protocol.

    Attributes:
        subject: Row of the table.
        method: Column of the table.
        protocol: What was measured.
        frames: FrameScores source frames, ascending.
        values: Per column one value a frame; infinite for identical images, None where there was nothing to measure.
        seed: Of the training run, if known.
        missing: Metrics without any value, with the reason.
        hashes: SHA-256 of predictions, ground truth and each kind of mask.
        weights: SHA-256 of the files of learned metrics.
        efficiency: What rendering and training cost.
        provenance: Where the pictures come from: run, checkpoint, step, versions.
        notes: What a reader must know, in sentences.
    """

    subject: str
    method: str
    protocol: Protocol
    frames: tuple[int, ...]
    values: Mapping[str, tuple[Value, ...]]
    seed: int | None = None
    missing: Mapping[str, str] = field(default_factory=dict)
    hashes: Mapping[str, str] = field(default_factory=dict)
    weights: Mapping[str, str] = field(default_factory=dict)
    efficiency: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def summary(self, name: str) -> Summary:
        """Summary of one metric over the frames; `psnr_pooled` has a mean only."""
        if name == "psnr_pooled":
            pooled = pooled_psnr(value for value in self.values.get("mse", ()) if value is not None)
            finite = pooled if pooled is not None and math.isfinite(pooled) else None
            return Summary(finite, None, None, None, len(self.frames), 0 if finite is not None else len(self.frames))
        return summarize(self.values.get(name, ()), metric_of(name).higher_is_better)

    @property
    def columns(self) -> tuple[str, ...]:
        """Metrics of the protocol in its order, the pooled PSNR after the last."""
        return (*self.protocol.columns, "psnr_pooled")

    def as_dict(self) -> dict[str, Any]:
        """Strict JSON values: no NaN, no infinity; identical frames are null and listed by number."""
        return {
            "schema": SCHEMA,
            "version": VERSION,
            "subject": self.subject,
            "method": self.method,
            "seed": self.seed,
            "protocol": {
                "id": self.protocol.id,
                "digest": self.protocol.digest,
                **self.protocol.as_dict(),
                **self.protocol.definitions(),
            },
            "summary": {name: self._summary_dict(name) for name in self.columns},
            "efficiency": dict(self.efficiency),
            "hashes": dict(self.hashes),
            "weights": dict(self.weights),
            "provenance": dict(self.provenance),
            "notes": list(self.notes),
            "identical": {name: self._where(name, infinite=True) for name in self.values},
            "unmeasured": {name: self._where(name, infinite=False) for name in self.values},
            "frames": list(self.frames),
            "per_frame": {name: [_finite(value) for value in column] for name, column in self.values.items()},
        }

    def _summary_dict(self, name: str) -> dict[str, Any]:
        found = {**asdict(self.summary(name)), "higher_is_better": metric_of(name).higher_is_better}
        return {**found, "missing": self.missing[name]} if name in self.missing else found

    def _where(self, name: str, infinite: bool) -> list[int]:
        """Frames whose value is infinite, or absent."""
        pairs = zip(self.frames, self.values[name], strict=True)
        return [n for n, value in pairs if (value is None) != infinite and _finite(value) is None]


def _finite(value: Value) -> Value:
    return value if value is not None and math.isfinite(value) else None


def write_results(evaluation: Evaluation, folder: Path) -> list[Path]:
    """Write `metrics.json` and `per_frame.csv` atomically, unrounded, and return their paths."""
    paths = [folder / METRICS_FILE, folder / FRAMES_FILE]
    for path, text in zip(paths, (to_json(evaluation.as_dict()), _to_csv(evaluation)), strict=True):
        write_text(path, text)
    return paths


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically in UTF-8."""
    write_atomically(path, lambda stream: stream.write(text.encode()))


def to_json(content: Mapping[str, Any]) -> str:
    """Strict JSON, readable, with lists of numbers on one line each."""
    lines = [f"  {json.dumps(key)}: {_block(value)}" for key, value in content.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _block(value: Any) -> str:
    """One top-level entry: a mapping has one line per key."""
    if not isinstance(value, Mapping) or not value:
        return json.dumps(value, allow_nan=False, ensure_ascii=False)
    inner = (f"    {json.dumps(k)}: {json.dumps(v, allow_nan=False, ensure_ascii=False)}" for k, v in value.items())
    return "{\n" + ",\n".join(inner) + "\n  }"


def _to_csv(evaluation: Evaluation) -> str:
    """One line a frame; identical frames read `inf`, absent values are empty."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["frame", *evaluation.values])
    for row, frame in enumerate(evaluation.frames):
        cells = [column[row] for column in evaluation.values.values()]
        writer.writerow([frame, *("" if cell is None else repr(float(cell)) for cell in cells)])
    return stream.getvalue()


def read_results(path: Path) -> Evaluation:
    """An evaluation from `metrics.json`, or from the folder that holds it.

    Raises:
        InputError: No such file, not a result file, or of a version this program does not know.
    """
    file = path / METRICS_FILE if path.is_dir() else path
    content = _load(file)
    if content.get("schema") != SCHEMA or content.get("version") != VERSION:
        found = f"{content.get('schema')!r} version {content.get('version')!r}"
        raise InputError(f"{file}: expected {SCHEMA!r} version {VERSION}, found {found}; score the pictures again")
    try:
        return _from_dict(content)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise InputError(f"{file}: a field is missing or has the wrong type ({error!r}); score again") from error


def _load(file: Path) -> dict[str, Any]:
    try:
        if file.stat().st_size > MAX_BYTES:
            raise InputError(f"{file}: a result file is not larger than {MAX_BYTES >> 20} MiB")
        content = json.loads(file.read_text(encoding="utf-8"), parse_constant=_refuse)
    except FileNotFoundError as error:
        raise InputError(f"{file}: no such file; run ggavatar-eval on the run first") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{file}: expected strict JSON, found something else ({error}); score again") from error
    if not isinstance(content, dict):
        raise InputError(f"{file}: expected a JSON object, found {type(content).__name__}; score again")
    return content


def _refuse(constant: str) -> float:
    raise ValueError(f"{constant} is not JSON")


def _from_dict(content: Mapping[str, Any]) -> Evaluation:
    frames = tuple(int(n) for n in content["frames"])
    identical = {name: set(numbers) for name, numbers in content["identical"].items()}
    values: dict[str, tuple[Value, ...]] = {}
    for name, column in content["per_frame"].items():
        infinite = identical.get(name, set())
        values[name] = tuple(math.inf if n in infinite else v for n, v in zip(frames, column, strict=True))
    summary = content["summary"]
    return Evaluation(
        subject=str(content["subject"]),
        method=str(content["method"]),
        protocol=protocol_from_dict(content["protocol"]),
        frames=frames,
        values=values,
        seed=content["seed"],
        missing={name: entry["missing"] for name, entry in summary.items() if "missing" in entry},
        hashes=content["hashes"],
        weights=content["weights"],
        efficiency=content["efficiency"],
        provenance=content["provenance"],
        notes=tuple(content["notes"]),
    )
