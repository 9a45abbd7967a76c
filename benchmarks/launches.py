"""Kernel launches and host-device synchronizations of every method, counted on a pretended CUDA device.

Nothing is timed, and no GPU is needed. A step is a steady one: not a round of density control, a logged step, a
checkpoint or an evaluation, and of a frame that was trained on before. A frame is rendered as evaluation does.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.pretended.capture import FRAMES, write_capture
from benchmarks.pretended.device import pretended_cuda
from benchmarks.pretended.training import Counts, count_frame, make_pretended_trainer, train_counted
from ggavatar.data.capture import Capture
from ggavatar.training import registry

FIRST = "ggavatar"
"""The method whose counts are also at the top of the result."""
STEPS = FRAMES + 4
SETTINGS = {"point_avatar": ("tracking_rate=0.0",)}
"""Corrections of the tracking are off in `point_avatar`: a pretended `to` loses the hook that makes them sparse."""


def methods() -> list[str]:
    """Every method, without variants."""
    stems = {path.stem for path in registry.METHODS_FOLDER.glob("*.py")}
    return [name for name in registry.names() if name in stems]


def count(method: str, capture: Capture, folder: Path, *settings: str) -> dict[str, Any]:
    """Counts of a method with the settings of its paper, and others by name."""
    with pretended_cuda(with_kernels=True) as tally:
        options = {"preset": "paper", "steps": STEPS, "set": (*SETTINGS.get(method, ()), *settings)}
        trainer = make_pretended_trainer(method, capture, folder, options)
        set_up = Counts.of(tally)
        step = train_counted(trainer, tally).steps[STEPS - 1]
        frame = count_frame(trainer, tally)
    return {
        "launches_per_step": step.launches,
        "syncs_per_step": step.syncs,
        "launches_per_frame": frame.launches,
        "syncs_per_frame": frame.syncs,
        "launches_of_set_up": set_up.launches,
        "syncs_of_set_up": set_up.syncs,
        "waits": step.places | frame.places,
        "settings": list(SETTINGS.get(method, ())),
    }


def _has_perceptual_loss(method: str) -> bool:
    return bool(getattr(registry.load(method).config("paper"), "perceptual_weight", 0))


def run(options: argparse.Namespace) -> dict[str, object]:
    """Count all methods, or the first one."""
    names = [FIRST] if options.quick else methods()
    with tempfile.TemporaryDirectory() as folder:
        capture = write_capture(Path(folder) / "capture")
        found = {name: count(name, capture, Path(folder) / name) for name in names}
        for name in filter(_has_perceptual_loss, names):
            bare = count(name, capture, Path(folder) / f"{name}-bare", "perceptual_weight=0")
            found[name]["launches_per_step_without_vgg"] = bare["launches_per_step"]
    top = {name: value for name, value in found[FIRST].items() if name.endswith(("_per_step", "_per_frame"))}
    note = {
        "device": "pretended: nothing is timed",
        "kernels": "ours in Triton, counted and not run; operations of torch as launches that they are known to need",
    }
    return top | {"counted_on": note, "methods": found}
