"""Checks of a whole sweep before its first training: captures, methods, settings, and what is already in its folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.sweeps.cell import Cell
from ggavatar.training.run_folder import RunConfig, read_config
from ggavatar.training.same_capture import require_same_capture
from ggavatar.training.session import configure, with_settled_features

SHARED_FLAGS = ("preset", "steps", "max_gaussians", "split")
"""Flags that an earlier run in the same folder must have been trained with."""


def check_cells(cells: Sequence[Cell], options: Mapping[str, Any]) -> None:
    """Check that every cell can be configured, and that runs in its folder were trained with the same flags and frames.

    Args:
        cells: The grid.
        options: Flags for every training by name, as for `ggavatar.training.session.configure`; absent ones take their
            default. `set` is a list of `field=value`.

    Raises:
        InputError: A capture, method, setting or flag cannot be used; the message names the first.
    """
    opened: dict[Path, Capture] = {}
    digests: dict[Path, str] = {}
    configured: dict[tuple[Path, str], RunConfig] = {}
    for cell in cells:
        key = cell.capture, cell.method
        if key not in configured:
            capture = opened.setdefault(cell.capture, _opened(cell.capture, opened))
            configured[key], _ = configure(capture, {**options, "method": cell.method})
        if cell.has_begun:
            _check_earlier(cell, configured[key], options)
            if cell.capture not in digests:
                digests[cell.capture] = opened[cell.capture].digest()
            require_same_capture(cell.folder, read_config(cell.folder), opened[cell.capture], digests[cell.capture])
    for config in {config.perceptual_features: config for config in configured.values()}.values():
        with_settled_features(config)  # fetched or refused once, before the first training


def _opened(folder: Path, opened: Mapping[Path, Capture]) -> Capture:
    return opened[folder] if folder in opened else Capture.open(folder)


def _check_earlier(cell: Cell, wanted: RunConfig, options: Mapping[str, Any]) -> None:
    """Compare the run in a cell's folder with the flags that were given; those that were not may differ."""
    found = read_config(cell.folder)
    names = [name for name in SHARED_FLAGS if name in options]
    pairs = {name: (_value(found, name), _value(wanted, name)) for name in names}
    for assignment in options.get("set", ()):
        name = assignment.partition("=")[0].strip()
        pairs[name] = (found.method_config.get(name), wanted.method_config[name])
    for name, (old, new) in pairs.items():
        if _plain(old) != _plain(new):
            raise InputError(
                f"{cell.folder}: already holds a run with {name} = {old}, found {new}; choose another folder with -o, "
                "or give the flags of the earlier sweep to resume it"
            )


def _value(config: RunConfig, name: str) -> Any:
    return getattr(config, name) if hasattr(config, name) else getattr(config.training, name)


def _plain(value: Any) -> Any:
    return [_plain(item) for item in value] if isinstance(value, (list, tuple)) else value
