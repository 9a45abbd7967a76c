"""Reads from a run's files how it was trained: preset, steps, features of the perceptual loss, changed settings."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from evaluate.protocols.setup import Setup
from ggavatar.errors import InputError
from ggavatar.training import registry
from ggavatar.training.plan import preset
from ggavatar.training.run_folder import Run, RunConfig

WITHOUT_INFLUENCE = ("steps", "eval_every", "eval_frames", "save_every", "log_every", "cache_mib", "bad_steps")
"""Fields of the plan that do not change what a training of a given length learns; the length is stated by itself."""


def setup_of_run(run: Run) -> Setup:
    """The setup of an opened run or of a file of Gaussians opened as one."""
    if "file" in run.provenance:
        return Setup("gaussian file")
    features = perceptual_features(run.provenance, run.config.method_config)
    return Setup("run", run.config.method, run.config.preset, run.step, features, changed_settings(run.config))


def perceptual_features(provenance: Mapping[str, Any], settings: Mapping[str, Any]) -> str:
    """Features of the perceptual loss: as the training recorded them, else as it was set; `none` without the loss."""
    notes = provenance.get("notes")
    found = provenance.get("perceptual_loss") or (notes.get("perceptual_loss") if isinstance(notes, Mapping) else None)
    wanted = settings.get("perceptual_features") if settings.get("perceptual_weight") else None
    return str(found or wanted or "none")


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
