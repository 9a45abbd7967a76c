"""Runs one benchmark and writes its figures as JSON."""

from __future__ import annotations

import argparse
import importlib
import json
import sys
from pathlib import Path

from ggavatar.cli.process import prepare_process

prepare_process()
from benchmarks.measure import environment  # noqa: E402  imports torch

NAMES = ("rasterizer", "step", "scaling", "evaluation", "preparation", "launches")


def parse(arguments: list[str]) -> argparse.Namespace:
    """Options of the command; every benchmark's `run(options)` uses those it needs."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="Measure the published performance figures: medians and interquartile ranges.",
    )
    parser.add_argument("name", choices=NAMES, help="benchmark to run")
    parser.add_argument(
        "--json", type=Path, required=True, metavar="OUT", help="output file; plots are written beside it"
    )
    parser.add_argument("--repeats", type=int, default=0, help="timed rounds; 0 for the benchmark's default")
    parser.add_argument("--quick", action="store_true", help="small scenes, for continuous integration")
    parser.add_argument("--threads", type=int, default=0, help="threads of the wall-clock figures; 0 for all cores")
    return parser.parse_args(arguments)


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark, print its figures and write them."""
    options = parse(sys.argv[1:] if arguments is None else arguments)
    options.json.parent.mkdir(parents=True, exist_ok=True)
    figures = importlib.import_module(f"benchmarks.{options.name}").run(options)
    text = json.dumps({"benchmark": options.name, "environment": environment()} | figures, indent=1)
    options.json.write_text(text + "\n", encoding="utf-8")
    sys.stdout.write(text + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
