"""The command ggavatar-render: frames of a split, an orbit or a driving sequence, as PNG and video."""

from __future__ import annotations

from evaluate.rendering.options import PAGE, Options, check
from ggavatar.cli.given import AN_AVATAR, check_given
from ggavatar.cli.page import parse
from ggavatar.cli.progress import announce_start, show_progress
from ggavatar.cli.run import run_command
from ggavatar.text.terminal import write_out


def main() -> int:
    """Run the command; the exit code is 0 done, 1 failure, 2 bad input, 130 interrupted."""

    def body() -> None:
        options: Options = parse(PAGE)
        check(options)
        check_given(options.run, AN_AVATAR)
        announce_start()
        from evaluate.rendering.jobs import render

        with show_progress("rendering") as progress:
            written = render(options, progress)
        write_out(*map(str, written))

    return run_command(body, Options)
