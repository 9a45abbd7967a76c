"""Compute every number of a table again from the results it lists: python recompute_table.py table.json."""

import json
import sys
from math import ceil, log10
from pathlib import Path
from statistics import fmean, median, stdev


def number(result, kind, metric):
    """One statistic of one result, from its per-frame values."""
    if kind == "efficiency":
        return result["efficiency"][metric]
    name = "mse" if metric == "psnr_pooled" else metric
    values = [value for value in result["per_frame"].get(name, []) if value is not None]
    if metric == "psnr_pooled":
        return len(values) if kind == "count" else -10 * log10(fmean(values))
    best_first = sorted(values, reverse=result["summary"][metric]["higher_is_better"])
    known = {"median": median, "std_over_frames": stdev, "count": len}
    return fmean(best_first[-ceil(len(values) / 20) :]) if kind == "worst_5_percent" else known.get(kind, fmean)(values)


file = Path(sys.argv[1])
content = json.loads(file.read_text(encoding="utf-8"))
results = [json.loads((file.parent / name).read_text(encoding="utf-8")) for name in content["results"]]
for table in content["tables"]:
    for label, cell in [(row["label"], cell) for row in table["rows"] for cell in row["cells"] if cell["source"]]:
        kind, subjects, methods, metric, seed = cell["source"].values()
        mine = [r for r in results if r["protocol"]["id"] == table["protocol"] and seed in (None, r["seed"])]
        runs = [[[r for r in mine if (r["subject"], r["method"]) == (s, m)] for s in subjects] for m in methods]
        found = [[[number(r, kind, metric) for r in seeds] for seeds in group] for group in runs]
        reduce = stdev if kind == "std_over_seeds" else fmean
        means = [fmean(reduce(seeds) for seeds in group) for group in found]
        again = means[0] - sum(means[1:])
        print(f"{table['name']:13} {label:30} {kind:16} {metric:22} {cell['text']:28} {again:.6f}")
        assert abs(again - cell["value"]) <= 1e-9 * max(1, abs(again)), "the table does not follow from its files"
