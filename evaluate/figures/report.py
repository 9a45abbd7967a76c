"""The report: one HTML page with tables, images, curves and protocol that needs neither network nor server."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from evaluate.figures.curves import COLORS
from evaluate.figures.evaluation_images import EvaluationImages, display_names, measured_metrics, worst_frames
from evaluate.figures.report_images import report_images
from evaluate.metrics.catalogue import metric_of, title_of
from evaluate.protocols.results import Evaluation
from evaluate.tables.format_html import STYLE, to_fragment
from evaluate.tables.provenance import ranges
from evaluate.tables.write import build_tables
from ggavatar.errors import InputError
from ggavatar.io.atomic import write_text
from ggavatar.text.names import displayable

TEMPLATE = "report.html"
WORST_FRAMES = 6
MAX_FPS = 12.0
"""Largest playback rate of the page, frames per second."""
COLLAPSED_TABLES = MappingProxyType({"detail": "All metrics", "sources": "What was scored"})
"""Titles of long tables that are collapsed at first."""


def write_report(path: Path, compared: Sequence[EvaluationImages], megabytes: float = 12.0) -> None:
    """Write the report of one or more methods on one subject.

    Args:
        path: The .html file, written atomically.
        compared: Evaluations under one protocol on the same frames; the first is shown first.
        megabytes: Budget for images, 10⁶ bytes; if it does not hold all frames, the worst and an even selection of the
            others are included, and the page says so.

    Raises:
        InputError: No evaluation, different protocols or subjects, or a missing image.
    """
    if not compared:
        raise InputError("expected at least one evaluation to report, found none")
    kinds = {(one.evaluation.subject, one.evaluation.protocol.digest) for one in compared}
    if len(kinds) > 1:
        raise InputError(f"expected one subject under one protocol in a report, found {len(kinds)}; write one for each")
    evaluations, names = [one.evaluation for one in compared], display_names(compared)
    tables = [(COLLAPSED_TABLES.get(table.name), to_fragment(table)) for table in build_tables(evaluations)]
    page = _environment().get_template(TEMPLATE)
    text = page.render(
        title=f"{evaluations[0].subject}: {', '.join(names)}",
        table_style=STYLE,
        headline=_headline(evaluations[0], names[0] if len(names) > 1 else ""),
        tables=tables,
        protocol=_protocol(evaluations[0]),
        provenance=[(name, _provenance(one), one.notes) for name, one in zip(names, evaluations, strict=True)],
        data=report_data(compared, megabytes),
        avatar=_avatar_page(path),
    )
    write_text(path, text + "\n")


def _avatar_page(report: Path) -> str | None:
    """Relative address of the page that ggavatar-export wrote for the run of a report in RUN/eval/PROTOCOL, if any."""
    page = Path("..", "..", "exports", "avatar.html")
    return page.as_posix() if (report.parent / page).is_file() else None


def _environment() -> Environment:
    """Jinja2 with templates of this package, automatic escaping, undefined names as errors and strict JSON."""
    loader = PackageLoader("evaluate", "figures")  # compiled code is named after the template's file
    environment = Environment(autoescape=True, undefined=StrictUndefined, finalize=_shown, loader=loader)
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False}
    return environment


def _shown(value: object) -> object:
    """A value before Jinja2 escapes it; finished markup is kept."""
    return value if hasattr(value, "__html__") else displayable(str(value))


def report_data(compared: Sequence[EvaluationImages], megabytes: float) -> dict[str, Any]:
    """The data of the page's script: values of all frames, and images of those that fit into the budget."""
    images, limit = report_images(compared, megabytes)
    columns, main = measured_metrics(compared), set(compared[0].evaluation.protocol.table_metrics)
    frames = compared[0].evaluation.frames
    return {
        "methods": display_names(compared),
        "colors": [COLORS[index % len(COLORS)] for index in range(len(compared))],
        "metrics": [_metric(name, name in main or name.startswith("psnr@")) for name in columns],
        "frames": list(frames),
        "values": {name: [_by_frame(one.evaluation, frames, name) for one in compared] for name in columns},
        "means": {name: [one.evaluation.summary(name).mean for one in compared] for name in columns},
        "images": images,
        "worst": worst_frames(compared, WORST_FRAMES),
        "errorLimit": limit,
        "fps": min(compared[0].fps, MAX_FPS),
    }


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
    """Values in the order of `frames`; infinite ones (identical images) as a word."""
    values = dict(zip(evaluation.frames, evaluation.values.get(name, ()), strict=False))
    return [_json_value(values.get(frame)) for frame in frames]


def _json_value(value: float | None) -> float | str | None:
    return value if value is None or math.isfinite(value) else "identical"


def _headline(evaluation: Evaluation, name: str) -> list[dict[str, str]]:
    """The means of the main table, below the method's name if the page shows several."""
    facts = [{"name": "Method", "value": name}] if name else []
    for column in evaluation.protocol.table_metrics:
        metric, mean = metric_of(column), evaluation.summary(column).mean
        facts.append(
            {
                "name": f"{title_of(column)} {metric.arrow}",
                "value": "–" if mean is None else f"{mean:.{metric.digits}f}",
                "unit": "" if metric.unit == "1" or mean is None else metric.unit,
                "reason": evaluation.missing.get(column, ""),
            }
        )
    trained = evaluation.setup.facts or {"images": evaluation.setup.describe()}
    facts += [{"name": name.capitalize(), "value": value} for name, value in trained.items() if value != "none"]
    fps = evaluation.efficiency.get("fps")
    if isinstance(fps, (int, float)):
        facts.append({"name": "Frames per second ↑", "value": f"{fps:.1f}"})
    return [{"unit": "", "reason": "", **fact} for fact in facts]


def _protocol(evaluation: Evaluation) -> dict[str, str]:
    protocol = evaluation.protocol
    fields = {"id": protocol.id, "digest (SHA-256)": protocol.digest, **protocol.as_dict()}
    definitions = {f"definition of {name}": metric_of(name).definition for name in protocol.metrics}
    frames = {"test frames": f"{len(evaluation.frames)}: {ranges(evaluation.frames)}"}
    return {name: _text(value) for name, value in {**fields, **definitions, **frames}.items()}


def _provenance(evaluation: Evaluation) -> dict[str, str]:
    setup = {"setup": evaluation.setup.describe(), "method on the command line": evaluation.setup.method}
    content: dict[str, Any] = {**_flat(setup), **_flat(evaluation.provenance), **_flat(evaluation.efficiency)}
    content |= {f"SHA-256 of {what}": value for what, value in evaluation.hashes.items()}
    content |= {f"weights {what}": value for what, value in evaluation.weights.items()}
    return {name: _text(value) for name, value in content.items()}


def _flat(content: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested mappings as one, keys joined by a space; entries without a value are skipped."""
    found: dict[str, Any] = {}
    for key, value in content.items():
        label = f"{prefix}{key.replace('_', ' ')}"
        found |= _flat(value, f"{label} ") if isinstance(value, Mapping) else {} if value is None else {label: value}
    return found


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return ", ".join(map(str, value)) or "none" if isinstance(value, (list, tuple)) else str(value)
