"""Recompute the numbers of a table from the result files beside it: python recompute_table.py table.json.

Paired differences and their intervals are recomputed by recompute_intervals.py.
"""

import json
import re
import sys
from math import ceil, log10
from pathlib import Path
from statistics import fmean, stdev

import pandas as pd


def statistic(result: dict, kind: str, metric: str) -> float:
    """One statistic of one result: a cost, or computed from the values per frame (null if not measured)."""
    if kind == "efficiency":
        return result["efficiency"][metric]
    values = pd.Series(result["per_frame"].get(metric.replace("psnr_pooled", "mse")), dtype=float).dropna()
    worst_first = values.sort_values(ascending=result["summary"][metric]["higher_is_better"])
    known = {"count": values.count, "median": values.median, "std_over_frames": values.std}
    known["worst_5_percent"] = worst_first.head(ceil(len(values) / 20)).mean
    mean = (lambda: -10 * log10(values.mean())) if metric == "psnr_pooled" else values.mean
    return known.get(kind, mean)()


content = json.loads((file := Path(sys.argv[1])).read_text(encoding="utf-8"))
results = [json.loads((file.parent / name).read_text(encoding="utf-8")) for name in content["results"]]
for table in [table for table in content["tables"] if table["name"] != "significance"]:
    for cell in [cell for row in table["rows"] for cell in row["cells"] if cell["source"]]:
        kind, subjects, (method,), metric, seed = cell["source"].values()
        mine = [r for r in results if (r["protocol"]["id"], r["method"]) == (table["protocol"], method)]
        mine = [r for r in mine if seed in (None, r["seed"])]
        runs = [[statistic(r, kind, metric) for r in mine if r["subject"] == subject] for subject in subjects]
        again = [fmean(map(stdev if kind == "std_over_seeds" else fmean, runs))]
        again += [stdev(runs[0])] if cell["deviation"] is not None else []
        for text, number in zip(re.findall(r"-?\d+\.?\d*", cell["text"]), again, strict=True):
            print(f"{table['name']:12} {kind:16} {metric:22} {text:>10} = {number:.6f}")
            assert abs(float(text) - number) <= 0.5001 * 10 ** -len(text.partition(".")[2]), f"{text} is not {number}"
