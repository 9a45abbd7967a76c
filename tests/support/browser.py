"""A page in headless Chromium, controlled by the DevTools protocol as NUL-terminated JSON over two pipes (POSIX)."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

SOFTWARE_GL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
"""WebGL without a graphics card."""
FLAGS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking")
NETWORK_REQUEST = "Network.requestWillBeSent"
KEY_CODES = {"ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, "ArrowDown": 40, "Home": 36, "Enter": 13, "Tab": 9}
READ_END, WRITE_END = 3, 4
"""File descriptors from which Chromium reads and to which it writes."""


def chromium() -> str | None:
    """The browser on the path, if there is one; none on Windows, where these pipes do not work."""
    if sys.platform == "win32":
        return None
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


class Page:
    """An open page: evaluates expressions, plays mouse, keys and files, records requests, messages and exceptions."""

    def __init__(self, out: int, back: int, address: str, width: int, height: int, is_offline: bool = True) -> None:
        self._out, self._back, self._buffer, self._count = out, back, b"", 0
        self.events: list[dict[str, Any]] = []
        self._session = ""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log", "DOM"):
            self.call(f"{domain}.enable")
        self.call(
            "Network.emulateNetworkConditions",
            offline=is_offline,
            latency=0,
            downloadThroughput=-1,
            uploadThroughput=-1,
        )
        self.resize(width, height)
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
        """Value of an expression in the page, or what it resolves to."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def requests(self) -> list[str]:
        """Addresses of everything that was asked for."""
        return [event["params"]["request"]["url"] for event in self.events if event["method"] == NETWORK_REQUEST]

    def messages(self) -> list[str]:
        """Exceptions, messages of the console, and what the browser complains about."""
        self.value("0")  # events that are under way arrive before the answer
        found = []
        for event in self.events:
            parameters = event["params"]
            if event["method"] == "Runtime.exceptionThrown":
                found.append(str(parameters["exceptionDetails"]))
            elif event["method"] == "Runtime.consoleAPICalled":
                found.append(" ".join(str(one.get("value", one.get("description"))) for one in parameters["args"]))
            elif event["method"] == "Log.entryAdded":
                found.append(parameters["entry"]["text"])
        return found

    def resize(self, width: int, height: int, scheme: str = "light") -> None:
        """Show the page in a window of this size in px, in light or dark colors."""
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 500
        )
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])

    def screenshot(self, path: Path) -> None:
        """Write what is seen as PNG."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))

    def press(self, key: str, times: int = 1) -> None:
        """Press a key that is not a letter, such as ArrowRight, on the element with the focus."""
        code = KEY_CODES[key]
        for _ in range(times):
            for kind in ("rawKeyDown", "keyUp"):
                self.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code)

    def choose_file(self, selector: str, path: Path) -> None:
        """Choose a file in an `<input type=file>`."""
        root = self.call("DOM.getDocument")["root"]["nodeId"]
        node = self.call("DOM.querySelector", nodeId=root, selector=selector)["nodeId"]
        self.call("DOM.setFileInputFiles", nodeId=node, files=[str(path)])

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
def opened(
    browser: str, page: Path, profile: Path, query: str = "", size: tuple[int, int] = (1100, 800)
) -> Iterator[Page]:
    """Open a local page in a separate browser without network, which ends with the block."""
    with connected(browser, page.as_uri() + query, profile, size) as view:
        yield view


@contextmanager
def connected(
    browser: str, address: str, profile: Path, size: tuple[int, int] = (1100, 800), is_offline: bool = True
) -> Iterator[Page]:
    """Open an address in a separate browser, which ends with the block."""
    import fcntl  # POSIX only

    (child_in, out), (back, child_out) = os.pipe(), os.pipe()

    def connect() -> None:
        # Duplicate first: one of the pipes may occupy the descriptor that the other needs.
        ends = [fcntl.fcntl(end, fcntl.F_DUPFD, 20) for end in (child_in, child_out)]
        os.dup2(ends[0], READ_END)
        os.dup2(ends[1], WRITE_END)

    command = [browser, *FLAGS, *SOFTWARE_GL, "--remote-debugging-pipe", f"--user-data-dir={profile}", "about:blank"]
    process = subprocess.Popen(command, preexec_fn=connect, close_fds=False, stderr=subprocess.DEVNULL)
    os.close(child_in)
    os.close(child_out)
    try:
        yield Page(out, back, address, *size, is_offline)
    finally:
        process.terminate()
        process.wait(30)
        os.close(out)
        os.close(back)
