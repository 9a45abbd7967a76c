"""A few steps of training with every Triton kernel, interpreted, against the same steps with the kernels for CPUs."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from ggavatar.data.capture import Capture
from ggavatar.gaussians import binding, offsets
from ggavatar.geometry import triangles
from ggavatar.io.json_files import write_json
from ggavatar.jit import device_kernels
from ggavatar.losses import dssim
from ggavatar.networks import fields
from ggavatar.render.discs import rasterizer as discs
from ggavatar.training.journal import read_journal
from ggavatar.training.registry import Method
from ggavatar.training.run_folder import write_config
from ggavatar.training.session import configure, make_trainer
from ggavatar.training.trainer import StopSignals
from tests.support.kernel_compiler import recorded_launches
from tests.support.triton_kernels import interpreted

pytestmark = interpreted


def logged(capture: Capture, folder: Path, method: str, settings: list[str], steps: int) -> list[dict[str, Any]]:
    """The terms of the objective at every step, on frames of 16 × 16 px."""
    options = {"method": method, "steps": steps, "eval_every": 0, "max_gaussians": 200, "device": "cpu"}
    config, split = configure(capture, {**options, "set": settings})
    plan = dataclasses.replace(config.training, log_every=1, resolutions=((1.0, 0.34),), smallest=16)
    config = dataclasses.replace(config, training=plan)
    folder.mkdir(parents=True)
    write_config(folder, config, split)
    write_json(folder / "provenance.json", {})
    make_trainer(folder, config, capture, split).run(0, StopSignals())
    lines = read_journal(folder / "metrics/train.jsonl")
    return [{key: value for key, value in line.items() if key != "seconds"} for line in lines]


@pytest.fixture
def _on_this_device(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Makes CPU tensors take the way of those on CUDA."""

    def change() -> None:
        from ggavatar.render.triton.rasterizer import TileRasterizer

        for module in (fields, dssim, binding, offsets, triangles):
            monkeypatch.setattr(module, "compiled_for", lambda *_: False)
        monkeypatch.setattr(device_kernels, "missing", lambda kind: "")
        monkeypatch.setattr(device_kernels, "run_on", lambda *tensors: all(t.dtype != torch.float64 for t in tensors))
        own = {"point_avatar": lambda: discs.rasterizer("cuda")}
        monkeypatch.setattr(Method, "rasterizer", lambda self, *_: own.get(self.name, TileRasterizer)())

    return change


KERNELS = {
    "ggavatar": {
        *("project_gaussians", "list_pairs", "finish_lists", "draw_tiles"),
        *("differentiate_tiles", "differentiate_gaussians", "finish_pose"),
        *("look_up_points", "spread_gradient", "place_frames"),
        *("bind_gaussians", "differentiate_binding", "refine_gaussians", "differentiate_refinement"),
        *("blur_products", "blur_means", "compare", "finish_terms", "blur_derivatives", "differentiate_terms"),
    },
    "point_avatar": {
        *("place_discs", "list_pairs", "finish_lists", "draw_discs", "differentiate_discs", "gather_discs"),
    },
}
"""Kernels that a step launches."""


@pytest.mark.parametrize(
    ("method", "settings", "steps"),
    [("ggavatar", ["neutral_iterations=1", "perceptual_weight=0"], 2), ("point_avatar", ["perceptual_weight=0"], 2)],
)
@pytest.mark.slow
def test_a_few_steps_equal_those_of_the_kernels_for_cpus(
    method: str,
    settings: list[str],
    steps: int,
    toy_capture: Capture,
    tmp_path: Path,
    _on_this_device: Callable[[], None],
) -> None:
    expected = logged(toy_capture, tmp_path / "cpu", method, settings, steps)
    _on_this_device()
    with recorded_launches() as launches:
        found = logged(toy_capture, tmp_path / "triton", method, settings, steps)
    assert {launch.name for launch in launches} >= KERNELS[method]
    assert len(found) == len(expected) == steps
    for line, like in zip(found, expected, strict=True):
        assert line["gaussians"] == like["gaussians"]
        assert line["terms"] == pytest.approx(like["terms"], rel=1e-3, abs=1e-6)
