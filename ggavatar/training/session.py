"""A training session: from the options of ggavatar-train to a complete run folder, or to a resumed one."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ggavatar.data.background import parse_background
from ggavatar.data.capture import Capture
from ggavatar.data.splits import Split
from ggavatar.errors import InputError
from ggavatar.io.json_files import write_json
from ggavatar.render.backends import resolve_device
from ggavatar.training import registry
from ggavatar.training.plan import preset
from ggavatar.training.progress import ConsoleListener, Listener, NullListener
from ggavatar.training.provenance import outcome_of, provenance_of
from ggavatar.training.run_folder import (
    RunConfig,
    check_run_folder,
    choose_split,
    create_run_folder,
    find_capture,
    make_scene,
    read_config,
    read_split,
    write_config,
)
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
            save_every, set (a list of field=value), resume, overwrite. Absent ones take their default or, when
            resuming, the run's value.
        quiet: Print no progress.

    Returns:
        Steps done.

    Raises:
        InputError: The options or the capture are not usable.
        TrainingInterrupted: A signal was received; the state is saved.
        TrainingError: Losses or gradients are not finite too often.
    """
    capture = Capture.open(capture_folder)
    resuming = bool(options.get("resume")) and (output / "config.json").exists()
    if resuming:
        config, split = _resumed(output, capture, options), read_split(output)
    else:
        config, split = configure(capture, options)
        check_run_folder(output, bool(options.get("overwrite")))
    with StopSignals() as stop:
        trainer = make_trainer(output, config, capture, split)
        if not resuming:  # after everything that can refuse the input, so that a failed start leaves nothing behind
            create_run_folder(output, bool(options.get("overwrite")))
            write_config(output, config, split)
        done = trainer.resume() if resuming else 0
        if done >= config.training.steps:
            return done
        provenance = provenance_of(config, capture, split)
        write_json(output / "provenance.json", provenance)
        trainer.listener = NullListener() if quiet else ConsoleListener(done, config.training.steps)
        done = trainer.run(done, stop)
        write_json(output / "provenance.json", {**provenance, **outcome_of(trainer, done)})
    if stop.received is not None and done < config.training.steps:
        raise TrainingInterrupted(done, stop.received)
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
        settings=tuple(options.get("set", ())),
        training=dataclasses.replace(training, **changes),
        method_config=dataclasses.asdict(method.config(chosen, options.get("set", ()))),
    )
    return config, split


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
    if find_capture(output, config).resolve() != capture.folder.resolve():
        raise InputError(
            f"{output}: was trained on {config.capture}, not on {capture.folder}; choose another folder with -o"
        )
    saved = {**dataclasses.asdict(config), **dataclasses.asdict(config.training)}
    saved["background"] = tuple(config.background)
    requested = dict(options)
    if "background" in options:
        requested["background"] = parse_background(options["background"])
    if options.get("method") == "ggavatar":
        requested.pop("method")  # the default of the command line, which need not have been requested
    for name, value in requested.items():
        if name in saved and saved[name] != value and not (name == "device" and value == "auto"):
            raise InputError(
                f"{output}: --resume continues with {name} = {saved[name]}, found {value}; omit the flag or start a "
                "new run"
            )
    if options.get("set"):
        raise InputError(f"{output}: --resume continues with the run's own settings; omit --set or start a new run")
    return config
