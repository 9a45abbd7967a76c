"""Fourth stage: cameras and head parameters, imported from another tracker or found by our own."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, overload

import numpy as np
import torch

from ggavatar.data.capture import HEAD, TRACKING, Tracking
from ggavatar.errors import InputError
from ggavatar.head.model import HeadModel
from ggavatar.io.images import read_gray, read_rgb
from ggavatar.io.npz import write_npz
from preprocess.doctor.conventions import apply_fixes
from preprocess.doctor.frame_offset import find_offset
from preprocess.formats.registry import SWAPPED_SIZE, read_foreign
from preprocess.formats.tracking_record import FLAME_JOINTS, TrackingRecord
from preprocess.options import PrepOptions
from preprocess.pipeline.stage import Job, Stage, file_state
from preprocess.tracking.geometry.projection import one_torch_thread
from preprocess.tracking.sequence import TrackedSequence
from preprocess.tracking.torso.torso import track_torso
from preprocess.video.crop import crop_from_json


def inputs(options: PrepOptions) -> Mapping[str, Any]:
    """The tracking and the head model, or the built-in tracker's options."""
    if options.tracking is not None:
        _head_path(options)
    return {
        "tracking": file_state(options.tracking),
        "format": options.format,
        "head": file_state(options.head_model),
        "offset": options.frame_offset,
        "fix": options.fix,
        "tracker": dataclasses.asdict(options.tracker),
    }


def run(job: Job) -> Mapping[str, Any]:
    """Write tracking.npz and head.npz; the result says which frames they cover and where they came from."""
    from ggavatar.head.files import save_head

    numbers = list(job.results["masks"]["numbers"])
    with one_torch_thread():
        numbers, sequence = _imported(job, numbers) if job.options.tracking else (numbers, _tracked(job, numbers))
    write_npz(job.folder / TRACKING, sequence.tracking.arrays())
    save_head(sequence.head, job.folder / HEAD)
    for warning in sequence.report.get("warnings", ()):
        job.reporter.warn(str(warning))
    return {"numbers": numbers, "version": sequence.head.version, "report": dict(sequence.report)}


def _tracked(job: Job, numbers: list[int]) -> TrackedSequence:
    """Our own tracker, reading one image at a time."""
    from preprocess.tracking.tracker import track

    images = PicturesOnDisk(job, "images", numbers, read_rgb)
    masks = PicturesOnDisk(job, "masks", numbers, read_gray)
    source, crop = job.results["frames"], crop_from_json(dict(job.results["crop"]["crop"]))
    middle = np.array([[1.0, 0.0, source["width"] / 2], [0.0, 1.0, source["height"] / 2], [0.0, 0.0, 1.0]])
    center = crop.intrinsics(middle)[:2, 2]
    return track(images, masks, float(source["fps"]), job.options, (float(center[0]), float(center[1])))


class PicturesOnDisk(Sequence[np.ndarray]):
    """The clip's images or masks, each read when it is asked for; reading images shows as progress."""

    def __init__(self, job: Job, folder: str, numbers: Sequence[int], read: Callable[[Path], np.ndarray]) -> None:
        self._paths = [job.folder / folder / f"{number:06d}.png" for number in numbers]
        self._read, self._reporter = read, job.reporter

    def __len__(self) -> int:
        return len(self._paths)

    @overload
    def __getitem__(self, index: int) -> np.ndarray: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[np.ndarray]: ...

    def __getitem__(self, index: int | slice) -> np.ndarray | Sequence[np.ndarray]:
        if isinstance(index, slice):
            return [self._read(path) for path in self._paths[index]]
        picture = self._read(self._paths[index])
        self._reporter.advance(index % len(self) + 1, len(self))
        return picture


def _imported(job: Job, numbers: list[int]) -> tuple[list[int], TrackedSequence]:
    """Another tracker's output: fitted to the head, moved to the capture's pixels and paired with its frames."""
    options = job.options
    name, record = read_foreign(options)
    head, version_note = _head(options, record)
    crop = crop_from_json(dict(job.results["crop"]["crop"]))
    tracking = to_tracking(record, head.expression_basis.shape[2], head.joint_names, job)
    fixes = [fix for fix in options.fix if fix != SWAPPED_SIZE]
    tracking = apply_fixes(tracking, fixes, crop.out_width, crop.out_height)
    known = [int(number) for number in record.numbers]
    offset, pairing = _offset(job, head, tracking, known, numbers)
    row_of = {number: row for row, number in enumerate(known)}
    kept = [number for number in numbers if number - offset in row_of]
    if len(kept) < 2:
        raise InputError(
            f"{options.tracking}: covers {len(kept)} of the video's {len(numbers)} frames; is it another video's "
            "tracking?"
        )
    rows = np.array([row_of[number - offset] for number in kept])
    found = with_torso(job, head, tracking.rows(rows), kept)
    report = {"tracker": name, "offset": offset, "pairing": pairing, "notes": [*record.notes, *version_note]}
    return kept, TrackedSequence(
        found, head, report | {"warnings": _warnings(record, pairing, len(numbers) - len(kept))}
    )


def with_torso(job: Job, head: HeadModel, tracking: Tracking, numbers: Sequence[int]) -> Tracking:
    """The tracking with the torso's own motion, which other trackers do not tell."""
    images = PicturesOnDisk(job, "images", numbers, read_rgb)
    masks = PicturesOnDisk(job, "masks", numbers, read_gray)
    torso = track_torso(head, tracking, images, masks, float(job.results["frames"]["fps"]))
    return dataclasses.replace(tracking, torso_to_camera=torso)


def _warnings(record: TrackingRecord, pairing: Mapping[str, Any], lost: int) -> list[str]:
    warnings = list(record.notes)
    if pairing.get("offset") != pairing.get("suggested"):
        warnings.append(
            f"frame k of the tracking belongs to frame k{pairing['offset']:+d} of the video, as the picture under "
            "the mesh shows"
        )
    if lost:
        warnings.append(f"{lost} frames have no tracking and are left out")
    return warnings


def _offset(
    job: Job, head: Any, tracking: Tracking, known: list[int], numbers: list[int]
) -> tuple[int, dict[str, Any]]:
    """The frame offset asked for, or found by comparing pictures."""
    asked = job.options.frame_offset
    if asked is not None:
        return asked, {"offset": asked, "suggested": asked, "scores": {}}

    def image(number: int) -> np.ndarray:
        return read_rgb(job.folder / "images" / f"{number:06d}.png")

    found = find_offset(head, tracking, known, numbers, image)
    scores = {str(offset): round(score, 5) for offset, score in found.scores.items()}
    return found.offset, {"offset": found.offset, "suggested": found.suggested, "scores": scores}


def _head(options: PrepOptions, record: TrackingRecord) -> tuple[Any, list[str]]:
    """The head model that the tracking's parameters belong to, identity folded in."""
    from ggavatar.head.files import load_head
    from ggavatar.head.flame import is_flame, load_flame

    path = _head_path(options)
    if not is_flame(path):
        return load_head(path), []
    head = with_static_offset(load_flame(path, record.shape, expressions=max(1, record.expression.shape[1])), record)
    if record.version is not None and head.version != record.version:
        raise InputError(
            f"{path} is {head.version}, but the tracking's coefficients belong to {record.version}; they are not "
            "interchangeable. "
            f"Give the {record.version} file with --head-model"
        )
    return head, []


def _head_path(options: PrepOptions) -> Path:
    """The head model of an imported tracking, which must be there before anything is begun."""
    path = options.head_model
    if path is None:
        raise InputError("--tracking needs --head-model: FLAME's generic_model.pkl or flame2023.pkl, or a head.npz")
    if not path.is_file():
        raise InputError(f"{path}: no such head model file")
    return path


def with_static_offset(head: HeadModel, record: TrackingRecord) -> HeadModel:
    """The head with the tracker's per-vertex offsets (VHAP) folded into its template.

    Vertices FLAME does not have are left out.
    """
    offset = record.extra.get("static_offset")
    if offset is None:
        return head
    count = min(len(head.template), len(offset))
    template = head.template.clone()
    template[:count] += torch.from_numpy(np.asarray(offset[:count], dtype=np.float32))
    return dataclasses.replace(head, template=template)


def to_tracking(record: TrackingRecord, expressions: int, joint_names: tuple[str, ...], job: Job) -> Tracking:
    """A foreign record as tracking of the capture: padded to the head's sizes, intrinsics in px of the capture."""
    crop, source = crop_from_json(dict(job.results["crop"]["crop"])), job.results["frames"]
    scale = np.diag([source["width"] / record.width, source["height"] / record.height, 1.0])
    joints = np.zeros((len(record.numbers), len(joint_names), 3))
    joints[:, : min(FLAME_JOINTS, len(joint_names))] = record.joint_rotations[:, : len(joint_names)]
    return Tracking(
        intrinsics=crop.intrinsics(scale @ record.intrinsics),
        world_to_camera=nearest_rigid(record.world_to_camera),
        expression=fit_columns(record.expression, expressions),
        joint_rotations=joints,
        eyelids=record.eyelids,
        translation=record.translation,
        shape=record.shape,
    )


def nearest_rigid(poses: np.ndarray) -> np.ndarray:
    """Poses whose rotations, stored in single precision, are made exactly orthonormal."""
    left, _, right = np.linalg.svd(poses[:, :3, :3])
    result = poses.copy()
    result[:, :3, :3] = left @ right
    return result


def fit_columns(values: np.ndarray, count: int) -> np.ndarray:
    """Coefficients padded with zeros or cut; cutting anything but zeros is an error."""
    if np.any(values[:, count:]):
        raise InputError(
            f"the tracking uses {values.shape[1]} expression coefficients, the head model has {count}; "
            "give the head model that the tracking was made with"
        )
    return np.pad(values[:, :count], ((0, 0), (0, max(0, count - values.shape[1]))))


STAGE = Stage("tracking", "Tracking", inputs, run, outputs=(TRACKING, HEAD), version=9)
