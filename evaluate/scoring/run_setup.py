"""Reads from a run's files how it was trained: preset, steps, features of the perceptual loss, changed settings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from evaluate.protocols.setup import AS_TRACKED, REFINED, Setup
from ggavatar.text.names import clean_text, clean_values
from ggavatar.training.changed_settings import changed_settings
from ggavatar.training.run_folder import Run


def setup_of_run(run: Run) -> Setup:
    """The setup of an opened run or of a file of Gaussians opened as one."""
    if "file" in run.provenance:
        return Setup("gaussian file")
    features = perceptual_features(run.provenance, run.config.perceptual_features)
    changed, tracking = clean_values(dict(changed_settings(run.config))), tracking_of(run.capture.source)
    return Setup(
        "run", run.config.method, clean_text(run.config.preset), run.step, clean_text(features), changed, tracking
    )


def tracking_of(source: Mapping[str, Any]) -> str | None:
    """Whether a capture's tracking was refined, as its `source` says; None if it does not, as of an earlier version."""
    found = source.get("refinement")
    if not isinstance(found, Mapping) or "refined" not in found:
        return None
    return REFINED if found["refined"] else AS_TRACKED


def perceptual_features(provenance: Mapping[str, Any], wanted: Any) -> str:
    """Features of the perceptual loss: as the training recorded them, else as it was set; `none` without the loss."""
    notes = provenance.get("notes")
    found = provenance.get("perceptual_loss") or (notes.get("perceptual_loss") if isinstance(notes, Mapping) else None)
    return str(found or wanted or "none")
