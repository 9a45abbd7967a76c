"""The device that `auto` will mean: what torch itself says is the reference."""

from __future__ import annotations

import subprocess
import sys

import pytest

from ggavatar.cli import likely_device as module
from ggavatar.render.backends import resolve_device


def test_it_agrees_with_torch() -> None:
    assert module.likely_device() == resolve_device("auto")
    assert module.device_default() == {"device": f"auto, here {resolve_device('auto')}"}


@pytest.mark.parametrize(("built", "devices", "found"), [(True, 1, "cuda"), (True, 0, "cpu"), (False, 2, "cpu")])
def test_both_torch_and_the_driver_are_needed(
    built: bool, devices: int, found: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_torch_has_cuda", lambda: built)
    monkeypatch.setattr(module, "_devices_of_the_driver", lambda: devices)
    module.likely_device.cache_clear()
    assert module.likely_device() == found
    module.likely_device.cache_clear()


def test_a_computer_without_a_driver_has_no_device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "DRIVER", "no-such-library.so")
    assert module._devices_of_the_driver() == 0


def test_it_needs_no_torch() -> None:
    code = (
        "import sys; from ggavatar.cli.likely_device import likely_device; likely_device(); "
        "print('torch' in sys.modules)"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert shown.strip() == "False"
