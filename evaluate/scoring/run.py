"""Evaluates a run: renders its test frames, writes region masks, scores. Needs torch."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from evaluate.metrics.network_files import NO_WEIGHTS
from evaluate.options import Options
from evaluate.protocols.protocol import GIVEN, Protocol
from evaluate.protocols.results import FRAMES_FILE, METRICS_FILE, Evaluation, read_results, write_results
from evaluate.scoring.accumulator import Labels
from evaluate.scoring.frame_pairs import pair_folders
from evaluate.scoring.gaussian_files import open_gaussian_file, refuse_file_flags
from evaluate.scoring.predict import FOLDERS, SUMMARY, PredictionTask, predict_frames, prediction_task
from evaluate.scoring.region_masks import write_region_masks
from evaluate.scoring.score import SWITCHED_OFF, face_metrics, learned_metrics, score, unavailable
from ggavatar.data.splits import split_name
from ggavatar.errors import InputError
from ggavatar.formats.imported_run import DEFAULT_SPLIT
from ggavatar.formats.source_options import is_gaussian_file
from ggavatar.io.json_files import read_json
from ggavatar.pretrained.resolve import ModelFinder
from ggavatar.render.backends import resolve_device
from ggavatar.training.run_folder import Run, open_run, read_config

Progress = Callable[[int, int], None]


def evaluate_run(
    folder: Path, options: Options, progress: Callable[[str], Progress | None]
) -> tuple[Evaluation, list[Path]]:
    """Render and score one run under the options' protocol, or read its results if they are up to date.

    Args:
        folder: Run folder of ggavatar-train, or a file of Gaussians to score with the options' capture.
        options: Options of the command.
        progress: Creates a callback with (done, total) for a title.

    Returns:
        The evaluation and its files, under `RUN/eval/PROTOCOL/`.

    Raises:
        InputError: Not a run, the protocol cannot be applied to it, or the device is not available.
    """
    run = _open(folder, options, resolve_device(options.device))
    protocol = at_capture_resolution(options.base_protocol(run.config.split), run)
    listed = split_name(run.config.split) == protocol.split == "file"
    task = prediction_task(run, protocol.override(split=GIVEN) if listed else protocol)
    home = run.folder / "eval" / protocol.id
    models = ModelFinder(options.models, options.offline)
    learned = None if options.no_learned else learned_metrics(protocol, models)
    faces = None if options.no_learned else face_metrics(protocol, models)
    if options.again or _is_stale(home, task):
        remove_evaluation(home)
    earlier = _up_to_date(home, protocol, set(unavailable(protocol, learned, faces)))
    if earlier is not None:
        return earlier, [home / METRICS_FILE, home / FRAMES_FILE]
    summary = predict_frames(run, task, home, progress("rendering"))
    inside = () if protocol.region == "full" else (protocol.region,)
    written = write_region_masks(run, home, task.frames, (*protocol.regions, *inside))
    regions = home / "regions" if written else None
    pairs = pair_folders(home / "predictions", home / "ground_truth", home / "masks", regions, task.frames)
    evaluation = score(pairs, protocol, _labels(run, summary), learned, faces, options.threads, progress("scoring"))
    return evaluation, write_results(evaluation, home)


def _open(folder: Path, options: Options, device: str) -> Run:
    """A run, or a file of Gaussians with the capture and split of the options."""
    if is_gaussian_file(folder):
        return open_gaussian_file(folder, options.source, options.base_protocol(DEFAULT_SPLIT).split, device)
    refuse_file_flags(folder, options.source)
    read_config(folder)
    moved = options.source.capture
    return open_run(folder, device) if moved is None else open_run(folder, device, capture=moved)


def at_capture_resolution(protocol: Protocol, run: Run) -> Protocol:
    """The protocol, at the capture's own resolution if its own would enlarge or distort the ground truth."""
    own = run.capture.width, run.capture.height
    if protocol.size is None:
        return protocol
    width, height = protocol.size
    distorted = abs(own[0] * height - own[1] * width) > 0.01 * own[0] * height
    if own[0] < width or own[1] < height or distorted:
        return protocol.override(resolution=f"{own[0]}x{own[1]}")
    return protocol


def _is_stale(home: Path, task: PredictionTask) -> bool:
    """Whether the folder contains predictions of another checkpoint or for another task."""
    path = home / SUMMARY
    return path.is_file() and _read_tolerantly(path).get("key") != task.key()


def _up_to_date(home: Path, protocol: Protocol, missing: set[str]) -> Evaluation | None:
    """The stored evaluation, if predictions, protocol and available networks are unchanged."""
    if not (home / METRICS_FILE).is_file() or not _read_tolerantly(home / SUMMARY).get("complete"):
        return None
    try:
        found = read_results(home)
    except InputError:
        return None
    absent = {name for name, reason in found.missing.items() if reason == SWITCHED_OFF or reason.startswith(NO_WEIGHTS)}
    return found if found.protocol.digest == protocol.digest and absent == missing else None


def remove_evaluation(home: Path) -> None:
    """Delete the files that an earlier evaluation wrote; anything else in the folder stays."""
    summary = _read_tolerantly(home / SUMMARY) if (home / SUMMARY).is_file() else {}
    names = [f"{number:06d}.png" for number in summary.get("frames", ())]
    folders = [home / name for name in FOLDERS]
    folders += [path for path in (home / "regions").glob("*") if path.is_dir()]
    for path in (folder / name for folder in folders for name in names):
        path.unlink(missing_ok=True)
    for name in (METRICS_FILE, FRAMES_FILE, SUMMARY):
        (home / name).unlink(missing_ok=True)
    for path in folders:
        if path.is_dir() and not any(path.iterdir()):
            path.rmdir()


def _read_tolerantly(path: Path) -> dict[str, Any]:
    """A JSON object, empty if the file is damaged; what it described is then made again."""
    try:
        return read_json(path)
    except (InputError, OSError):
        return {}


def _labels(run: Run, summary: dict[str, Any]) -> Labels:
    """Names, costs and provenance of a run."""
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
    where = {
        "run": str(run.folder),
        "checkpoint": {"step": run.step, "sha256": summary.get("identity", {}).get("checkpoint_sha256")},
        "capture_sha256": run.provenance.get("capture_sha256"),
        "training_split": run.config.split,
    }
    if "file" in run.provenance:
        origin = f"opened from {run.provenance['file']}; its training frames are not known"
        return Labels(run.capture.subject, run.method, None, costs, where, (origin,))
    notes = () if run.provenance.get("finished", True) else (f"the training was not finished (step {run.step})",)
    return Labels(run.capture.subject, run.method, run.config.seed, costs, where, notes)


def _statement(timing: dict[str, Any]) -> str:
    return (
        f"FPS is 1 / median over {timing['frames']} frames on {timing['device']} with {timing['threads']} threads; "
        f"it includes {timing['includes']} and excludes {timing['excludes']}."
    )


def _megabytes(provenance: dict[str, Any]) -> float | None:
    """Peak memory of the training, 10⁶ bytes: that of the GPU if there was one."""
    mebibytes = provenance.get("peak_gpu_memory_mib") or provenance.get("peak_memory_mib")
    return None if mebibytes is None else mebibytes * 1.048576
