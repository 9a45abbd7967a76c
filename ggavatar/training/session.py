"""A training session: from the options of ggavatar-train to a complete run folder, or to a resumed one."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ggavatar.data.background import parse_background
from ggavatar.data.capture import Capture
from ggavatar.data.splits import Split
from ggavatar.errors import InputError
from ggavatar.head.files import load_head
from ggavatar.io.dataclass_json import override
from ggavatar.io.folder_lock import lock_folder
from ggavatar.io.free_space import require_space
from ggavatar.io.held_folders import make_folder
from ggavatar.io.json_files import read_json, write_sealed_json
from ggavatar.losses.vgg import perceptual_loss
from ggavatar.pretrained.resolve import ModelUnavailable
from ggavatar.render.backends import resolve_device
from ggavatar.text.clocked_lines import waiting
from ggavatar.text.terminal import write_out
from ggavatar.training import registry
from ggavatar.training.changed_settings import changed_settings
from ggavatar.training.plan import TrainingPlan, preset
from ggavatar.training.progress import ConsoleListener, Listener, NullListener
from ggavatar.training.provenance import outcome_of, provenance_of
from ggavatar.training.registry import Method
from ggavatar.training.run_folder import (
    RunConfig,
    check_run_folder,
    choose_split,
    create_run_folder,
    holds_run,
    make_scene,
    read_config,
    read_split,
    remove_leftovers,
    write_config,
)
from ggavatar.training.same_capture import require_same_capture
from ggavatar.training.snapshot import SnapshotListener
from ggavatar.training.trainer import StopSignals, Trainer


class TrainingInterrupted(Exception):
    """A signal stopped the training early; its state is saved.

    Attributes:
        step: Steps done.
        signal: Number of the signal.
    """

    def __init__(self, step: int, number: int) -> None:
        super().__init__(f"signal {number} at step {step}")
        self.step, self.signal = step, number


def train_run(capture_folder: Path, output: Path, options: Mapping[str, Any], quiet: bool = False) -> int:
    """Train from the first step, or resume, until the last step.

    Args:
        capture_folder: The capture to train on.
        output: The run folder.
        options: By name: method, preset, steps, seed, device, backend, split, background, max_gaussians, eval_every,
            save_every, set (a list of field=value), resume, overwrite, view (write snapshots). Absent ones take their
            default or, when resuming, the run's value.
        quiet: Print no progress.

    Returns:
        Steps done.

    Raises:
        InputError: The options or the capture are not usable.
        TrainingInterrupted: A signal was received; the state is saved.
        TrainingError: Losses or gradients are not finite too often.
    """
    capture = Capture.open(capture_folder)
    watched = bool(options.get("view"))
    with StopSignals() as stop:
        if options.get("resume") and _expect_run(output):
            with lock_folder(output):
                config, split = _resumed(output, capture, options), read_split(output)
                with waiting("preparing the avatar", quiet):
                    trainer = make_trainer(output, config, capture, split)
                remove_leftovers(output)
                done = _train(trainer, trainer.resume(), config, capture, stop, (quiet, watched))
        else:
            overwrite = bool(options.get("overwrite"))
            config, split = configure(capture, options)
            check_run_folder(output, overwrite)
            config = with_settled_features(config)
            with waiting("preparing the avatar", quiet):
                trainer = make_trainer(output, config, capture, split)
            require_space(output, checkpoint_bytes(trainer.avatar))
            make_folder(output)  # the input is usable: a failed start leaves nothing behind
            with lock_folder(output):
                create_run_folder(output, overwrite)
                write_config(output, config, split)
                done = _train(trainer, 0, config, capture, stop, (quiet, watched))
    if stop.received is not None and done < config.training.steps:
        raise TrainingInterrupted(done, stop.received)
    return done


def checkpoint_bytes(avatar: Any) -> int:
    """Size of the first checkpoint at the least: what is learned, with the two moments of Adam of each value."""
    return 3 * sum(value.numel() * value.element_size() for value in avatar.parameters())


def _expect_run(output: Path) -> bool:
    """Whether --resume has a run to continue; a start that was stopped before its first step has none yet.

    Raises:
        InputError: There is no such folder, or nothing in it.
    """
    if holds_run(output):
        return True
    if not output.is_dir() or not any(output.iterdir()):
        raise InputError(f"{output}: --resume found no run to continue here; check -o, or omit --resume to start one")
    return False


def _train(
    trainer: Trainer, done: int, config: RunConfig, capture: Capture, stop: StopSignals, audience: tuple[bool, bool]
) -> int:
    """Train from step `done` + 1, record what is known before and after, and return the steps done."""
    if done >= config.training.steps:
        return done
    provenance = provenance_of(config, capture, trainer.split)
    path = trainer.folder / "provenance.json"
    write_sealed_json(path, provenance)
    quiet, watched = audience
    if not quiet:
        write_out(describe(config))
        trainer.listener = ConsoleListener(done, config.training.steps)
    if watched:
        trainer.listener = SnapshotListener(trainer.listener, trainer.avatar, trainer.folder)
    done = trainer.run(done, stop)
    write_sealed_json(path, {**provenance, **outcome_of(trainer, done)})
    return done


def configure(capture: Capture, options: Mapping[str, Any]) -> tuple[RunConfig, Split]:
    """The configuration and the split of a new training, from its preset and options.

    Raises:
        InputError: An option is not usable.
    """
    method = registry.load(options.get("method", "ggavatar"))
    device = resolve_device(options.get("device", "auto"))
    chosen = options.get("preset", "default")
    training = preset(chosen, device)
    changes = {
        name: options[name] for name in ("steps", "max_gaussians", "eval_every", "save_every") if name in options
    }
    for name, value in changes.items():
        if value < (0 if name == "eval_every" else 1):
            least = "0 or more" if name == "eval_every" else "1 or more"
            raise InputError(f"--{name.replace('_', '-')}: expected {least}, found {value}")
    training = with_budget(dataclasses.replace(training, **changes), method, capture, "max_gaussians" in changes)
    name, split = choose_split(capture, options.get("split", "every-20th"))
    config = RunConfig(
        method=method.name,
        capture=str(capture.folder.resolve()),
        split=name,
        background=parse_background(options.get("background", "white")),
        seed=options.get("seed", 42),
        device=device,
        backend=options.get("backend", "auto"),
        preset=chosen,
        training=training,
        method_config=dataclasses.asdict(method.config(chosen, options.get("set", ()))),
    )
    return config, split


def with_budget(plan: TrainingPlan, method: Method, capture: Capture, by_name: bool) -> TrainingPlan:
    """A plan whose number of Gaussians suffices for the head; a preset's is raised, the user's (`by_name`) is not.

    Raises:
        InputError: The user's number is too small for the method on this head.
    """
    least = method.least_gaussians(load_head(capture.head_path))
    if plan.max_gaussians < least and by_name:
        raise InputError(
            f"--max-gaussians {plan.max_gaussians}: expected at least {least} for {method.name} on this head of "
            f"{capture.folder}; use --max-gaussians {least} or more"
        )
    return dataclasses.replace(plan, max_gaussians=max(plan.max_gaussians, least))


def with_settled_features(config: RunConfig) -> RunConfig:
    """The configuration with the perceptual features that this training compares instead of the `best` there are.

    They are loaded, and fetched if need be, before a run is begun: a training neither fails at its first perceptual
    step nor resumes with other features.

    Raises:
        InputError: The settings ask for VGG16 and it cannot be had.
    """
    wanted = config.perceptual_features
    if wanted is None:
        return config
    try:
        features = perceptual_loss(wanted).name
    except ModelUnavailable as missing:
        raise InputError(
            f"{missing}. To train with untrained features instead, which every table will say: --set "
            "perceptual_features=random"
        ) from missing
    return dataclasses.replace(config, method_config={**config.method_config, "perceptual_features": features})


def describe(config: RunConfig) -> str:
    """One line that says what is trained: method, preset, changed settings, length, and perceptual features."""
    parts = [f"{config.method}, preset {config.preset}", f"{config.training.steps:,} steps", f"seed {config.seed}"]
    if changed := changed_settings(config):
        parts.insert(1, "with " + ", ".join(f"{name}={value}" for name, value in changed.items()))
    if config.perceptual_features is not None:
        parts.append(f"perceptual loss on {config.perceptual_features} features")
    return ", ".join(parts)


def make_trainer(
    output: Path, config: RunConfig, capture: Capture, split: Split, listener: Listener | None = None
) -> Trainer:
    """A trainer with an untrained avatar."""
    method = registry.load(config.method)
    rasterize = method.rasterizer(config.device, config.backend)
    scene, reader = make_scene(config, capture, split, config.device, rasterize)
    avatar = method.build(method.config_from(config.method_config, f"method {config.method}"), scene)
    return Trainer(
        avatar=avatar,
        frames=reader,
        split=split,
        rasterize=rasterize,
        background=scene.background,
        plan=config.training,
        seed=config.seed,
        folder=output,
        listener=listener or NullListener(),
    )


def _resumed(output: Path, capture: Capture, options: Mapping[str, Any]) -> RunConfig:
    """The configuration of the run in the output folder, after checking that the options do not contradict it."""
    config = read_config(output)
    registry.load_as_trained(config.method, _recorded_package(output), output)  # names the package that is missing
    require_same_capture(output, config, capture, capture.digest())
    saved = {**dataclasses.asdict(config), **dataclasses.asdict(config.training)}
    saved["background"] = tuple(config.background)
    requested = dict(options)
    if "background" in options:
        requested["background"] = parse_background(options["background"])
    for name, value in requested.items():
        if name in saved and saved[name] != value and not (name == "device" and value == "auto"):
            raise InputError(
                f"{output}: --resume continues with {name} = {saved[name]}, found {value}; omit the flag or start a "
                "new run"
            )
    _require_same_settings(output, config, options.get("set", ()))
    return config


def _recorded_package(run: Path) -> object:
    """The package of the run's method, as its provenance says; None for our own, or if nothing says it."""
    with contextlib.suppress(InputError):
        return read_json(run / "provenance.json").get("method_package")
    return None


def _require_same_settings(output: Path, config: RunConfig, assignments: Sequence[str]) -> None:
    """Check that the texts of --set change nothing in a run; `best` features are those that it has settled on."""
    where = f"method {config.method}"
    own = registry.load(config.method).config_from(config.method_config, where)
    wanted = override(own, assignments, where)
    for field in dataclasses.fields(own):
        value, found = getattr(own, field.name), getattr(wanted, field.name)
        if found != value and (field.name, found) != ("perceptual_features", "best"):
            raise InputError(
                f"{output}: --resume continues with {field.name} = {value}, found --set {field.name}={found}; omit the "
                "flag or start a new run"
            )
