"""The report: one HTML page with tables, pictures, curves and protocol that needs neither network nor server."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any

from evaluate.figures.curves import COLORS
from evaluate.figures.evaluation_images import EvaluationImages, display_names, measured_metrics, worst_frames
from evaluate.figures.report_images import report_pictures
from evaluate.metrics.catalogue import metric_of, title_of
from evaluate.protocols.results import Evaluation, write_text
from evaluate.tables.format_html import STYLE, to_fragment
from evaluate.tables.provenance import ranges
from evaluate.tables.table import Table
from evaluate.tables.write import build_tables
from ggavatar.errors import InputError

TEMPLATE = "report.html"
WORST = 6
FOLDED = MappingProxyType({"detail": "All metrics", "sources": "What was scored"})


def write_report(path: Path, shown: Sequence[EvaluationImages], megabytes: float = 12.0) -> None:
    """Write the report of one or more methods on one subject.

    Args:
        path: The .html file to write, atomically.
        shown: Evaluations under one protocol on the same frames; the first is shown first.
        megabytes: Room for pictures, 10⁶ bytes; where it does not hold all frames, the worst and an even choice of the
            others are shown, and the page says so.

    Raises:
        InputError: No evaluation, different protocols or subjects, or a missing picture.
    """
    if not shown:
        raise InputError("expected at least one evaluation to report, found none")
    kinds = {(one.evaluation.subject, one.evaluation.protocol.digest) for one in shown}
    if len(kinds) > 1:
        raise InputError(f"expected one subject under one protocol in a report, found {len(kinds)}; write one for each")
    evaluations = [one.evaluation for one in shown]
    tables = "\n".join(map(_table, build_tables(evaluations)))
    parts = {
        "TITLE": escape(_title(shown)),
        "SUMMARY": _summary(evaluations[0], display_names(shown)[0] if len(shown) > 1 else ""),
        "TABLE-STYLE": STYLE,
        "TABLES": tables,
        "PROTOCOL": _definition_list(_protocol(evaluations[0])),
        "PROVENANCE": "".join(
            _provenance(one, name) for one, name in zip(evaluations, display_names(shown), strict=True)
        ),
        "DATA": json.dumps(report_data(shown, megabytes), allow_nan=False, ensure_ascii=True).replace("<", "\\u003c"),
    }
    page = (files("evaluate.figures") / TEMPLATE).read_text(encoding="utf-8")
    write_text(path, re.sub(r"<!--([A-Z-]+)-->", lambda found: parts[found[1]], page))


def report_data(shown: Sequence[EvaluationImages], megabytes: float) -> dict[str, Any]:
    """What the page's script draws: numbers of all frames, pictures of those that fit."""
    pictures, limit = report_pictures(shown, megabytes)
    columns, headline = measured_metrics(shown), set(shown[0].evaluation.protocol.table_metrics)
    return {
        "methods": display_names(shown),
        "colors": [COLORS[index % len(COLORS)] for index in range(len(shown))],
        "metrics": [_metric(name, name in headline or name.startswith("psnr@")) for name in columns],
        "frames": list(shown[0].evaluation.frames),
        "values": {
            name: [_by_frame(one.evaluation, shown[0].evaluation.frames, name) for one in shown] for name in columns
        },
        "means": {name: [one.evaluation.summary(name).mean for one in shown] for name in columns},
        "pictures": pictures,
        "worst": worst_frames(shown, WORST),
        "errorLimit": limit,
        "fps": min(shown[0].fps, 12.0),
    }


def _table(table: Table) -> str:
    """A table as HTML; long ones are folded."""
    fragment, title = to_fragment(table), FOLDED.get(table.name)
    return f"<details><summary>{title}</summary>{fragment}</details>" if title else fragment


def _metric(name: str, main: bool) -> dict[str, Any]:
    metric = metric_of(name)
    unit = "" if metric.unit == "1" else metric.unit
    return {
        "name": name,
        "title": title_of(name),
        "unit": unit,
        "digits": metric.digits,
        "arrow": metric.arrow,
        "main": main,
    }


def _by_frame(evaluation: Evaluation, frames: Sequence[int], name: str) -> list[float | str | None]:
    """Values in the order of `frames`; infinite ones (identical pictures) as a word."""
    values = dict(zip(evaluation.frames, evaluation.values.get(name, ()), strict=False))
    return [_value(values.get(frame)) for frame in frames]


def _value(value: float | None) -> float | str | None:
    return value if value is None or math.isfinite(value) else "identical"


def _title(shown: Sequence[EvaluationImages]) -> str:
    return f"{shown[0].evaluation.subject}: {', '.join(display_names(shown))}"


def _summary(evaluation: Evaluation, name: str) -> str:
    """The numbers of the main table, large; under the name of the method where the page shows several."""
    cells = [f"<div><dt>Method</dt><dd>{escape(name)}</dd></div>"] if name else []
    for name in evaluation.protocol.table_metrics:
        metric, mean = metric_of(name), evaluation.summary(name).mean
        value = "–" if mean is None else f"{mean:.{metric.digits}f}"
        unit = "" if metric.unit == "1" or mean is None else f" <small>{escape(metric.unit)}</small>"
        hint = f' title="{escape(evaluation.missing[name])}"' if name in evaluation.missing else ""
        cells.append(f"<div{hint}><dt>{escape(title_of(name))} {metric.arrow}</dt><dd>{value}{unit}</dd></div>")
    fps = evaluation.efficiency.get("fps")
    if isinstance(fps, (int, float)):
        cells.append(f"<div><dt>Frames per second ↑</dt><dd>{fps:.1f}</dd></div>")
    return "\n".join(cells)


def _protocol(evaluation: Evaluation) -> dict[str, Any]:
    protocol = evaluation.protocol
    words = {"id": protocol.id, "digest (SHA-256)": protocol.digest, **protocol.as_dict()}
    defined = {f"definition of {name}": metric_of(name).definition for name in protocol.metrics}
    return {**words, **defined, "test frames": f"{len(evaluation.frames)}: {ranges(evaluation.frames)}"}


def _provenance(evaluation: Evaluation, name: str) -> str:
    content: dict[str, Any] = {**_flat(evaluation.provenance), **_flat(evaluation.efficiency)}
    content |= {f"SHA-256 of {what}": value for what, value in evaluation.hashes.items()}
    content |= {f"weights {what}": value for what, value in evaluation.weights.items()}
    notes = "".join(f"<li>{escape(note)}</li>" for note in evaluation.notes)
    inside = _definition_list(content) + (f"<ul>{notes}</ul>" if notes else "")
    return f"<details open><summary>{escape(name)}</summary>{inside}</details>"


def _flat(content: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested mappings as one, keys joined by a space; entries without a value are left out."""
    found: dict[str, Any] = {}
    for key, value in content.items():
        label = f"{prefix}{key.replace('_', ' ')}"
        found |= _flat(value, f"{label} ") if isinstance(value, Mapping) else {} if value is None else {label: value}
    return found


def _definition_list(content: Mapping[str, Any]) -> str:
    rows = (f"<div><dt>{escape(str(key))}</dt><dd>{escape(_text(value))}</dd></div>" for key, value in content.items())
    return f'<dl class="facts">{"".join(rows)}</dl>'


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return ", ".join(map(str, value)) or "none" if isinstance(value, (list, tuple)) else str(value)
