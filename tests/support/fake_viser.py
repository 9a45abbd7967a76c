"""A stand-in for viser's server: a panel without a browser, whose controls a test moves as a user would."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np


class FakeControl:
    """A control of any kind, with the attributes that ours use."""

    def __init__(self, kind: str, label: str, value: Any = None, **attributes: Any) -> None:
        self.kind, self.label, self.value = kind, label, value
        self.callbacks: list[Callable[[Any], None]] = []
        for name, attribute in attributes.items():
            setattr(self, name, attribute)

    def on_update(self, callback: Callable[[Any], None]) -> None:
        self.callbacks.append(callback)

    on_click = on_update

    def use(self, value: Any = None, client: Any = "somebody") -> None:
        """Move or click the control, as the user of a browser does."""
        self.value = value
        for callback in self.callbacks:
            callback(SimpleNamespace(client=client, target=self))


class FakeGui:
    """Controls in the order in which they were added."""

    def __init__(self) -> None:
        self.controls: list[FakeControl] = []
        self.folders: list[str] = []

    def _added(self, *given: Any, **attributes: Any) -> FakeControl:
        self.controls.append(FakeControl(*given, **attributes))
        return self.controls[-1]

    def add_html(self, content: str) -> FakeControl:
        return self._added("html", "", content=content)

    def add_dropdown(self, label: str, options: Any, initial_value: str) -> FakeControl:
        return self._added("dropdown", label, initial_value, options=options)

    def add_checkbox(self, label: str, initial_value: bool) -> FakeControl:
        return self._added("checkbox", label, initial_value)

    def add_button(self, label: str, **_: Any) -> FakeControl:
        return self._added("button", label)

    def add_slider(self, label: str, low: float, high: float, step: float, initial_value: float) -> FakeControl:
        assert low <= initial_value <= high and low < high, label
        return self._added("slider", label, initial_value, min=low, max=high, step=step)

    @contextlib.contextmanager
    def add_folder(self, label: str, **_: Any) -> Iterator[None]:
        self.folders.append(label)
        yield

    def named(self, label: str) -> FakeControl:
        """The control with a label."""
        return next(control for control in self.controls if control.label == label)


class FakeClient:
    """A browser that notes what it is told."""

    def __init__(self) -> None:
        self.notes: list[tuple[str, str]] = []
        self.files: list[tuple[str, bytes]] = []
        self.camera = SimpleNamespace(position=np.ones(3), look_at=np.ones(3), up_direction=np.ones(3))

    def add_notification(self, title: str, body: str, **_: Any) -> None:
        self.notes.append((title, body))

    def send_file_download(self, name: str, content: bytes, **_: Any) -> None:
        self.files.append((name, content))


class FakeServer:
    """In place of `evaluate.viewer.server.ViewerServer`."""

    def __init__(self) -> None:
        self.viser = SimpleNamespace(gui=FakeGui())
        self.fronts: list[Any] = []

    def look_ahead(self, client: Any) -> None:
        self.fronts.append(client)
