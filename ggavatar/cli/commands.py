"""Entry points of the commands: what a command imports is guarded like all that it does.

Importing takes a second. Ctrl-C, too little memory or too few open files end it as they end the command later: with one
message and an exit code.
"""

from __future__ import annotations

from ggavatar.cli.run import run_command


def train() -> int:
    """Entry point of ggavatar-train; returns the exit code."""

    def load_and_run() -> int:
        from ggavatar.cli.train import train

        return train()

    return run_command(load_and_run)


def sweep() -> int:
    """Entry point of ggavatar-sweep; returns the exit code."""

    def load_and_run() -> int:
        from ggavatar.cli.sweep import main

        return main()

    return run_command(load_and_run)


def export() -> int:
    """Entry point of ggavatar-export; returns the exit code."""

    def load_and_run() -> int:
        from ggavatar.cli.export import main

        return main()

    return run_command(load_and_run)


def models() -> int:
    """Entry point of ggavatar-models; returns the exit code."""

    def load_and_run() -> int:
        from ggavatar.cli.models import main

        return main()

    return run_command(load_and_run)
