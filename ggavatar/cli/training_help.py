"""What the help pages of `ggavatar-train` and `ggavatar-sweep` list: methods, and defaults on this computer."""

from __future__ import annotations

from ggavatar.cli.likely_device import device_default, likely_device
from ggavatar.training import registry
from ggavatar.training.plan import preset

BACKEND_NAMES = ("auto", "cpu", "triton", "gsplat", "reference")
"""Those of `ggavatar.render.backends`, which imports torch."""
PLANNED = ("steps", "max_gaussians", "eval_every", "save_every")
"""Flags that change a training's plan, named as its fields."""


def training_defaults() -> dict[str, str]:
    """What flags of a training stand for that are not given: the preset `default` on the device of this computer."""
    plan = preset("default", likely_device())
    planned = {name: f"{getattr(plan, name):,} with the preset default on this device" for name in PLANNED}
    own = {"preset": "default", "backend": "auto", "seed": "42"}
    return {**own, **device_default(), "split": "every-20th", "background": "white", **planned}


def method_lines() -> list[str]:
    """Every method in one line, and its variants below it."""
    known = registry.names()
    lines = ["methods (METHOD):"]
    method = ""
    for name, text in known.items():  # variants come after their method, which begins their description
        if method and name.startswith(f"{method}_") and text.startswith(f"{method}, "):
            lines.append(f"      {name}")
        else:
            method = name
            lines.append(f"  {name:<22}{text}")
    return [*lines, *(f"note: {text}" for text in registry.problems().values())]
