"""The command ggavatar-render: frames of a split, an orbit or a driving sequence, as PNG and video."""

from __future__ import annotations

import sys
from collections.abc import Callable

import tyro

from evaluate.rendering.options import Options, check
from ggavatar.cli.run import run_command
from ggavatar.cli.version import answer_version


def main() -> int:
    """Run the command; the exit code is 0 done, 1 failure, 2 bad input, 130 interrupted."""
    answer_version("ggavatar-render")
    options = tyro.cli(Options, prog="ggavatar-render", description=Options.__doc__)

    def body() -> None:
        check(options)
        from evaluate.rendering.jobs import render

        for path in render(options, counter(sys.stderr.write, sys.stderr.isatty())):
            sys.stdout.write(f"{path}\n")

    return run_command(body)


def counter(write: Callable[[str], object], live: bool) -> Callable[[int, int], None]:
    """A progress callback: one line kept up to date on a terminal, a line at each tenth elsewhere."""

    def show(done: int, total: int) -> None:
        if live:
            write(f"\rrendered {done} of {total}" + ("\n" if done == total else ""))
        elif done == total or (total >= 10 and done % (total // 10) == 0):
            write(f"rendered {done} of {total}\n")

    return show
