"""The server of the viewer: viser, on this computer alone, without tunnels, and closed to other sites' pages."""

from __future__ import annotations

import contextlib
import io
import threading
import time
import warnings
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt8

from evaluate.viewer.address import EVERYWHERE, THIS_COMPUTER, free_port, is_own_page
from evaluate.viewer.drawing import Drawing
from evaluate.viewer.orbit import Place, resting_place
from ggavatar.errors import InputError
from ggavatar.text.names import clean_name

NEEDS_EXTRA = (
    "ggavatar-view shows pictures through viser, which is not installed; add it with: pip install 'viser>=1.1' (the "
    "extra [view] of this package)"
)
JPEG_QUALITY = 85
"""Of pictures while something moves; those at rest are PNG."""
NEAREST, FARTHEST = 0.2, 4.0
"""How near and far a browser's camera may go, relative to its distance at rest."""
QUESTION = "ggavatar-view"
"""Something that a browser does not know; its answer says that what was sent before has arrived."""
LONGEST_WAIT = 2.0
"""Longest time to wait for an answer, s."""
DECODING = 0.5
"""Time that a browser gets to decode a picture, relative to the time of its answer."""
POLICY_VIOLATION = 1008
"""Code with which a connection is closed (RFC 6455, 7.4.1)."""


def require_viser() -> None:
    """Raise an `InputError` if viser is not installed."""
    try:
        import viser  # noqa: F401
    except ImportError as error:
        raise InputError(NEEDS_EXTRA) from error


@runtime_checkable  # the tests' run-time type checker needs it
class Windows(Protocol):
    """What a panel needs of a server: viser's panel, and all windows' cameras."""

    viser: Any

    def look_ahead(self, client: Any) -> None:
        """Move a browser's camera back to where it was at rest."""
        ...


class ViewerServer:
    """A viser server, the drawing thread that fills its windows, and what every window is told on opening.

    Attributes:
        viser: For panels: `viser.gui`.
        address: To open in a browser.
    """

    def __init__(self, port: int, is_public: bool, title: str) -> None:
        """Listen.

        Raises:
            InputError: viser is not installed, or no port can be had.
        """
        require_viser()
        import viser

        host = EVERYWHERE if is_public else THIS_COMPUTER
        chosen = free_port(host, port)
        with contextlib.redirect_stdout(io.StringIO()):  # it prints a box with its own name
            self.viser: Any = viser.ViserServer(host=host, port=chosen, label=clean_name(title), verbose=False)
        self.viser.request_share_url = _no_tunnel  # any browser may ask for one
        self.address = f"http://{THIS_COMPUTER}:{self.viser.get_port()}"
        self.viser.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        self.viser.gui.main_panel.dock_right()
        self.viser.scene.set_up_direction("+y")
        self._refuse_other_sites(is_public)
        self.drawing: Drawing | None = None
        self._canvases: dict[int, ViserCanvas] = {}
        self._pivot = np.array([0.0, 0.0, 1.0])

    def show(self, drawing: Drawing, pivot: Float[np.ndarray, "3"]) -> None:
        """Fill the windows by a drawing thread, whose views turn about a point; also those that open later."""
        self.drawing, self._pivot = drawing, pivot
        place = resting_place(pivot, 1, 1)
        initial = self.viser.initial_camera
        initial.position, initial.look_at, initial.up = place.position, (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)
        self.viser.on_client_connect(self._opened)  # called for those that are open, too
        self.viser.on_client_disconnect(self._closed)
        drawing.start()

    def stop(self) -> None:
        """Close all windows' connections."""
        if self.drawing is not None:
            self.drawing.stop()
        with contextlib.redirect_stdout(io.StringIO()):
            self.viser.stop()

    def look_ahead(self, client: Any) -> None:
        """Move a browser's camera back to where it was at rest."""
        client.camera.position = resting_place(self._pivot, 1, 1).position
        client.camera.look_at = (0.0, 0.0, 0.0)
        client.camera.up_direction = (0.0, 1.0, 0.0)

    def _opened(self, client: Any) -> None:
        distance = float(self._pivot[2])
        client.camera.min_orbit_distance = NEAREST * distance
        client.camera.max_orbit_distance = FARTHEST * distance
        if self.drawing is not None:
            drawing = self.drawing
            canvas = self._canvases.setdefault(client.client_id, ViserCanvas(client, drawing.wake))
            client.camera.on_update(lambda _: drawing.wake())
            drawing.add(canvas)

    def _closed(self, client: Any) -> None:
        canvas = self._canvases.pop(client.client_id, None)
        if canvas is not None and self.drawing is not None:
            canvas.gone()
            self.drawing.remove(canvas)

    def _refuse_other_sites(self, is_public: bool) -> None:
        """Close connections that pages of other sites open; a browser lets every page try."""
        websockets = self.viser._websock_server  # has no such check, and no public way to add one

        async def check(connection: Any) -> None:
            opened = websockets._live_connections.get(connection.client_id)
            headers = opened.request.headers
            if not is_own_page(headers.get("Origin"), headers.get("Host"), is_public):
                await opened.close(POLICY_VIOLATION, "opened by a page of another site")

        websockets.on_client_connect(check)


def _no_tunnel() -> None:
    """What is shown leaves this computer by no tunnel; viser's would lead through a server of others."""


class ViserCanvas:
    """The window of one browser.

    A browser drops a picture that it has not decoded when the next one comes. So the next one waits until the browser
    has answered a question that was put behind the last one, and a while longer.
    """

    def __init__(self, client: Any, arrived: Callable[[], None]) -> None:
        """Prepare to show.

        Args:
            client: viser's handle.
            arrived: Called when a picture has arrived, in a thread of the canvas.
        """
        self._client, self._arrived = client, arrived
        self._under_way = threading.Event()
        self._is_gone = False

    def gone(self) -> None:
        """The browser has left."""
        self._is_gone = True

    def place(self) -> Place | None:
        """Window and camera; None before the browser has told them, and when it has left."""
        camera = self._client.camera
        width, height = int(camera.image_width), int(camera.image_height)
        if self._is_gone or width < 1 or height < 1:
            return None
        w, x, y, z = map(float, camera.wxyz)
        right, up, forward = map(float, camera.position)
        if not np.isfinite([w, x, y, z, right, up, forward]).all() or not np.hypot(np.hypot(w, x), np.hypot(y, z)):
            return None
        return Place(width, height, (w, x, y, z), (right, up, forward))

    def is_ready(self) -> bool:
        """Whether the last picture has arrived."""
        return not self._under_way.is_set()

    def show(self, image: UInt8[np.ndarray, "H W 3"], is_final: bool) -> None:
        """Send a picture behind the browser's empty scene, which it fills."""
        how = {"format": "png"} if is_final else {"format": "jpeg", "jpeg_quality": JPEG_QUALITY}
        self._under_way.set()
        with warnings.catch_warnings():  # viser warns where the browser has just left
            warnings.simplefilter("ignore", UserWarning)
            self._client.scene.set_background_image(image, **how)
            self._client.flush()
        threading.Thread(target=self._wait, daemon=True).start()

    def _wait(self) -> None:
        """Wait until the browser has answered, or has left."""
        began = time.monotonic()
        with contextlib.suppress(RuntimeError, TimeoutError):
            self._client.local_storage.get_item(QUESTION, timeout=LONGEST_WAIT)
        time.sleep(min(DECODING * (time.monotonic() - began), LONGEST_WAIT))
        self._under_way.clear()
        self._arrived()


def notify(client: Any, title: str, body: str, color: str | None = None) -> None:
    """Tell one browser's user something; nothing if the browser is gone."""
    if client is not None:
        with contextlib.suppress(Exception):
            client.add_notification(title, body, auto_close_seconds=15.0, color=color)


def by_user(act: Callable[[Any], None]) -> Callable[[Any], None]:
    """A callback for a control that passes over changes made by this program."""

    def called(event: Any) -> None:
        if event.client is not None:
            act(event)

    return called
