"""Cost of a step as a function of the number of Gaussians and of pixels, with a plot."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from benchmarks.measure import interleaved, threads
from benchmarks.rasterizer import step
from benchmarks.scenes import head
from ggavatar.render.cpu import rasterizer

COUNTS = (10_000, 25_000, 50_000, 100_000, 200_000, 400_000)
SIZES = (128, 256, 512, 1024)
BASE_SIZE, BASE_COUNT = 512, 50_000


def cost(count: int, size: int, rounds: int) -> dict[str, float]:
    """CPU time of one step on one thread."""
    gaussians, camera = head(count, size)
    with threads(1):
        timing = interleaved({"cpu": step(rasterizer.rasterize, gaussians, camera)}, rounds, warm_up=2)["cpu"]
    return {"gaussians": count, "size": size} | timing.as_dict()


def exponent(amounts: list[float], costs: list[float]) -> float:
    """Slope in the log-log plot; 1 is linear."""
    return round(float(np.polyfit(np.log(amounts), np.log(costs), 1)[0]), 3)


def run(options: argparse.Namespace) -> dict[str, object]:
    """Measure both dependencies with their exponents, and write the plot beside the JSON file."""
    rounds = options.repeats or 7
    counts, sizes = (COUNTS[:2], SIZES[:2]) if options.quick else (COUNTS, SIZES)
    by_count = [cost(count, BASE_SIZE, rounds) for count in counts]
    by_size = [cost(BASE_COUNT, size, rounds) for size in sizes]
    plot(by_count, by_size, options.json.with_suffix(".png"))
    return {
        "by_gaussians": by_count,
        "by_pixels": by_size,
        "exponent_gaussians": exponent([row["gaussians"] for row in by_count], [row["cpu_ms"] for row in by_count]),
        "exponent_pixels": exponent([row["size"] ** 2 for row in by_size], [row["cpu_ms"] for row in by_size]),
    }


def plot(by_count: list[dict[str, float]], by_size: list[dict[str, float]], path: Path) -> None:
    """Write log-log curves with a linear slope for comparison."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(9, 3.6), sharey=True, layout="constrained")
    counts, pixels = [row["gaussians"] for row in by_count], [row["size"] ** 2 for row in by_size]
    for axis, amounts, rows in ((axes[0], counts, by_count), (axes[1], pixels, by_size)):
        costs = np.array([row["cpu_ms"] for row in rows])
        axis.loglog(amounts, costs, "o-", color="tab:blue", label="forward + backward")
        axis.loglog(amounts, costs[-1] * np.array(amounts) / amounts[-1], "--", color="0.6", label="linear")
        for amount, value in zip(amounts, costs, strict=True):
            axis.annotate(
                f"{value:.0f}", (amount, value), xytext=(0, 6), textcoords="offset points", ha="center", fontsize=8
            )
        axis.grid(alpha=0.3, which="both")
        axis.margins(y=0.12)
    axes[0].set(xlabel=f"Gaussians (image {BASE_SIZE}²)", ylabel="CPU time, 1 thread, ms")
    axes[1].set(xlabel=f"pixels ({BASE_COUNT // 1000}k Gaussians)")
    axes[0].legend(frameon=False)
    figure.savefig(path, dpi=150)
    pyplot.close(figure)
