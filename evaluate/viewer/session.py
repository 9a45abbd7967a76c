"""A viewing session: what is to be shown is opened, and shown until the user ends it."""

from __future__ import annotations

import contextlib
import copy
import os
import sys
import threading
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import torch

from evaluate.protocols.protocol import GIVEN
from evaluate.rendering.standalone_file import StandaloneGaussians, open_standalone
from evaluate.scoring.gaussian_files import open_gaussian_file, refuse_file_flags
from evaluate.viewer.capture_panel import CapturePanel
from evaluate.viewer.capture_scene import CaptureScene
from evaluate.viewer.drawing import NICE, Drawing, Scene
from evaluate.viewer.file_scene import FileScene
from evaluate.viewer.following import Follower, Found, Newest, is_in_progress, open_in_progress, successor
from evaluate.viewer.options import Options
from evaluate.viewer.run_panel import RunPanel
from evaluate.viewer.run_scene import RunScene
from evaluate.viewer.server import ViewerServer, require_viser
from ggavatar.data.background import parse_background
from ggavatar.data.capture import DESCRIPTION, Capture
from ggavatar.errors import InputError
from ggavatar.formats.any_avatar import open_avatar
from ggavatar.formats.avatar_suffix import is_avatar_file
from ggavatar.formats.source_options import is_gaussian_file
from ggavatar.render.backends import resolve_device
from ggavatar.text.terminal import write_err, write_out
from ggavatar.training.run_folder import Run, holds_run


@runtime_checkable  # the tests' run-time type checker needs it
class Companion(Protocol):
    """What works in a thread of its own beside the drawing."""

    def start(self) -> None:
        """Begin to work."""
        ...

    def stop(self) -> None:
        """Work no more."""
        ...


@dataclass
class Session:
    """A server and what it shows."""

    server: ViewerServer
    drawing: Drawing
    others: list[Companion] = field(default_factory=list)

    def close(self) -> None:
        """Stop drawing and serving."""
        for other in self.others:
            other.stop()
        self.server.stop()


def view(options: Options, ended: threading.Event, is_companion: bool = False) -> None:
    """Show what the options name until `ended` is set.

    Args:
        options: What to show, and where.
        ended: Ends the viewer.
        is_companion: Whether a training has started it: it waits for the run, and ends when the standard input ends.

    Raises:
        InputError: viser is not installed, or what is to be shown cannot be opened.
    """
    if is_companion:
        _prepare_companion(options, ended)
        if ended.is_set():
            return
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


def _prepare_companion(options: Options, ended: threading.Event) -> None:
    """Give way to the training that has started this process, end with it, and wait until it has something to show."""
    with contextlib.suppress(AttributeError, OSError):  # not on this system
        os.nice(NICE)

    def wait_for_the_end() -> None:
        with contextlib.suppress(OSError, ValueError):
            sys.stdin.buffer.read()
        ended.set()

    threading.Thread(target=wait_for_the_end, name="standard input", daemon=True).start()
    while not is_in_progress(options.shown) and not ended.wait(0.5):
        pass


def _flush() -> None:
    with contextlib.suppress(OSError):
        sys.stdout.flush()


def open_session(options: Options) -> Session:
    """Open what the options name and begin to serve it."""
    require_viser()
    path, source = options.shown, options.source
    if options.webcam is not None and not (is_avatar_file(path) or holds_run(path)):
        raise InputError(f"{path}: --webcam drives the avatar of a run or an avatar file, this is none; leave it out")
    if is_gaussian_file(path):
        device = resolve_device(options.device)
        if source.capture is None:
            return _show_file(options, open_standalone(path, source, device, options.backend))
        return _show_run(options, open_gaussian_file(path, source, GIVEN, device, options.backend))
    refuse_file_flags(path, source)
    if (path / DESCRIPTION).is_file() and not holds_run(path):
        return _show_capture(options, Capture.open(path))
    device = resolve_device(options.device)
    if is_avatar_file(path):
        return _show_run(options, open_avatar(path, device, None, options.backend, source.capture))
    run = open_in_progress(path, device, options.backend, source.capture)
    return _show_run(options, run, is_followed=True)


def _show_run(options: Options, run: Run, is_followed: bool = False) -> Session:
    blank = copy.deepcopy(run.avatar) if is_followed else None
    scene = RunScene(run, background_of(options, run.background))
    session = _serve(options, scene, run.capture.subject)
    try:
        _add_performer(options, session, scene)
    except InputError:
        session.close()
        raise
    panel = RunPanel(session.server, scene, session.drawing)
    scene.changed = session.drawing.wake
    session.server.show(session.drawing, scene.controls.pivot)
    session.drawing.submit(scene.count)
    session.drawing.submit(panel.describe)
    if blank is not None:
        session.others.append(_following(run, blank, scene, panel, session.drawing))
    for other in session.others:
        other.start()
    return session


def _add_performer(options: Options, session: Session, scene: RunScene) -> None:
    """Add the performer of --webcam, who does not begin yet."""
    if options.webcam is not None:
        from evaluate.viewer.performance import performer_of  # takes half a second that others can do without

        session.others.append(performer_of(options.webcam, session.server, scene))


def _following(run: Run, blank: torch.nn.Module, scene: RunScene, panel: RunPanel, drawing: Drawing) -> Follower:
    """Show every newer avatar that the run folder comes to hold; the drawing thread puts it in place."""

    def put(found: Found) -> None:
        step, tensors = found
        scene.replace_avatar(successor(blank, tensors, run.background.device), step)
        panel.describe()

    return Follower(Newest(run.folder, run.step), lambda found: drawing.submit(lambda: put(found)))


def _show_capture(options: Options, capture: Capture) -> Session:
    scene = CaptureScene(capture)
    session = _serve(options, scene, capture.subject)
    CapturePanel(session.server, scene)
    scene.changed = session.drawing.wake
    session.server.show(session.drawing, scene.pivot)
    return session


def _show_file(options: Options, file: StandaloneGaussians) -> Session:
    scene = FileScene(file, background_of(options, file.background))
    session = _serve(options, scene, file.subject)
    scene.build(session.server)
    session.server.show(session.drawing, scene.pivot)
    return session


def _serve(options: Options, scene: Scene, title: str) -> Session:
    """A server that shows nothing yet, and the thread that will draw for it."""
    return Session(ViewerServer(options.port, options.public, title), Drawing(scene))


def background_of(options: Options, own: torch.Tensor) -> torch.Tensor:
    """The color of --background, or else one's own."""
    return own if options.background is None else own.new_tensor(parse_background(options.background))
