"""Sixth stage: cameras and head parameters, imported from another tracker or found by the built-in one."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, overload

import numpy as np
import torch

from ggavatar.data.capture import HEAD, Tracking
from ggavatar.errors import InputError
from ggavatar.head.flame import JOINT_NAMES, is_flame
from ggavatar.head.model import HeadModel
from ggavatar.io.images import read_gray, read_rgb
from ggavatar.io.npz import write_npz
from preprocess.doctor.conventions import apply_fixes
from preprocess.doctor.frame_offset import find_offset
from preprocess.formats.registry import SWAPPED_SIZE
from preprocess.formats.tracking_record import FLAME_JOINTS, TrackingRecord
from preprocess.options import PrepOptions, TrackingOptions
from preprocess.pipeline.face_stage import survey_of
from preprocess.pipeline.mask_stage import NO_MASK
from preprocess.pipeline.stage import RECORDS, Stage, StageContext, file_state
from preprocess.tracking.geometry.projection import one_torch_thread
from preprocess.tracking.sequence import TrackedSequence
from preprocess.tracking.torso.torso import track_torso
from preprocess.video.crop import crop_from_json

TRACKED = f"{RECORDS}/tracked.npz"
"""The tracking before it is refined."""


def inputs(options: PrepOptions) -> Mapping[str, Any]:
    """State of the tracking and the head model, and the tracker's options.

    Raises:
        InputError: No such file, or options of the built-in tracker together with another tracker's output.
    """
    if options.tracking is not None:
        _head_path(options)
        _refuse_tracker_options(options.tracker)
    return {
        "tracking": file_state(options.tracking),
        "format": options.format,
        "head": file_state(options.head_model),
        "offset": options.frame_offset,
        "fix": options.fix,
        "tracker": dataclasses.asdict(options.tracker),
    }


def run(context: StageContext) -> Mapping[str, Any]:
    """Write the tracking and head.npz; the result lists the frames they cover and says where they are from."""
    from ggavatar.head.files import save_head

    numbers = list(context.results["masks"]["numbers"])
    with one_torch_thread():
        numbers, sequence = (_imported if context.options.tracking else _tracked)(context, numbers)
    write_npz(context.folder / TRACKED, sequence.tracking.arrays())
    save_head(sequence.head, context.folder / HEAD)
    for warning in sequence.report.get("warnings", ()):
        context.reporter.warn(str(warning))
    return {"numbers": numbers, "version": sequence.head.version, "report": dict(sequence.report)}


def _tracked(context: StageContext, masked: list[int]) -> tuple[list[int], TrackedSequence]:
    """The built-in tracker's result; images are read one at a time.

    It also gets the frames in between that are dropped, since it smooths over time; it relies on nothing in them.
    """
    from preprocess.tracking.tracker import track

    results = context.results
    without_file = {number for number, reason in results["masks"]["dropped"] if reason == NO_MASK}
    numbers = [number for number in results["evidence"]["numbers"] if number not in without_file]
    images = ImagesOnDisk(context, "images", numbers, read_rgb)
    masks = ImagesOnDisk(context, "masks", numbers, read_gray)
    row_of = {number: row for row, number in enumerate(results["frames"]["numbers"])}
    faces = survey_of(context).faces.rows([row_of[number] for number in numbers])
    source, crop = context.results["frames"], crop_from_json(dict(context.results["crop"]["crop"]))
    centered = np.array([[1.0, 0.0, source["width"] / 2], [0.0, 1.0, source["height"] / 2], [0.0, 0.0, 1.0]])
    center = crop.intrinsics(centered)[:2, 2]
    place = (float(center[0]), float(center[1]))
    sequence = track(images, masks, float(context.results["evidence"]["fps"]), context.options, place, faces)
    kept = sorted(set(masked) - {number for number, _ in results["evidence"]["dropped"]})
    rows = np.flatnonzero(np.isin(numbers, kept))
    return kept, dataclasses.replace(sequence, tracking=sequence.tracking.rows(rows))


class ImagesOnDisk(Sequence[np.ndarray]):
    """The clip's images or masks, each read on access; every access reports progress."""

    def __init__(
        self, context: StageContext, folder: str, numbers: Sequence[int], read: Callable[[Path], np.ndarray]
    ) -> None:
        self._paths = [context.folder / folder / f"{number:06d}.png" for number in numbers]
        self._read, self._reporter = read, context.reporter

    def __len__(self) -> int:
        return len(self._paths)

    @overload
    def __getitem__(self, index: int) -> np.ndarray: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[np.ndarray]: ...

    def __getitem__(self, index: int | slice) -> np.ndarray | Sequence[np.ndarray]:
        if isinstance(index, slice):
            return [self._read(path) for path in self._paths[index]]
        image = self._read(self._paths[index])
        self._reporter.advance(index % len(self) + 1, len(self))
        return image


def _imported(context: StageContext, numbers: list[int]) -> tuple[list[int], TrackedSequence]:
    """Another tracker's output, fitted to the head, converted to the capture's pixels and paired with its frames."""
    options = context.options
    name, record = context.tracking_record()
    head, version_note = _head(options, record)
    crop = crop_from_json(dict(context.results["crop"]["crop"]))
    tracking = to_tracking(record, head.expression_basis.shape[2], head.joint_names, context)
    fixes = [fix for fix in options.fix if fix != SWAPPED_SIZE]
    tracking = apply_fixes(tracking, fixes, crop.out_width, crop.out_height)
    known = [int(number) for number in record.numbers]
    offset, pairing = _offset(context, head, tracking, known, numbers)
    row_of = {number: row for row, number in enumerate(known)}
    kept = [number for number in numbers if number - offset in row_of]
    if len(kept) < 2:
        raise InputError(
            f"{options.tracking}: expected tracking for the video's {len(numbers)} frames, found it for {len(kept)}; "
            "check that it belongs to this video"
        )
    rows = np.array([row_of[number - offset] for number in kept])
    found = with_torso(context, head, tracking.rows(rows), kept)
    report = {"tracker": name, "offset": offset, "pairing": pairing, "notes": [*record.notes, *version_note]}
    report |= {"camera_is_assumed": True} if record.camera_is_assumed else {}
    return kept, TrackedSequence(
        found, head, report | {"warnings": _warnings(record, pairing, len(numbers) - len(kept))}
    )


def with_torso(context: StageContext, head: HeadModel, tracking: Tracking, numbers: Sequence[int]) -> Tracking:
    """The tracking with the torso's own motion, which other trackers do not estimate."""
    images = ImagesOnDisk(context, "images", numbers, read_rgb)
    masks = ImagesOnDisk(context, "masks", numbers, read_gray)
    torso = track_torso(head, tracking, images, masks, float(context.results["evidence"]["fps"]))
    return dataclasses.replace(tracking, torso_to_camera=torso)


def _warnings(record: TrackingRecord, pairing: Mapping[str, Any], lost: int) -> list[str]:
    warnings = list(record.notes)
    if pairing.get("offset") != pairing.get("suggested"):
        warnings.append(
            f"frame k of the tracking belongs to frame k{pairing['offset']:+d} of the video, judging by the image "
            "under the mesh"
        )
    if lost:
        warnings.append(f"{lost} frames have no tracking and are left out")
    return warnings


def _offset(
    context: StageContext, head: Any, tracking: Tracking, known: list[int], numbers: list[int]
) -> tuple[int, dict[str, Any]]:
    """The frame offset that `--frame-offset` gives, or the one found by comparing images, and its report."""
    given = context.options.frame_offset
    if given is not None:
        return given, {"offset": given, "suggested": given, "scores": {}}

    def image(number: int) -> np.ndarray:
        return read_rgb(context.folder / "images" / f"{number:06d}.png")

    found = find_offset(head, tracking, known, numbers, image)
    scores = {str(offset): round(score, 5) for offset, score in found.scores.items()}
    return found.offset, {"offset": found.offset, "suggested": found.suggested, "scores": scores}


def _head(options: PrepOptions, record: TrackingRecord) -> tuple[HeadModel, list[str]]:
    """The head model that the tracking's parameters belong to, identity folded in, and notes on the choice."""
    from ggavatar.head.any_head import is_head_file, open_head

    path, version = _head_path(options), record.version
    if version is not None and version.startswith("flame") and not is_flame(path) and not is_head_file(path):
        raise InputError(
            f"{path}: expected {version}, which the tracking's coefficients belong to, found another head model; give "
            f"the {version} file with --head-model"
        )
    head = open_head(path, record.shape, max(1, record.expression.shape[1]))
    if is_head_file(path):
        return head, []
    notes = []
    if version is not None and head.version != version:
        if (version, head.version) != ("flame2023", "flame2023-open"):
            raise InputError(
                f"{path}: expected {version}, which the tracking's coefficients belong to, found {head.version}; they "
                f"are not interchangeable, give the {version} file with --head-model"
            )
        notes.append(
            "the head model is FLAME 2023 Open: right only if the video was tracked with it, which no file says"
        )
    return with_static_offset(head, record), notes


def _refuse_tracker_options(given: TrackingOptions) -> None:
    """Refuse what would be ignored: the options of the built-in tracker, which does not run."""
    default = TrackingOptions()
    for item in dataclasses.fields(given):
        if getattr(given, item.name) != getattr(default, item.name):
            raise InputError(
                f"--tracker.{item.name}: expected no option of the built-in tracker with --tracking, whose values are "
                "used as they are; leave it out, or leave --tracking out so that the built-in tracker runs"
            )


def _head_path(options: PrepOptions) -> Path:
    """The path of the head model of an imported tracking, checked to exist."""
    from ggavatar.head.any_head import KINDS

    path = options.head_model
    if path is None:
        raise InputError(f"--tracking needs --head-model: {KINDS}")
    if not path.exists():
        raise InputError(f"{path}: no such head model file or folder; check --head-model, which takes {KINDS}")
    return path


def with_static_offset(head: HeadModel, record: TrackingRecord) -> HeadModel:
    """The head with the tracker's static per-vertex offsets (VHAP) added to its template.

    Offsets of vertices that the head does not have are left out.
    """
    offset = record.extra.get("static_offset")
    if offset is None:
        return head
    count = min(len(head.template), len(offset))
    template = head.template.clone()
    template[:count] += torch.from_numpy(np.asarray(offset[:count], dtype=np.float32))
    return dataclasses.replace(head, template=template)


def to_tracking(
    record: TrackingRecord, expressions: int, joint_names: tuple[str, ...], context: StageContext
) -> Tracking:
    """A tracking record as the capture's tracking: padded to the head's sizes, intrinsics in px of the capture."""
    crop, source = crop_from_json(dict(context.results["crop"]["crop"])), context.results["frames"]
    scale = np.diag([source["width"] / record.width, source["height"] / record.height, 1.0])
    return Tracking(
        intrinsics=crop.intrinsics(scale @ record.intrinsics),
        world_to_camera=nearest_rigid(record.world_to_camera),
        expression=fit_columns(record.expression, expressions),
        joint_rotations=_joints(record, joint_names),
        eyelids=record.eyelids,
        translation=record.translation,
        shape=record.shape,
    )


def _joints(record: TrackingRecord, names: tuple[str, ...]) -> np.ndarray:
    """FLAME's joint rotations for the joints of the head, by position, or by name if the head lacks one of them.

    Raises:
        InputError: A joint is rotated that the head does not have.
    """
    joints = np.zeros((len(record.numbers), len(names), 3))
    if len(names) >= FLAME_JOINTS or not set(JOINT_NAMES) & set(names):
        joints[:, :FLAME_JOINTS] = record.joint_rotations[:, : len(names)]
        return joints
    for row, name in enumerate(JOINT_NAMES):
        if name in names:
            joints[:, names.index(name)] = record.joint_rotations[:, row]
        elif np.any(record.joint_rotations[:, row]):
            raise InputError(f"expected a head with the joint {name!r}, which the tracking rotates, found {names}")
    return joints


def nearest_rigid(poses: np.ndarray) -> np.ndarray:
    """Rigid poses with their rotations, stored in single precision, projected to the nearest rotations by SVD.

    scipy's `Rotation.from_matrix` goes through quaternions and differs in the last bits; `scipy.linalg.polar` does the
    same SVD for one matrix at a time, 8 times slower.
    """
    left, _, right = np.linalg.svd(poses[:, :3, :3])
    result = poses.copy()
    result[:, :3, :3] = left @ right
    return result


def fit_columns(values: np.ndarray, count: int) -> np.ndarray:
    """Coefficients padded with zeros or truncated to `count` columns.

    Raises:
        InputError: A truncated coefficient is not zero.
    """
    if np.any(values[:, count:]):
        raise InputError(
            f"expected at most {count} expression coefficients as in the head model, found {values.shape[1]} in the "
            "tracking; give the head model that it was made with"
        )
    return np.pad(values[:, :count], ((0, 0), (0, max(0, count - values.shape[1]))))


STAGE = Stage("tracking", "Tracking", inputs, run, outputs=(TRACKED, HEAD), version=12)
