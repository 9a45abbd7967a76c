"""Entry points of the commands: what a command imports is guarded like all that it does.

Importing takes a second. Ctrl-C, too little memory or too few open files end it as they end the command later: with one
message and an exit code.
"""

from __future__ import annotations

from ggavatar.cli.run import run_command


def evaluate() -> int:
    """Entry point of ggavatar-eval; returns the exit code."""

    def load_and_run() -> int:
        from evaluate.cli.evaluate import main

        return main()

    return run_command(load_and_run)


def render() -> int:
    """Entry point of ggavatar-render; returns the exit code."""

    def load_and_run() -> int:
        from evaluate.cli.render import main

        return main()

    return run_command(load_and_run)


def view() -> int:
    """Entry point of ggavatar-view; returns the exit code."""

    def load_and_run() -> int:
        from evaluate.cli.view import main

        return main()

    return run_command(load_and_run)
