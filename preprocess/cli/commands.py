"""Entry points of the commands: what a command imports is guarded like all that it does.

Importing takes a second. Ctrl-C, too little memory or too few open files end it as they end the command later: with one
message and an exit code.
"""

from __future__ import annotations

from ggavatar.cli.run import run_command


def prep() -> int:
    """Entry point of ggavatar-prep; returns the exit code."""

    def load_and_run() -> int:
        from preprocess.cli.prep import main

        return main()

    return run_command(load_and_run)


def doctor() -> int:
    """Entry point of ggavatar-doctor; returns the exit code."""

    def load_and_run() -> int:
        from preprocess.cli.doctor import main

        return main()

    return run_command(load_and_run)


def demo() -> int:
    """Entry point of ggavatar-demo; returns the exit code."""

    def load_and_run() -> int:
        from preprocess.cli.demo import main

        return main()

    return run_command(load_and_run)
