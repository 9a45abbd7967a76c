"""Recompute the paired differences of a table and their intervals: python recompute_intervals.py table.json.

A circular block bootstrap of the result files beside the table, stratified by subject (docs/evaluation.md, Tables).
"""

import json
import re
import sys
from math import ceil
from pathlib import Path

import numpy as np
import pandas as pd

content = json.loads((file := Path(sys.argv[1])).read_text(encoding="utf-8"))
results = [json.loads((file.parent / name).read_text(encoding="utf-8")) for name in content["results"]]
for table in [table for table in content["tables"] if table["name"] == "significance"]:
    for cell in [cell for row in table["rows"] for cell in row["cells"] if cell["source"]]:
        _, subjects, (first, second), metric, _ = cell["source"].values()
        generator, draws = np.random.default_rng(0), []
        for subject in subjects:
            mine = [r for r in results if (r["protocol"]["id"], r["subject"]) == (table["protocol"], subject)]
            mine = [r for r in mine if r["method"] in (first, second)]
            columns = [pd.Series(r["per_frame"][metric], r["frames"], float, r["method"]) for r in mine]
            both = pd.concat(columns, axis=1).dropna()
            values = (both[[first]].mean(axis=1) - both[[second]].mean(axis=1)).to_numpy()
            spacing = np.median(np.diff(both.index)) if len(values) > 1 else 25
            block = max(1, min(round(25 / spacing), len(values) // 4))
            starts = generator.integers(0, len(values), (10_000, ceil(len(values) / block)))
            draws.append([values.mean(), *values[(starts[..., None] + np.arange(block)) % len(values)].mean((1, 2))])
        mean, (low, high) = np.mean(draws, axis=0)[0], np.quantile(np.mean(draws, axis=0)[1:], (0.025, 0.975))
        digits = len(re.search(r"\.(\d+)", cell["text"])[1])
        again = f"{mean:+.{digits}f} [{low:+.{digits}f}, {high:+.{digits}f}]" + "*" * bool(low > 0 or high < 0)
        print(f"{first} - {second} {metric}: {again}")
        assert again == cell["text"], f"{cell['text']} is not {again}"
