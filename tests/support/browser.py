"""A page in headless Chromium, controlled by the DevTools protocol as NUL-terminated JSON over two pipes (POSIX)."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

FLAGS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking")
READ_END, WRITE_END = 3, 4
"""File descriptors from which Chromium reads and to which it writes."""


def chromium() -> str | None:
    """The browser on the path, if there is one; none on Windows, where these pipes do not work."""
    if sys.platform == "win32":
        return None
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


class Page:
    """An open page: evaluates expressions, drags the mouse, and records requests and exceptions."""

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
        """Value of an expression in the page."""
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def drag(self, selector: str, start: float, end: float) -> None:
        """Drag the mouse over an element, from and to a fraction of its width."""
        box = f"JSON.stringify(document.querySelector('{selector}').getBoundingClientRect())"
        self.value(f"document.querySelector('{selector}').scrollIntoView({{block: 'center'}})")
        place = json.loads(self.value(box))
        y = place["y"] + place["height"] / 2
        for kind, fraction in (("mousePressed", start), ("mouseMoved", end), ("mouseReleased", end)):
            x = place["x"] + place["width"] * fraction
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)


@contextmanager
def opened(browser: str, page: Path, profile: Path) -> Iterator[Page]:
    """Open a local page in a separate browser, which ends with the block."""
    import fcntl  # POSIX only

    (child_in, out), (back, child_out) = os.pipe(), os.pipe()

    def connect() -> None:
        # Duplicate first: one of the pipes may occupy the descriptor that the other needs.
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
