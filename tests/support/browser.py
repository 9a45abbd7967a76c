"""A page in headless Chromium, driven as by a hand: the DevTools protocol as NUL-terminated JSON over two pipes."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

FLAGS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking")
READ_END, WRITE_END = 3, 4
"""File descriptors at which Chromium listens and speaks."""


def chromium() -> str | None:
    """The browser on the path, if there is one."""
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


class Page:
    """An open page: evaluate an expression, press the mouse, and see what was requested and what went wrong."""

    def __init__(self, out: int, back: int, address: str) -> None:
        self._out, self._back, self._buffer, self._count = out, back, b"", 0
        self.events: list[dict[str, Any]] = []
        self._session = ""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network"):
            self.call(f"{domain}.enable")
        self.call("Page.navigate", url=address)
        while not any(event["method"] == "Page.loadEventFired" for event in self.events):
            self.events.append(self._message())

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """The answer to a command; events that arrive before it are kept."""
        self._count += 1
        command = {"id": self._count, "method": method, "params": parameters}
        command |= {"sessionId": self._session} if self._session else {}
        os.write(self._out, json.dumps(command).encode() + b"\0")
        while "id" not in (message := self._message()):
            self.events.append(message)
        assert "error" not in message, message
        return message["result"]

    def _message(self) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            received = os.read(self._back, 1 << 20)
            assert received, "the browser ended"
            self._buffer += received
        message, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(message)

    def value(self, expression: str) -> Any:
        """What an expression is in the page."""
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def drag(self, selector: str, start: float, end: float) -> None:
        """Press the mouse on an element at a share of its width, move it to another, and let go."""
        box = f"JSON.stringify(document.querySelector('{selector}').getBoundingClientRect())"
        self.value(f"document.querySelector('{selector}').scrollIntoView({{block: 'center'}})")
        place = json.loads(self.value(box))
        y = place["y"] + place["height"] / 2
        for kind, share in (("mousePressed", start), ("mouseMoved", end), ("mouseReleased", end)):
            x = place["x"] + place["width"] * share
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)


@contextmanager
def opened(browser: str, page: Path, profile: Path) -> Iterator[Page]:
    """A page of the file system in a browser of its own, which ends with the block."""
    (child_in, out), (back, child_out) = os.pipe(), os.pipe()

    def connect() -> None:
        # First out of the way: one of the pipes may lie where the other has to go.
        ends = [fcntl.fcntl(end, fcntl.F_DUPFD, 20) for end in (child_in, child_out)]
        os.dup2(ends[0], READ_END)
        os.dup2(ends[1], WRITE_END)

    command = [browser, *FLAGS, "--remote-debugging-pipe", f"--user-data-dir={profile}", "about:blank"]
    process = subprocess.Popen(command, preexec_fn=connect, close_fds=False, stderr=subprocess.DEVNULL)
    os.close(child_in)
    os.close(child_out)
    try:
        yield Page(out, back, page.as_uri())
    finally:
        process.terminate()
        process.wait(30)
        os.close(out)
        os.close(back)
