"""The command ggavatar-view: a run, a capture or a file of Gaussians in a browser."""

from __future__ import annotations

import sys
import threading

from evaluate.viewer.options import PAGE, WAIT, Options, check, with_first_camera
from ggavatar.cli.given import AN_AVATAR, CAPTURE, Expected, check_given
from ggavatar.cli.page import parse
from ggavatar.cli.progress import announce_start
from ggavatar.cli.run import run_command
from ggavatar.text.terminal import write_err

SHOWN = Expected({CAPTURE, *AN_AVATAR.kinds}, f"{AN_AVATAR.text}, or a capture folder of ggavatar-prep")


def main() -> int:
    """Run the command; Ctrl-C is how it ends, with exit code 0; 1 failure, 2 bad input."""

    def body() -> None:
        """What `run_command` guards."""
        is_companion = sys.argv[-1] == WAIT
        arguments = with_first_camera(sys.argv[1:-1] if is_companion else sys.argv[1:])
        options: Options = parse(PAGE, arguments)
        check(options)
        if not is_companion:
            check_given(options.shown, SHOWN)
        announce_start()
        from evaluate.viewer.session import view

        try:
            view(options, threading.Event(), is_companion)
        except KeyboardInterrupt:
            write_err("the viewer has ended")

    return run_command(body, Options)


if __name__ == "__main__":
    sys.exit(main())
