"""One sitting of training: from what the user asked for to a run folder with everything in it."""

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
from ggavatar.training.progress import Line, Listener, Silence
from ggavatar.training.provenance import outcome_of, provenance_of
from ggavatar.training.run_folder import (
    RunConfig,
    assemble,
    choose_split,
    create_folder,
    find_capture,
    read_config,
    read_split,
    write_config,
)
from ggavatar.training.trainer import StopSignals, Trainer


class Interrupted(Exception):
    """A signal ended the training early; everything is saved.

    Attributes:
        step: Steps done.
        signal: Number of the signal.
    """

    def __init__(self, step: int, number: int) -> None:
        super().__init__(f"signal {number} at step {step}")
        self.step, self.signal = step, number


def train_run(capture_folder: Path, output: Path, options: Mapping[str, Any], quiet: bool = False) -> int:
    """Train, or go on training, until the end.

    Args:
        capture_folder: What to train on.
        output: The run folder.
        options: By name: method, preset, steps, seed, device, backend, split, background, max_gaussians, eval_every,
            save_every, set (a list of field=value), resume, overwrite. What is absent takes its default or, when
            resuming, the run's value.
        quiet: Say nothing.

    Returns:
        Steps done.

    Raises:
        InputError: Bad options or a bad capture.
        Interrupted: A signal came; the state is saved.
        TrainingError: Numbers stay not finite.
    """
    capture = Capture.open(capture_folder)
    resuming = bool(options.get("resume")) and (output / "config.json").exists()
    if resuming:
        config, split = _resumed(output, capture, options), read_split(output)
    else:
        config, split = configure(capture, options)
        create_folder(output, bool(options.get("overwrite")))
        write_config(output, config, split)
    with StopSignals() as stop:
        trainer = make_trainer(output, config, capture, split)
        done = trainer.resume() if resuming else 0
        if done >= config.training.steps:
            return done
        provenance = provenance_of(config, capture, split)
        write_json(output / "provenance.json", provenance)
        trainer.listener = Silence() if quiet else Line(done, config.training.steps)
        done = trainer.run(done, stop)
        write_json(output / "provenance.json", {**provenance, **outcome_of(trainer, done)})
    if stop.received is not None and done < config.training.steps:
        raise Interrupted(done, stop.received)
    return done


def configure(capture: Capture, options: Mapping[str, Any]) -> tuple[RunConfig, Split]:
    """Everything that decides a new training, from presets and options."""
    method = registry.load(options.get("method", "ggavatar"))
    device = resolve_device(options.get("device", "auto"))
    chosen = options.get("preset", "default")
    training = preset(chosen, device)
    changes = {
        name: options[name] for name in ("steps", "max_gaussians", "eval_every", "save_every") if name in options
    }
    for name, value in changes.items():
        if value < (0 if name == "eval_every" else 1):
            raise InputError(f"--{name.replace('_', '-')}: expected a positive number, found {value}")
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
        training=dataclasses.replace(training, **changes),
        method_config=dataclasses.asdict(method.config(chosen, options.get("set", ()))),
    )
    return config, split


def make_trainer(
    output: Path, config: RunConfig, capture: Capture, split: Split, listener: Listener | None = None
) -> Trainer:
    """A trainer before its first step."""
    method = registry.load(config.method)
    rasterize = method.rasterizer(config.device, config.backend)
    scene, reader = assemble(config, capture, split, config.device, rasterize)
    avatar = method.build(method.config_from(config.method_config, f"method {config.method}"), scene)
    return Trainer(
        avatar, reader, split, rasterize, scene.background, config.training, config.seed, output, listener or Silence()
    )  # fmt: skip


def _resumed(output: Path, capture: Capture, options: Mapping[str, Any]) -> RunConfig:
    """The configuration of the run in the output folder, after checking that the options do not contradict it."""
    config = read_config(output)
    if find_capture(output, config).resolve() != capture.folder.resolve():
        raise InputError(
            f"{output}: was trained on {config.capture}, not on {capture.folder}; choose another folder with -o"
        )
    own = {**dataclasses.asdict(config), **dataclasses.asdict(config.training)}
    own["background"] = tuple(config.background)
    wanted = {**options, **({"background": parse_background(options["background"])} if "background" in options else {})}
    if options.get("method") == "ggavatar":
        wanted.pop("method")  # the default of the command line, not a wish
    for name, value in wanted.items():
        if name in own and own[name] != value and not (name == "device" and value == "auto"):
            way_out = "leave the flag out or start a new run"
            raise InputError(f"{output}: --resume goes on with {name} = {own[name]}, not {value}; {way_out}")
    if options.get("set"):
        raise InputError(f"{output}: --resume goes on with the run's own settings; leave --set out or start a new run")
    return config
