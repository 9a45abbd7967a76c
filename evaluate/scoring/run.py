"""Evaluates a run: renders its test frames, writes region masks, scores. Needs torch."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from evaluate.options import Options
from evaluate.protocols.results import Evaluation
from evaluate.scoring.accumulator import Labels
from evaluate.scoring.evaluation_job import Job, Reporter, evaluate_job
from evaluate.scoring.gaussian_files import open_gaussian_file, refuse_file_flags
from evaluate.scoring.predict import predict_frames, prediction_task
from evaluate.scoring.run_setup import setup_of_run
from evaluate.scoring.scored_frames import for_capture
from ggavatar.errors import InputError
from ggavatar.formats.avatar_suffix import is_avatar_file
from ggavatar.formats.imported_run import DEFAULT_SPLIT
from ggavatar.formats.source_options import is_gaussian_file
from ggavatar.render.backends import resolve_device
from ggavatar.text.names import clean_text
from ggavatar.training.run_folder import Run, open_run, read_config


def evaluate_run(folder: Path, options: Options, reporter: Reporter) -> tuple[Evaluation, list[Path]]:
    """Render and score one run under the options' protocol, or read its results if they are up to date.

    Args:
        folder: Run folder of ggavatar-train, or a file of Gaussians to score with the options' capture.
        options: Options of the command.
        reporter: Shows progress and warnings.

    Returns:
        The evaluation and its files, under `RUN/eval/PROTOCOL/`.

    Raises:
        InputError: Not a run, the protocol cannot be applied to it, or the device is not available.
    """
    run = _open(folder, options, resolve_device(options.device))
    protocol = for_capture(options.base_protocol(run.config.split), run.capture)
    task = prediction_task(run, protocol, options.split_rule)
    home = run.folder / "eval" / protocol.id
    measured = task.identity["capture_sha256"]
    job = Job(
        home=home,
        protocol=protocol,
        task=task,
        capture=run.capture,
        reader=run.reader,
        fill=lambda progress: predict_frames(run, task, home, progress),
        labels=lambda summary: _labels(run, summary, measured),
    )
    return evaluate_job(job, options, reporter)


def _open(folder: Path, options: Options, device: str) -> Run:
    """A run, or a file of Gaussians with the capture and split of the options."""
    if is_gaussian_file(folder):
        split = options.split_rule or options.base_protocol(DEFAULT_SPLIT).split
        return open_gaussian_file(folder, options.source, split, device)
    refuse_file_flags(folder, options.source)
    if is_avatar_file(folder):
        raise InputError(
            f"{folder}: expected a run, found an avatar file, which holds no photographs to compare with; evaluate the "
            f"run, or: ggavatar-render {folder} -o OUT, then ggavatar-eval --pred OUT/frames --capture CAPTURE"
        )
    read_config(folder)
    moved = options.source.capture
    return open_run(folder, device) if moved is None else open_run(folder, device, capture=moved)


def _labels(run: Run, summary: dict[str, Any], capture_sha256: str) -> Labels:
    """Names, costs and provenance of a run.

    Args:
        run: The opened run.
        summary: The content of `predict.json`.
        capture_sha256: Digest of the capture that is scored, measured now.
    """
    timing = summary.get("timing", {})
    costs = {
        "fps": timing.get("fps"),
        "fps_statement": _statement(timing) if timing else None,
        "device": timing.get("device"),
        "gaussians": summary.get("gaussians", {}).get("median"),
        "model_megabytes": summary.get("model_megabytes"),
        "training_seconds": run.provenance.get("training_seconds"),
        "peak_memory_megabytes": _megabytes(run.provenance),
    }
    trained_on = run.provenance.get("capture_sha256")
    where = {
        "run": str(run.folder),
        "checkpoint": {"step": run.step, "sha256": summary.get("identity", {}).get("checkpoint_sha256")},
        "capture_sha256": capture_sha256,
        "training_capture_sha256": trained_on,
        "capture_changed_since_training": None if trained_on is None else trained_on != capture_sha256,
        "training_split": run.config.split,
    }
    setup = setup_of_run(run)
    if "file" in run.provenance:
        origin = clean_text(f"opened from {run.provenance['file']}; its training frames are not known")
        return Labels(run.capture.subject, run.method, None, costs, where, (origin,), setup)
    notes: tuple[str, ...] = ()
    if not run.provenance.get("finished", True):
        notes += (f"the training was not finished (step {run.step})",)
    if trained_on not in (None, capture_sha256):
        notes += (
            f"the capture has changed since the training (SHA-256 {trained_on[:12]} then, {capture_sha256[:12]} now); "
            "train again",
        )
    return Labels(run.capture.subject, run.method, run.config.seed, costs, where, notes, setup)


def _statement(timing: dict[str, Any]) -> str:
    return (
        f"FPS is 1 / median over {timing['frames']} frames on {timing['device']} with {timing['threads']} threads; "
        f"it includes {timing['includes']} and excludes {timing['excludes']}."
    )


def _megabytes(provenance: dict[str, Any]) -> float | None:
    """Peak memory of the training, 10⁶ bytes: that of the GPU if there was one."""
    mebibytes = provenance.get("peak_gpu_memory_mib") or provenance.get("peak_memory_mib")
    return None if mebibytes is None else mebibytes * 1.048576
