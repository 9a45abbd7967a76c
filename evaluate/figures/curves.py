"""Metrics over the frames of a split, one line per method."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from evaluate.escaping.figure_text import figure_text
from evaluate.figures.evaluation_images import EvaluationImages, display_names, measured_metrics
from evaluate.figures.fonts import our_fonts
from evaluate.metrics.catalogue import metric_of, title_of
from ggavatar.io.atomic import write_atomically

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#5B5B5B")
"""Palette of Okabe and Ito, distinguishable with any form of color vision."""


def curves(compared: Sequence[EvaluationImages], metrics: Sequence[str] = ()) -> Figure:
    """One panel per metric, with every method's mean as a dashed line and its worst frame marked.

    Args:
        compared: Methods on one subject.
        metrics: Metrics to plot; by default those of the main table that were measured.
    """
    wanted = set(compared[0].evaluation.protocol.table_metrics)
    measured = measured_metrics(compared)
    chosen = list(metrics) or [name for name in measured if name in wanted] or measured[:1]
    figure = Figure(figsize=(9.0, 0.9 + 1.9 * len(chosen)), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(chosen), 1, sharex=True, squeeze=False)[:, 0]
    for panel, name in zip(panels, chosen, strict=True):
        _draw(panel, compared, name)
    panels[-1].set_xlabel("source frame")
    first = compared[0].evaluation
    title = f"{first.subject} · {first.protocol.id} · {len(first.frames)} frames"
    figure.suptitle(figure_text(title), fontsize=11)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    return figure


def _draw(panel: Axes, compared: Sequence[EvaluationImages], name: str) -> None:
    metric = metric_of(name)
    for index, (one, label) in enumerate(zip(compared, display_names(compared), strict=True)):
        color = COLORS[index % len(COLORS)]
        frames = np.array(one.evaluation.frames)
        values = np.array([np.nan if value is None else value for value in one.evaluation.values.get(name, ())])
        values[~np.isfinite(values)] = np.nan
        if not np.isfinite(values).any():
            continue
        marker = "o" if len(frames) <= 80 else ""
        panel.plot(frames, values, color=color, linewidth=1.3, label=figure_text(label), marker=marker, markersize=3.0)
        panel.axhline(float(np.nanmean(values)), color=color, linewidth=0.9, linestyle="--", alpha=0.7)
        worst = np.nanargmin(values) if metric.higher_is_better else np.nanargmax(values)
        panel.plot(frames[worst], values[worst], "v" if metric.higher_is_better else "^", color=color, markersize=7)
        panel.annotate(
            str(frames[worst]), (frames[worst], values[worst]), (6, 0), textcoords="offset points", fontsize=8
        )
    unit = "" if metric.unit == "1" else f", {metric.unit}"
    panel.set_ylabel(figure_text(f"{title_of(name)}{unit} {metric.arrow}"))
    panel.grid(True, color="#dddddd", linewidth=0.6)
    panel.spines[["top", "right"]].set_visible(False)


def write_curves(path: Path, compared: Sequence[EvaluationImages]) -> None:
    """Write the curves in the format of the suffix (.png, .pdf, .svg), if anything was measured."""
    if not measured_metrics(compared):
        return
    with our_fonts():
        figure = curves(compared)
        write_atomically(path, lambda stream: figure.savefig(stream, format=path.suffix[1:]))
