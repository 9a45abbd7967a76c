"""Every method on a pretended CUDA device: it lives there, its steps do not wait for the device, and are counted.

Reference: CUDA's rules as torch states them (tensors of one device, no `numpy`, a CUDA generator for CUDA tensors), and
hand-counted operations. The limits are the counts of the present code: lower them with it.

Also covers `benchmarks/launches.py`.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import pytest
import torch

from benchmarks.launches import SETTINGS, count, methods, run
from benchmarks.pretended.capture import write_capture
from benchmarks.pretended.device import pretended_cuda
from benchmarks.pretended.tally import Tally
from benchmarks.pretended.tensors import PretendedTensor, inner
from benchmarks.pretended.training import count_frame, make_pretended_trainer, train_counted
from ggavatar.data.capture import Capture
from ggavatar.training.checkpoint import load_checkpoint
from ggavatar.training.finite_guard import TrainingError
from ggavatar.training.session import configure, make_trainer
from ggavatar.training.trainer import Trainer

LIMITS = {
    "flash_avatar": (560, 170),
    "gaussian_avatars": (960, 200),
    "gaussian_blendshapes": (560, 210),
    "ggavatar": (1_800, 270),
    "ggavatar_plus": (1_850, 300),
    "point_avatar": (1_750, 280),
    "ps_avatar": (520, 190),
    "splatting_avatar": (560, 230),
}
"""Launches of a step and of a frame without our kernels, with the rasterizer as one operation each way."""
WITH_KERNELS = {
    "flash_avatar": (280, 85),
    "gaussian_avatars": (700, 30),
    "gaussian_blendshapes": (340, 210),
    "ggavatar": (120, 30),
    "ggavatar_plus": (190, 55),
    "point_avatar": (1_700, 330),
    "ps_avatar": (310, 200),
    "splatting_avatar": (340, 140),
}
"""Launches of a step, the VGG network aside, and of a frame, at the settings of the papers, with our kernels."""
FIRST_SETTINGS = {
    "flash_avatar": ("perceptual_iterations=0",),
    "ps_avatar": ("first_opacity=0.11",),  # so that pruning at the end of the alignment, in step 6, has to remove some
    **SETTINGS,
}
SLOW = ("flash_avatar", "gaussian_blendshapes", "ggavatar_plus", "point_avatar")
STEPS = 24
STEADY = (21, 22, 23)
"""Steps of the second epoch (the toy has 19 training frames) that are not logged, saved or evaluated."""


@pytest.fixture
def tally() -> Any:
    with pretended_cuda() as counted:
        yield counted


def start(method: str, capture: Capture, folder: Path, *settings: str, **options: Any) -> Trainer:
    wanted = {"preset": "default", "steps": STEPS, "eval_every": 12, "save_every": 12, "max_gaussians": 400}
    return make_pretended_trainer(method, capture, folder, {**wanted, **options, "set": settings})


def settings_of(method: str) -> tuple[str, ...]:
    """No neutral phase, the perceptual loss from the first step, and a round of density control in the first steps."""
    if method in FIRST_SETTINGS:
        return FIRST_SETTINGS[method]
    rounds = ("density_start=0",)
    return (*rounds, "neutral_iterations=0") if method == "ggavatar" else rounds


def rows_of(trainer: Trainer) -> Any:
    avatar = getattr(trainer.avatar, "avatar", trainer.avatar)
    return avatar.cloud.rows if hasattr(avatar, "cloud") else avatar.rows


def plain_state(trainer: Trainer) -> dict[str, torch.Tensor]:
    return {name: inner(value) for name, value in trainer.avatar.state_dict().items()}


@pytest.mark.parametrize(
    "method", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in sorted(LIMITS)]
)
def test_a_method_trains_there_without_waiting_and_comes_back(
    method: str, toy_capture: Capture, tmp_path: Path, tally: Tally
) -> None:
    """Train, grow, evaluate, save, render, resume there and on the CPU."""
    trainer = start(method, toy_capture, tmp_path, *settings_of(method))
    before = len(rows_of(trainer))
    counted = train_counted(trainer, tally)
    steps = [counted.steps[step] for step in STEADY]
    assert {place: count for step in steps for place, count in step.places.items()} == {}
    assert max(step.launches for step in steps) <= LIMITS[method][0]
    frame = count_frame(trainer, tally)
    assert frame.places == {} and frame.launches <= LIMITS[method][1]
    assert method == "flash_avatar" or len(rows_of(trainer)) != before

    again = start(method, toy_capture, tmp_path, *settings_of(method))
    assert again.resume() == STEPS
    for name, value in plain_state(trainer).items():
        assert torch.equal(value, plain_state(again)[name]), name
    moments = [v for o in again.avatar.optimizers() for state in o.state.values() for v in state.values()]
    assert moments and all(value.device.type == "cuda" for value in moments)
    tensors, _ = load_checkpoint(tmp_path / "checkpoints")
    assert all(not isinstance(value, PretendedTensor) for value in tensors.values())


def test_a_run_of_the_device_resumes_on_a_cpu_and_back(toy_capture: Capture, tmp_path: Path) -> None:
    options = {"method": "gaussian_avatars", "steps": 8, "eval_every": 0, "max_gaussians": 400}
    options["set"] = ["perceptual_features=random"]
    with pretended_cuda() as tally:
        there = make_pretended_trainer("gaussian_avatars", toy_capture, tmp_path, options)
        train_counted(there, tally)
    config, split = configure(toy_capture, {**options, "device": "cpu"})
    here = make_trainer(tmp_path, config, toy_capture, split)
    assert here.resume() == 8
    for name, value in plain_state(there).items():
        assert torch.equal(value, plain_state(here)[name]), name
    here.save(9)
    with pretended_cuda():
        back = make_pretended_trainer("gaussian_avatars", toy_capture, tmp_path, options)
        assert back.resume() == 9
        assert all(value.device.type == "cuda" for value in back.avatar.parameters())


def test_the_device_leaves_out_a_bad_step(toy_capture: Capture, tmp_path: Path, tally: Tally) -> None:
    trainer = start("gaussian_avatars", toy_capture, tmp_path, steps=3, eval_every=0)
    losses_of, seen = trainer.avatar.losses, []

    def poisoned(frame: Any, rendering: Any, step: int) -> dict[str, torch.Tensor]:
        seen.append({name: value.clone() for name, value in plain_state(trainer).items() if name != "steps_done"})
        terms = dict(losses_of(frame, rendering, step))
        return {**terms, "l1": terms["l1"] * float("nan")} if step == 2 else terms

    trainer.avatar.losses = poisoned
    train_counted(trainer, tally)
    assert all(torch.equal(value, seen[2][name]) for name, value in seen[1].items())
    assert any(not torch.equal(value, seen[1][name]) for name, value in seen[0].items())
    assert all(torch.isfinite(value).all() for value in plain_state(trainer).values())


def test_too_many_bad_steps_end_the_training(toy_capture: Capture, tmp_path: Path, tally: Tally) -> None:
    trainer = start("gaussian_avatars", toy_capture, tmp_path, steps=30, eval_every=0)
    losses_of = trainer.avatar.losses
    trainer.avatar.losses = lambda *a: {name: value * float("nan") for name, value in losses_of(*a).items()}
    with pytest.raises(TrainingError, match="step 10: the loss is not finite; this has happened 10 times"):
        train_counted(trainer, tally)


def test_a_step_that_waits_is_noticed(toy_capture: Capture, tmp_path: Path, tally: Tally) -> None:
    trainer = start("gaussian_avatars", toy_capture, tmp_path, eval_every=0)
    after = trainer.avatar.after_backward
    trainer.avatar.after_backward = lambda *a: (after(*a), float(trainer.avatar.rows["sh"].detach().sum()))[0]
    step = train_counted(trainer, tally).steps[STEADY[0]]
    assert step.syncs == 1 and next(iter(step.places)).endswith("item")


def test_devices_do_not_mix(tally: Tally) -> None:
    there = torch.ones(3, device="cuda")
    assert there.device == torch.device("cuda:0") and (there + 1).is_cuda
    with pytest.raises(RuntimeError, match="same device"):
        there + torch.ones(3)
    with pytest.raises(TypeError, match="numpy"):
        there.numpy()
    with pytest.raises(RuntimeError, match="generator"):
        torch.randn(3, device="cuda", generator=torch.Generator())
    assert not torch.cuda.is_available() or isinstance(there, PretendedTensor)


def test_operations_and_waits_are_counted(tally: Tally) -> None:
    values = torch.zeros(4, device="cuda")
    tally.reset()
    doubled = (values + 1).view(2, 2) * 2
    assert tally.launches == 2 and not tally.syncs
    assert doubled.sum().item() == 8.0 and bool(doubled.any())
    doubled[doubled > 0]
    torch.ones(3).to("cuda")
    torch.ones(3).pin_memory().to("cuda", non_blocking=True)
    values.to("cpu", non_blocking=True)  # torch pins what it copies to; whoever reads it waits for an event
    assert sorted(reason for reason, _ in tally.syncs.elements()) == [
        "boolean mask", "copy to the device", "item", "item",
    ]  # fmt: skip


def test_the_papers_method_launches_120_kernels_a_step_and_30_a_frame(tmp_path: Path) -> None:
    """Every kernel of ours is one launch; without one of them, torch's operations in its place exceed the limit."""
    found = count("ggavatar", write_capture(tmp_path / "capture"), tmp_path, "perceptual_weight=0")
    step, frame = WITH_KERNELS["ggavatar"]
    assert 0 < found["launches_per_step"] <= step and 0 < found["launches_per_frame"] <= frame
    assert found["waits"] == {}


def test_every_method_is_counted() -> None:
    assert set(methods()) == set(LIMITS) == set(WITH_KERNELS)


@pytest.mark.slow
def test_the_benchmark_counts_every_method_at_the_settings_of_its_paper() -> None:
    found = run(argparse.Namespace(quick=False))
    assert (found["syncs_per_step"], found["syncs_per_frame"]) == (0, 0)
    counts = found["methods"]
    assert isinstance(counts, dict) and set(counts) == set(LIMITS)
    for method, each in counts.items():
        step, frame = WITH_KERNELS[method]
        assert 0 < each.get("launches_per_step_without_vgg", each["launches_per_step"]) <= step, method
        assert 0 < each["launches_per_frame"] <= frame, method
        # A round of PointAvatar's point schedule falls on the counted step, and asks how many points are left.
        assert all(place.startswith("ggavatar/points/point_cloud.py") for place in each["waits"]), method
