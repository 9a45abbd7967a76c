"""The result of one evaluation, in memory and as `metrics.json` and `per_frame.csv` (docs/evaluation.md)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import NoneType
from typing import Any

from evaluate.escaping.csv_cells import csv_text
from evaluate.metrics.catalogue import metric_of
from evaluate.metrics.pixels import pooled_psnr
from evaluate.protocols.protocol import Protocol, protocol_from_dict
from evaluate.protocols.setup import Setup, setup_from_dict
from evaluate.protocols.statistics import Summary, summarize
from ggavatar.errors import InputError
from ggavatar.io.atomic import write_text
from ggavatar.io.json_files import read_json, readable_json, sealed
from ggavatar.io.regular_files import read_file
from ggavatar.text.names import clean_name, clean_values

SCHEMA, VERSION = "ggavatar-evaluation", 1
METRICS_FILE, FRAMES_FILE = "metrics.json", "per_frame.csv"
MAX_BYTES = 1 << 28
"""Limit of metrics.json, which holds every metric of every frame (256 MiB)."""

Value = float | None


@dataclass(frozen=True)
class Evaluation:
    """One method on one subject with one seed, scored under one protocol.

    Attributes:
        subject: Row of the table.
        method: Column of the table.
        protocol: What was measured.
        frames: Scored source frames, ascending.
        values: One value per frame by column; infinite for identical images, None where nothing could be measured.
        seed: Of the training run, if known.
        missing: Reasons by metric that has no value.
        hashes: SHA-256 of predictions, ground truth and each kind of mask.
        weights: SHA-256 of the files of learned metrics.
        efficiency: What rendering and training cost.
        provenance: Where the images come from: run, checkpoint, step, versions.
        notes: Remarks for the reader, as sentences.
        setup: How the images came about: preset, length, features of the perceptual loss.
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
    setup: Setup = field(default_factory=Setup)

    def __repr__(self) -> str:
        """What was scored, and the means of the main table."""
        found = ((metric_of(name), self.summary(name).mean) for name in self.protocol.table_metrics)
        means = [f"{metric.title} {'–' if mean is None else f'{mean:.{metric.digits}f}'}" for metric, mean in found]
        what = f"{self.subject!r}, {self.method!r}, {self.protocol.id}, {len(self.frames)} frames"
        return f"Evaluation({what}: {', '.join(means)})"

    def summary(self, name: str) -> Summary:
        """Summary of one metric over the frames; `psnr_pooled` has only a mean."""
        if name == "psnr_pooled":
            pooled = pooled_psnr(value for value in self.values.get("mse", ()) if value is not None)
            finite = pooled if pooled is not None and math.isfinite(pooled) else None
            return Summary(finite, None, None, None, len(self.frames), 0 if finite is not None else len(self.frames))
        return summarize(self.values.get(name, ()), metric_of(name).higher_is_better)

    @property
    def columns(self) -> tuple[str, ...]:
        """Metrics in the order of the protocol, followed by the pooled PSNR."""
        return (*self.protocol.columns, "psnr_pooled")

    def as_dict(self) -> dict[str, Any]:
        """Strict JSON values without NaN or infinity; values of identical frames are null, their numbers listed."""
        return {
            "schema": SCHEMA,
            "version": VERSION,
            "subject": self.subject,
            "method": self.method,
            "seed": self.seed,
            "setup": self.setup.as_dict(),
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
    """Write `metrics.json` and `per_frame.csv`, unrounded and atomically, and return their paths."""
    paths = [folder / METRICS_FILE, folder / FRAMES_FILE]
    for path, text in zip(paths, (to_json(sealed(evaluation.as_dict())), _to_csv(evaluation)), strict=True):
        write_text(path, text)
    return paths


def restore_frames(evaluation: Evaluation, folder: Path) -> bool:
    """Write `per_frame.csv` again where it does not hold the values of the evaluation; whether that was so."""
    path, text = folder / FRAMES_FILE, _to_csv(evaluation)
    try:
        if read_file(path, MAX_BYTES, "a table of values") == text.encode():
            return False
    except InputError:
        pass
    write_text(path, text)
    return True


def to_json(content: Mapping[str, Any]) -> str:
    """Strict, readable JSON with each list of numbers on one line."""
    lines = [f"  {readable_json(key)}: {_block(value)}" for key, value in content.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _block(value: Any) -> str:
    """One top-level value: a mapping has one line per key."""
    if not isinstance(value, Mapping) or not value:
        return readable_json(value)
    inner = (f"    {readable_json(name)}: {readable_json(entry)}" for name, entry in value.items())
    return "{\n" + ",\n".join(inner) + "\n  }"


def _to_csv(evaluation: Evaluation) -> str:
    """One line per frame; `inf` for identical images, empty for absent values."""
    columns = list(zip(*evaluation.values.values(), strict=True)) or [() for _ in evaluation.frames]
    lines = [
        (str(frame), *(None if cell is None else float(cell) for cell in cells))
        for frame, cells in zip(evaluation.frames, columns, strict=True)
    ]
    return csv_text([("frame", *evaluation.values), *lines])


def read_results(path: Path) -> Evaluation:
    """Read an evaluation from `metrics.json` or the folder that contains it.

    Raises:
        InputError: No such file, not a result file, or an unknown version.
    """
    file = path / METRICS_FILE if path.is_dir() else path
    try:
        content = clean_values(read_json(file, MAX_BYTES))
    except InputError as error:
        raise InputError(f"{error}; score the images with ggavatar-eval first") from error
    if content.get("schema") != SCHEMA or content.get("version") != VERSION:
        found = f"{content.get('schema')!r:.60} version {content.get('version')!r:.60}"
        raise InputError(f"{file}: expected {SCHEMA!r} version {VERSION}, found {found}; score the images again")
    try:
        return _from_dict(content)
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise InputError(
            f"{file}: a field is missing or has the wrong type ({error!r:.200}); score the images again"
        ) from error


def _from_dict(content: Mapping[str, Any]) -> Evaluation:
    frames = tuple(_all(int, content["frames"]))
    identical = {name: set(_all(int, numbers)) for name, numbers in _mapping(content, "identical").items()}
    values: dict[str, tuple[Value, ...]] = {}
    for name, column in _mapping(content, "per_frame").items():
        infinite, column = identical.get(name, set()), _all((int, float, NoneType), column)
        values[name] = tuple(math.inf if n in infinite else v for n, v in zip(frames, column, strict=True))
    summary = _mapping(content, "summary")
    texts = {name: _mapping(content, name) for name in ("hashes", "weights")}
    for found in texts.values():
        _all(str, list(found.values()))
    return Evaluation(
        subject=clean_name(_all(str, [content["subject"]])[0]),
        method=clean_name(_all(str, [content["method"]])[0]),
        protocol=protocol_from_dict(_mapping(content, "protocol")),
        frames=frames,
        values=values,
        seed=_all((int, NoneType), [content["seed"]])[0],
        missing={name: str(entry["missing"]) for name, entry in summary.items() if "missing" in entry},
        hashes=texts["hashes"],
        weights=texts["weights"],
        efficiency=_mapping(content, "efficiency"),
        provenance=_mapping(content, "provenance"),
        notes=tuple(_all(str, content["notes"])),
        setup=setup_from_dict(_mapping({"setup": {}, **content}, "setup")),
    )


def _mapping(content: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """An entry that is an object; `TypeError` if it is none."""
    value = content[name]
    if not isinstance(value, dict):
        raise TypeError(f"{name}: expected an object, found {type(value).__name__}")
    return value


def _all(kind: type | tuple[type, ...], values: object) -> list[Any]:
    """A list whose entries are of one kind, and no truth values; `TypeError` if it is none."""
    if not isinstance(values, list):
        raise TypeError(f"expected a list, found {type(values).__name__}")
    for value in values:
        if not isinstance(value, kind) or isinstance(value, bool):
            raise TypeError(f"expected numbers or texts of one kind in a list, found {value!r:.60}")
    return values
