"""How the images of an evaluation came about: method, preset, length, perceptual features, or made elsewhere."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, get_args

Origin = Literal["run", "gaussian file", "elsewhere", "not recorded"]
NOT_RECORDED: Literal["not recorded"] = "not recorded"
REFINED, AS_TRACKED = "refined", "as tracked"


@dataclass(frozen=True)
class Setup:
    """What a row of a table stands for besides its label.

    Attributes:
        origin: A run of ours, a file of Gaussians that we rendered, pictures rendered elsewhere, or `not recorded` (a
            result of version 0.1).
        method: Name of the method on the command line, whatever the label of the row.
        preset: Preset of the training.
        steps: Steps trained.
        perceptual_loss: Features of the perceptual loss: `vgg16`, `random`, `none`, or a name of an earlier version.
        changed: Settings that differ from the preset, by name.
        tracking: `refined` if a short avatar corrected the capture's tracking against its pictures, else `as tracked`;
            None if the capture does not say.
    """

    origin: Origin = NOT_RECORDED
    method: str | None = None
    preset: str | None = None
    steps: int | None = None
    perceptual_loss: str | None = None
    changed: Mapping[str, Any] = field(default_factory=dict)
    tracking: str | None = None

    @property
    def facts(self) -> dict[str, str]:
        """What the training was given, as text by heading; empty unless the images are those of a run."""
        if self.origin != "run":
            return {}
        return {
            "preset": self.preset or NOT_RECORDED,
            "length": NOT_RECORDED if self.steps is None else f"{self.steps} steps",
            "perceptual loss": self.perceptual_loss or NOT_RECORDED,
            "tracking": self.tracking or NOT_RECORDED,
            "changed settings": ", ".join(f"{name}={_short(value)}" for name, value in self.changed.items()) or "none",
        }

    def describe(self) -> str:
        """The setup in a few words, such as `preset fast, 1500 steps, perceptual loss vgg16`."""
        others = {
            "gaussian file": "a file of Gaussians, rendered here",
            "elsewhere": "rendered elsewhere",
            NOT_RECORDED: "setup not recorded",
        }
        if self.origin != "run":
            return others[self.origin]
        facts = self.facts
        words = f"preset {facts['preset']}, {facts['length']}, perceptual loss {facts['perceptual loss']}"
        words += ", refined tracking" if self.tracking == REFINED else ""
        return f"{words}, {facts['changed settings']}" if self.changed else words

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON values."""
        return {**asdict(self), "changed": dict(self.changed)}


def setup_from_dict(values: Mapping[str, Any]) -> Setup:
    """The setup in a result file; one without it gives a setup that is not recorded.

    Raises:
        ValueError: A value has another type than ours.
    """
    if not values:
        return Setup()
    if values.get("origin") not in get_args(Origin):
        raise ValueError(f"setup: expected origin to be one of {', '.join(get_args(Origin))}, found {values}")
    for name, kind in (("method", str), ("preset", str), ("steps", int), ("perceptual_loss", str), ("tracking", str)):
        if values.get(name) is not None and type(values[name]) is not kind:
            raise ValueError(f"setup: expected {name} to be {kind.__name__}, found {values[name]!r}")
    known = {name: values.get(name) for name in ("method", "preset", "steps", "perceptual_loss", "tracking")}
    return Setup(values["origin"], changed=dict(values.get("changed") or {}), **known)


def _short(value: Any) -> str:
    """A setting in a few characters."""
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 40 else f"{text[:37]}…"
