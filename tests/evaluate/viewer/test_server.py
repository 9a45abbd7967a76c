"""The server: its address, who may connect, and what names can do to the panel.

Also covers `evaluate/viewer/texts.py`. Reference: connections made here, and the HTML parser of the standard library.
"""

from __future__ import annotations

import asyncio
import socket
import sys
import threading
from collections.abc import Iterator
from html.parser import HTMLParser
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from evaluate.viewer.address import PORTS_TRIED, free_port, is_own_page
from evaluate.viewer.server import ViewerServer, ViserCanvas, by_user, notify
from evaluate.viewer.texts import bullets, lines
from ggavatar.errors import InputError
from tests.support.hostile_names import HOSTILE

viser = pytest.importorskip("viser", reason="needs viser, which serves the viewer: pip install viser")
websockets = pytest.importorskip("websockets.asyncio.client")


@pytest.fixture
def server() -> Iterator[ViewerServer]:
    made = ViewerServer(0, False, "somebody")
    yield made
    made.stop()


def test_it_listens_on_this_computer_alone(server: ViewerServer) -> None:
    port = server.viser.get_port()
    assert server.address == f"http://127.0.0.1:{port}" and server.viser.get_host() == "127.0.0.1"
    with socket.create_connection(("127.0.0.1", port), 5) as connection:
        assert connection.getpeername()[0] == "127.0.0.1"
    with socket.socket() as other, pytest.raises(OSError):
        other.settimeout(5)
        other.connect(("127.0.0.2", port))  # Linux has the whole network 127 for itself


def test_the_next_port_is_taken_where_one_is_in_use(server: ViewerServer) -> None:
    taken = server.viser.get_port()
    assert taken < free_port("127.0.0.1", taken) <= taken + PORTS_TRIED
    second = ViewerServer(taken, False, "somebody")
    assert second.viser.get_port() != taken
    second.stop()


def test_no_port_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"--port"):
        free_port("203.0.113.1", 8080)  # no address of this computer (RFC 5737)


def test_without_viser_the_command_to_get_it_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(InputError, match="pip install"):
        ViewerServer(0, False, "somebody")


@pytest.mark.parametrize(
    ("origin", "host", "is_public", "expected"),
    [
        (None, "127.0.0.1:8080", False, True),
        ("http://127.0.0.1:8080", "127.0.0.1:8080", False, True),
        ("http://localhost:9000", "localhost:9000", False, True),  # at the end of a tunnel
        ("http://[::1]:8080", "[::1]:8080", False, True),
        ("https://evil.example", "127.0.0.1:8080", False, False),
        ("http://127.0.0.1:9999", "127.0.0.1:8080", False, False),  # another program's page
        ("null", "127.0.0.1:8080", False, False),
        ("http://rebound.example:8080", "rebound.example:8080", False, False),
        ("http://studio.lan:8080", "studio.lan:8080", True, True),
        ("https://evil.example", "studio.lan:8080", True, False),
        ("http://[", "127.0.0.1:8080", False, False),
        ("http://127.0.0.1:8080", None, False, False),
    ],
)
def test_whose_pages_may_connect(origin: str | None, host: str | None, is_public: bool, expected: bool) -> None:
    assert is_own_page(origin, host, is_public) == expected


@pytest.mark.parametrize(("site", "is_let_in"), [("https://evil.example", False), (None, True)])
def test_pages_of_other_sites_are_shut_out(server: ViewerServer, site: str | None, is_let_in: bool) -> None:
    async def connect() -> bool:
        address = server.address.replace("http", "ws")
        protocol = websockets.Subprotocol(f"viser-v{viser.__version__}") if hasattr(websockets, "Subprotocol") else None
        origin = site or server.address
        chosen = [protocol or f"viser-v{viser.__version__}"]
        async with websockets.connect(address, origin=origin, subprotocols=chosen, compression=None) as opened:
            try:
                return bool(await asyncio.wait_for(opened.recv(), 10))
            except Exception as error:
                assert "1008" in str(error), error
                return False

    assert asyncio.run(connect()) == is_let_in


def test_no_tunnel_is_opened_whoever_asks(server: ViewerServer) -> None:
    assert server.viser.request_share_url() is None


class Tags(HTMLParser):
    """Elements and attributes of a piece of HTML."""

    def __init__(self) -> None:
        super().__init__()
        self.found: set[str] = set()

    def handle_starttag(self, tag: str, attributes: Any) -> None:
        self.found |= {tag, *(name for name, _ in attributes)}


@pytest.mark.parametrize("name", HOSTILE)
def test_names_stay_texts(name: str) -> None:
    tags = Tags()
    tags.feed(lines(name, "") + bullets(name, [name], "none") + bullets("title", [], name))
    assert {"div", "ul", "li"} <= tags.found <= {"div", "style", "b", "ul", "li"}


def test_a_browser_that_is_gone_is_told_nothing() -> None:
    class Gone:
        def add_notification(self, *_: Any, **__: Any) -> None:
            raise ConnectionError

    notify(Gone(), "title", "body")
    notify(None, "title", "body")


def test_callbacks_are_for_users() -> None:
    seen: list[Any] = []
    called = by_user(seen.append)
    from_program, from_user = (type("Event", (), {"client": client})() for client in (None, 3))
    called(from_program)
    called(from_user)
    assert seen == [from_user]


def test_windows_without_size_or_sense_are_not_drawn() -> None:
    def place(**changes: Any) -> Any:
        values = {"image_width": 640, "image_height": 480, "wxyz": np.array([0, 1.0, 0, 0]), "position": np.ones(3)}
        camera = type("Camera", (), values | changes)()
        return ViserCanvas(type("Client", (), {"camera": camera})(), lambda: None).place()

    found = place()
    assert (found.width, found.height, found.wxyz) == (640, 480, (0.0, 1.0, 0.0, 0.0))
    assert place(image_width=0) is None
    assert place(position=np.array([np.nan, 0, 0])) is None
    assert place(wxyz=np.zeros(4)) is None


def test_the_next_picture_waits_for_the_answer_of_the_browser() -> None:
    answered, arrived = threading.Event(), threading.Event()
    sent: list[Any] = []

    class Client:
        scene = SimpleNamespace(set_background_image=lambda image, **how: sent.append(how["format"]))
        local_storage = SimpleNamespace(get_item=lambda key, timeout: answered.wait(30) and None)

        def flush(self) -> None:
            sent.append("flush")

    canvas = ViserCanvas(Client(), arrived.set)
    assert canvas.is_ready()
    canvas.show(np.zeros((2, 2, 3), np.uint8), is_final=False)
    assert not canvas.is_ready() and sent == ["jpeg", "flush"]
    answered.set()
    assert arrived.wait(30) and canvas.is_ready()


def test_a_browser_that_does_not_answer_is_not_waited_for() -> None:
    arrived = threading.Event()

    def silent(key: str, timeout: float) -> None:
        raise TimeoutError

    client = SimpleNamespace(
        scene=SimpleNamespace(set_background_image=lambda image, **how: None), flush=lambda: None,
        local_storage=SimpleNamespace(get_item=silent), camera=SimpleNamespace(image_width=1, image_height=1),
    )  # fmt: skip
    canvas = ViserCanvas(client, arrived.set)
    canvas.show(np.zeros((2, 2, 3), np.uint8), is_final=True)
    assert arrived.wait(30) and canvas.is_ready()
    canvas.gone()
    assert canvas.place() is None
