"""What a run was given beyond its preset: settings of the method and of the plan that differ from it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from ggavatar.errors import InputError
from ggavatar.training import registry
from ggavatar.training.plan import preset
from ggavatar.training.run_folder import RunConfig

WITHOUT_INFLUENCE = ("steps", "eval_every", "eval_frames", "save_every", "log_every", "cache_mib", "bad_steps")
"""Fields of the plan that do not change what a training of a given length learns; the length is stated by itself."""


def changed_settings(config: RunConfig) -> dict[str, Any]:
    """Settings of the method and of the plan that differ from the preset as it is now; empty for unknown methods."""
    plan = _fields(preset(config.preset, config.device))
    found = _differences(_fields(config.training), {k: v for k, v in plan.items() if k not in WITHOUT_INFLUENCE})
    try:
        usual = _fields(registry.load(config.method).config(config.preset))
    except InputError:
        return found
    usual.pop("perceptual_features", None)  # stated by itself, and settled for the training
    return found | _differences(config.method_config, usual)


def _fields(config: Any) -> dict[str, Any]:
    return {item.name: getattr(config, item.name) for item in dataclasses.fields(config)}


def _differences(own: Mapping[str, Any], usual: Mapping[str, Any]) -> dict[str, Any]:
    """Values of `own` that differ from the usual; a list equals a tuple of the same values."""
    return {name: own[name] for name in usual if name in own and _plain(own[name]) != _plain(usual[name])}


def _plain(value: Any) -> Any:
    return [_plain(item) for item in value] if isinstance(value, (list, tuple)) else value
