"""Renders an avatar driven by a performance and measures how much of it arrives."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8

from evaluate.motion.driving_sequence import DrivingSequence, driving_sequence_of_run
from evaluate.motion.retarget import drives_and_cameras
from evaluate.motion.transfer import TransferOptions
from evaluate.reenactment.fidelity import Fidelity, head_rotation, landmark_jitter, pose_distance, score_fidelity
from evaluate.rendering.driven import Rest, perform
from ggavatar.core import Camera
from ggavatar.data.capture import Capture
from ggavatar.data.expression_scores import faces_in, scores_of
from ggavatar.errors import InputError
from ggavatar.io.images import read_rgb
from ggavatar.landmarks.blendshapes import NAMES
from ggavatar.landmarks.bundle import canonical_face
from ggavatar.landmarks.crop_region import LEFT_EYE_OUTER, RIGHT_EYE_OUTER
from ggavatar.landmarks.tracker import Landmarks, LandmarkTracker
from ggavatar.pictures.quantization import to_8_bit
from ggavatar.pretrained.resolve import ModelFinder
from ggavatar.training.run_folder import Run

WIDTH = 256
"""Width of the images that are measured, px."""
RUN_LENGTH, MOST_RUNS = 5, 40
"""Consecutive frames that are measured together, and how many such groups a long performance is measured in."""


@dataclass(frozen=True)
class SeenFaces:
    """What the landmark networks see in images, NaN where they find no face."""

    scores: Float[np.ndarray, "T 52"]
    points: Float[np.ndarray, "T 478 2"]
    heads: Float[np.ndarray, "T 3 3"]


@dataclass(frozen=True)
class Reenactment:
    """Measures of one avatar and one driver.

    Attributes:
        driver: Name of the driving performance; the avatar's own test frames if `is_own`.
        subject: The avatar's subject.
        method: Its method.
        is_own: Whether the avatar is driven by its own test frames, without any transfer.
        frames: Frames that were measured.
        lost: Frames in which the avatar's face was not found.
        fidelity: Of the scores.
        pose_distance: APD, degrees.
        jitter: Of the avatar's landmarks; None without consecutive frames.
        driver_jitter: The same of the driver.
    """

    driver: str
    subject: str
    method: str
    is_own: bool
    frames: int
    lost: int
    fidelity: Fidelity
    pose_distance: float
    jitter: float | None
    driver_jitter: float | None

    def as_dict(self) -> dict[str, object]:
        """Plain values for JSON; the fidelity of every score by name."""
        values = {name: value for name, value in vars(self).items() if name != "fidelity"}
        found = self.fidelity.agreement
        columns = zip(NAMES[1:], found.correlations, found.slopes, found.weights, strict=True)
        by_name = {
            name: {"correlation": float(correlation), "slope": float(slope), "driver_deviation": float(weight)}
            for name, correlation, slope, weight in columns
        }
        means = {"correlation": found.correlation, "slope": found.slope}
        means["expression_distance"] = self.fidelity.expression_distance
        return values | means | {"scores": by_name}


def measure_reenactment(
    run: Run,
    source: Path | None,
    finder: ModelFinder,
    how: TransferOptions | None = None,
    report: Callable[[int, int], None] = lambda done, total: None,
) -> Reenactment:
    """Drive the avatar of a run by a capture, or by its own test frames if `source` is None, and measure it.

    Args:
        run: The avatar.
        source: Capture folder of the driver.
        finder: Finds the landmark networks.
        how: How the performance is carried over.
        report: Called with (done, total) after every image.

    Raises:
        InputError: The source is no capture, does not fit the avatar, or the faces are not found.
    """
    if source is not None and not source.is_dir():
        raise InputError(f"{source}: expected a capture folder, whose images show the driver, found a file")
    bundle = finder.find("face_landmarker")
    capture = run.capture if source is None else Capture.open(source)
    driver, moved = _performances(run, source, how or TransferOptions(), finder)
    rows = measured_rows(driver.frames)
    driver, moved = driver.rows(rows), moved.rows(rows)
    total = 2 * len(rows)
    images = (read_rgb(capture.image_path("images", frame)) for frame in driver.frames)
    real = see_faces(images, bundle, lambda done: report(done, total))
    seen = see_faces(render_small(run, moved), bundle, lambda done: report(len(rows) + done, total))
    try:
        fidelity = score_fidelity(real.scores[:, 1:], seen.scores[:, 1:])
    except ValueError as few:
        raise InputError(f"{source or run.folder}: {few}; such a reenactment cannot be measured") from few
    eyes = RIGHT_EYE_OUTER, LEFT_EYE_OUTER
    return Reenactment(
        driver=capture.subject,
        subject=run.capture.subject,
        method=run.method,
        is_own=source is None,
        frames=len(rows),
        lost=int((~np.isfinite(seen.scores).all(axis=1)).sum()),
        fidelity=fidelity,
        pose_distance=pose_distance(real.heads, seen.heads),
        jitter=landmark_jitter(seen.points, driver.frames, eyes),
        driver_jitter=landmark_jitter(real.points, driver.frames, eyes),
    )


def _performances(
    run: Run, source: Path | None, how: TransferOptions, finder: ModelFinder
) -> tuple[DrivingSequence, DrivingSequence]:
    """The driver's performance, and what the avatar makes of it."""
    if source is None:
        own = driving_sequence_of_run(run)
        own = own.rows(np.array([own.row(frame) for frame in run.split.test]))
        return own, own
    performance = perform(run, source, how, Rest(), finder)
    return performance.driver, performance.moved


def measured_rows(frames: tuple[int, ...]) -> np.ndarray:
    """All rows of a short performance; of a longer one, evenly spaced groups of consecutive rows."""
    groups = max(1, len(frames) // RUN_LENGTH)
    if groups <= MOST_RUNS:
        return np.arange(len(frames))
    starts = np.linspace(0, len(frames) - RUN_LENGTH, MOST_RUNS).round().astype(int)
    return np.unique(starts[:, None] + np.arange(RUN_LENGTH))


def render_small(run: Run, sequence: DrivingSequence) -> Iterator[UInt8[np.ndarray, "H W 3"]]:
    """The avatar in every frame of a sequence, `WIDTH` px wide."""
    for _, drive, camera in drives_and_cameras(sequence, run.head):
        factor = WIDTH / camera.width
        scale = camera.intrinsics.new_tensor([factor, factor, 1.0])
        height = round(camera.height * factor)
        small = Camera(scale[:, None] * camera.intrinsics, camera.world_to_camera, WIDTH, height)
        with torch.no_grad():
            image = run.rasterize(run.avatar.gaussians(drive), small, run.background).image
        yield to_8_bit(image.float().cpu().numpy())


def see_faces(images: Iterable[UInt8[np.ndarray, "H W 3"]], bundle: Path, report: Callable[[int], None]) -> SeenFaces:
    """Landmarks, scores and orientation of the face in every image, each on its own."""
    canonical = canonical_face(bundle).vertices * [1, -1, -1]
    faces = []
    for face in faces_in(images, LandmarkTracker(bundle)):
        faces.append(face)
        report(len(faces))
    points = [np.full((478, 2), np.nan) if face is None else face.points for face in faces]
    heads = [np.full((3, 3), np.nan) if face is None else _orientation(face, canonical) for face in faces]
    return SeenFaces(scores_of(faces), np.array(points, np.float64), np.array(heads))


def _orientation(face: Landmarks, canonical: Float[np.ndarray, "L 3"]) -> Float[np.ndarray, "3 3"]:
    return head_rotation(np.column_stack((face.points, face.depth))[: len(canonical)], canonical)
