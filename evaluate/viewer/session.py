"""A viewing session: what is to be shown is opened, and shown until the user ends it."""

from __future__ import annotations

import contextlib
import threading
from dataclasses import dataclass

import torch

from evaluate.viewer.drawing import Drawing
from evaluate.viewer.options import Options
from evaluate.viewer.run_panel import RunPanel
from evaluate.viewer.run_scene import RunScene
from evaluate.viewer.server import ViewerServer, require_viser
from ggavatar.data.background import parse_background
from ggavatar.render.backends import resolve_device
from ggavatar.text.terminal import write_err, write_out
from ggavatar.training.run_folder import open_run


@dataclass
class Session:
    """A server and what it shows."""

    server: ViewerServer
    drawing: Drawing

    def close(self) -> None:
        """Stop drawing and serving."""
        self.server.stop()


def view(options: Options, ended: threading.Event) -> None:
    """Show what the options name until `ended` is set.

    Raises:
        InputError: viser is not installed, or what is to be shown cannot be opened.
    """
    session = open_session(options)
    try:
        write_out(f"open {session.server.address} in a browser; Ctrl-C ends the viewer")
        if options.public:
            write_err("warning: --public: everybody who reaches this computer can watch and move what is shown")
        _flush()
        while not ended.wait(0.5):
            pass
    finally:
        session.close()


def _flush() -> None:
    import sys

    with contextlib.suppress(OSError):
        sys.stdout.flush()


def open_session(options: Options) -> Session:
    """Open what the options name and begin to serve it."""
    require_viser()
    return _open_run(options)


def _open_run(options: Options) -> Session:
    source = options.source
    moved = [] if source.capture is None else [source.capture]
    run = open_run(options.shown, resolve_device(options.device), None, options.backend, *moved)
    scene = RunScene(run, background_of(options, run.background))
    drawing = Drawing(scene)
    scene.changed = drawing.wake
    server = ViewerServer(options.port, options.public, run.capture.subject)
    RunPanel(server, scene, drawing)
    server.show(drawing, scene.controls.pivot)
    return Session(server, drawing)


def background_of(options: Options, own: torch.Tensor) -> torch.Tensor:
    """The color of --background, or else one's own."""
    return own if options.background is None else own.new_tensor(parse_background(options.background))
