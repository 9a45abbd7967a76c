"""What the trainer does in every step, watched from outside: rates, sizes, frames, order of the calls, evaluations.

The avatar has two parameters with a gradient of one, and the renderer returns the background, so that everything that
happens in a training is known in closed form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from ggavatar.core import Camera, Drive, Frame, Gaussians, Rendering
from ggavatar.data.capture import Capture
from ggavatar.data.frames import Frames
from ggavatar.head.model import HeadModel
from ggavatar.render.reference import rasterize
from ggavatar.training.journal import read_journal
from ggavatar.training.plan import TrainingPlan
from ggavatar.training.progress import NullListener
from ggavatar.training.run_folder import RunConfig, make_scene
from ggavatar.training.trainer import StopSignals, Trainer

STEPS = 20
PLAN = TrainingPlan(
    STEPS, resolutions=(), cooling=0.5, coolest=0.02, eval_every=0, eval_frames=2, save_every=0, log_every=1
)
COLOR = torch.tensor([0.2, 0.4, 1.0])


@dataclass
class Watched:
    """What was seen, in order: names of calls, and the numbers of each."""

    calls: list[str] = field(default_factory=list)
    frames: list[Frame] = field(default_factory=list)
    before: list[tuple[float, float]] = field(default_factory=list)
    after: list[tuple[float, float]] = field(default_factory=list)
    gradients: list[tuple[float, float]] = field(default_factory=list)
    rendered: list[tuple[bool, bool, int | None, Camera, Tensor]] = field(default_factory=list)


class WatchedAvatar(nn.Module):
    """Two numbers, each with an optimizer; its loss is their sum."""

    def __init__(self, seen: Watched) -> None:
        super().__init__()
        self.seen = seen
        self.first, self.second = nn.Parameter(torch.zeros(1)), nn.Parameter(torch.zeros(1))
        self._optimizers = [torch.optim.SGD([self.first], lr=1.0), torch.optim.SGD([self.second], lr=0.01)]
        self.posed: int | None = None

    def numbers(self) -> tuple[float, float]:
        return self.first.item(), self.second.item()

    def gaussians(self, drive: Drive) -> Gaussians:
        self.posed = drive.frame
        one = torch.ones(1, 3)
        return Gaussians(one, torch.ones(1, 4), one, torch.ones(1), one)

    def losses(self, frame: Frame, rendering: Rendering, step: int) -> dict[str, Tensor]:
        self.seen.calls.append(f"losses {step}")
        self.seen.frames.append(frame)
        self.seen.before.append(self.numbers())
        return {"first": self.first.sum(), "second": self.second.sum()}

    def optimizers(self) -> list[torch.optim.Optimizer]:
        return self._optimizers  # type: ignore[return-value]

    def after_backward(self, rendering: Rendering, step: int) -> None:
        self.seen.calls.append(f"after {step}")
        self.seen.after.append(self.numbers())
        assert self.first.grad is not None and self.second.grad is not None
        self.seen.gradients.append((self.first.grad.item(), self.second.grad.item()))


def train(capture: Capture, head: HeadModel, folder: Path, plan: TrainingPlan = PLAN) -> tuple[Watched, Trainer]:
    """Train and return what was seen."""
    seen = Watched()
    avatar = WatchedAvatar(seen)

    def flat(gaussians: Gaussians, camera: Camera, background: Tensor) -> Rendering:
        seen.rendered.append((avatar.training, torch.is_grad_enabled(), avatar.posed, camera, background))
        image = background.expand(camera.height, camera.width, 3)
        return Rendering(image, image[..., :1], image[..., :1], torch.zeros(1, 2), torch.ones(1))

    reader = Frames(capture, head, COLOR, "cpu")
    split = capture.splits["every-20th"]
    trainer = Trainer(avatar, reader, split, flat, COLOR, plan, 42, folder, NullListener())
    assert trainer.run(0, StopSignals()) == plan.steps
    return seen, trainer


def plan_with(**changes: object) -> TrainingPlan:
    return TrainingPlan(**{**vars(PLAN), **changes})  # type: ignore[arg-type]


def test_every_optimizer_steps_at_the_plans_factor(toy_capture: Capture, toy_head: HeadModel, tmp_path: Path) -> None:
    """Full rates for ten steps, then half a cosine down to 2 %, for all optimizers."""
    seen, trainer = train(toy_capture, toy_head, tmp_path)
    factors = [1.0] * 10 + [0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * step / 10)) for step in range(1, 11)]
    assert factors[-1] == pytest.approx(0.02)
    for number, rate in enumerate((1.0, 0.01)):
        moved = [before[number] - after[number] for before, after in zip(seen.before, seen.after, strict=True)]
        assert moved == pytest.approx([rate * factor for factor in factors], rel=1e-4)
        assert trainer.avatar.optimizers()[number].param_groups[0]["lr"] == rate


def test_frames_are_as_large_as_the_plan_says(toy_capture: Capture, toy_head: HeadModel, tmp_path: Path) -> None:
    """A quarter of 48 px for a quarter of the steps, half of it for as long, then all."""
    plan = plan_with(resolutions=((0.25, 0.25), (0.25, 0.5)), smallest=1)
    seen, _ = train(toy_capture, toy_head, tmp_path, plan)
    sizes = [12] * 5 + [24] * 5 + [48] * 10
    assert [tuple(frame.image.shape[:2]) for frame in seen.frames] == [(size, size) for size in sizes]
    cameras = [camera for *_, camera, _ in seen.rendered[:STEPS]]
    assert [(camera.width, camera.height) for camera in cameras] == [(size, size) for size in sizes]


def test_training_sees_all_training_frames_and_no_other(
    toy_capture: Capture, toy_head: HeadModel, tmp_path: Path
) -> None:
    split = toy_capture.splits["every-20th"]
    seen, _ = train(toy_capture, toy_head, tmp_path, plan_with(steps=2 * len(split.train)))
    numbers = [frame.drive.frame for frame in seen.frames]
    assert sorted(numbers) == sorted([*split.train, *split.train])
    assert sorted(numbers[: len(split.train)]) == list(split.train) != numbers[: len(split.train)]


def test_gradients_are_of_one_step(toy_capture: Capture, toy_head: HeadModel, tmp_path: Path) -> None:
    seen, trainer = train(toy_capture, toy_head, tmp_path)
    assert seen.gradients == [(1.0, 1.0)] * STEPS
    assert trainer.avatar.first.grad is None


def test_a_step_updates_and_then_lets_the_method_change_its_rows(
    toy_capture: Capture, toy_head: HeadModel, tmp_path: Path
) -> None:
    """Losses, update, then `after_backward`: in the other order, rows that density control replaces lose an update."""
    seen, _ = train(toy_capture, toy_head, tmp_path)
    assert seen.calls == [f"{name} {step}" for step in range(1, STEPS + 1) for name in ("losses", "after")]
    assert [before[0] for before in seen.before[:10]] == [-float(step) for step in range(10)]
    assert [after[0] for after in seen.after[:10]] == [-float(step) for step in range(1, 11)]


def test_training_renders_on_the_background_of_the_frames(
    toy_capture: Capture, toy_head: HeadModel, tmp_path: Path
) -> None:
    seen, _ = train(toy_capture, toy_head, tmp_path)
    assert len(seen.rendered) == STEPS + 2  # the evaluation at the end
    for training, gradients, posed, camera, background in seen.rendered[:STEPS]:
        assert training and gradients and torch.equal(background, COLOR)
        assert posed is not None and torch.equal(
            camera.world_to_camera, torch.from_numpy(toy_capture.tracking.world_to_camera[posed - 3]).float()
        )
    corner = seen.frames[0].image[0, 0]
    assert torch.allclose(corner, COLOR, atol=1 / 255)


def test_evaluations_come_when_due_on_test_frames_at_full_size(
    toy_capture: Capture, toy_head: HeadModel, tmp_path: Path
) -> None:
    """Every eight steps and at the end: the first and the last test frame; PSNR in dB of the flat rendering."""
    plan = plan_with(eval_every=8, resolutions=((1.0, 0.5),), smallest=1)
    seen, trainer = train(toy_capture, toy_head, tmp_path, plan)
    lines = read_journal(tmp_path / "metrics" / "eval.jsonl")
    assert [line["step"] for line in lines] == [8, 16, 20]
    test = toy_capture.splits["every-20th"].test
    evaluated = [call for call in seen.rendered if not call[0]]
    assert [posed for _, _, posed, _, _ in evaluated] == [test[0], test[-1]] * 3
    for _, gradients, _, camera, background in evaluated:
        assert not gradients and (camera.width, camera.height) == (48, 48) and torch.equal(background, COLOR)
    errors = [(trainer.frames.frame(number).image - COLOR).square().mean().item() for number in (test[0], test[-1])]
    assert lines[-1]["psnr"] == pytest.approx(sum(-10 * math.log10(error) for error in errors) / 2, rel=1e-4)
    assert trainer.avatar.training


def test_checkpoints_come_when_due_and_at_the_end(toy_capture: Capture, toy_head: HeadModel, tmp_path: Path) -> None:
    train(toy_capture, toy_head, tmp_path, plan_with(save_every=14))
    names = sorted(path.name for path in (tmp_path / "checkpoints").glob("*.json"))
    assert names == ["step-000000014.json", "step-000000020.json"]


def test_the_scene_of_a_method_holds_training_frames_only(toy_capture: Capture, toy_head: HeadModel) -> None:
    """Drives, cameras and samples of test frames would leak into poses, corrections and initial colors."""
    split = toy_capture.splits["every-20th"]
    plan = TrainingPlan(steps=77, max_gaussians=123)
    config = RunConfig("ggavatar", str(toy_capture.folder), background=(0.2, 0.4, 1.0), seed=5, training=plan)
    scene, _ = make_scene(config, toy_capture, split, "cpu", rasterize)
    assert tuple(drive.frame for drive in scene.drives) == split.train
    views = [toy_capture.tracking.world_to_camera[toy_capture.row(number)] for number in split.train]
    for camera, view in zip(scene.cameras, views, strict=True):
        assert torch.equal(camera.world_to_camera, torch.from_numpy(view).float())
    assert scene.samples and {frame.drive.frame for frame in scene.samples} <= set(split.train)
    assert (scene.steps, scene.max_gaussians, scene.seed) == (77, 123, 5)
    assert torch.allclose(scene.background, COLOR) and scene.rasterize is rasterize
