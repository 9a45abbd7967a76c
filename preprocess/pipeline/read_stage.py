"""First stage: reads the video once, records every frame's number and time, and detects the face."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ggavatar.errors import GateError, InputError
from ggavatar.io.digests import sha256_of, sha256_of_folder
from ggavatar.landmarks.detector import FaceBox
from preprocess.evidence.people import describe_others, follow_one
from preprocess.options import PrepOptions
from preprocess.pipeline.stage import Stage, StageContext, file_state
from preprocess.video.frame import DecodedFrame, FrameSource
from preprocess.video.image_folder import ImageFolder
from preprocess.video.selection import Selection, parse_selection
from preprocess.video.sources import open_source

MINIMUM_FRAMES = 8
"""Fewest frames that the built-in tracker works with."""
FACE_DETECTION_INTERVAL = 0.5
"""Time between two face detections, s."""


def inputs(options: PrepOptions) -> Mapping[str, Any]:
    """The source, the selection, and whether faces are detected."""
    selection = (options.fps, options.start, options.end, options.frames)
    return {
        "input": file_state(options.input),
        "camera": options.camera if options.input.is_dir() else None,
        "selection": selection,
        "faces": needs_faces(options),
    }


def needs_faces(options: PrepOptions) -> bool:
    """Whether the crop depends on detected faces; with imported tracking it depends on that instead."""
    return options.tracking is None and options.crop == "auto"


def open_input(options: PrepOptions) -> FrameSource:
    """The video or the folder of images."""
    return open_source(options.input, options.fps, options.camera)


def selection_of(options: PrepOptions) -> Selection:
    """The frames that the options select; for an image folder `--fps` is its frame rate, not a limit."""
    fps = None if options.input.is_dir() else options.fps
    return parse_selection(fps, options.start, options.end, options.frames)


def run(context: StageContext) -> Mapping[str, Any]:
    """Read the source; the result holds frame numbers, size and rate, the source's SHA-256, and face boxes.

    Raises:
        InputError: Fewer than two frames are selected.
        GateError: Frames were lost, with `--strict`.
    """
    options = context.options
    source, selection = open_input(options), selection_of(options)
    if isinstance(source, ImageFolder):
        for note in source.notes:
            context.reporter.note(note)
    detect = _face_finder(options) if needs_faces(options) else None
    numbers: list[int] = []
    times: list[float] = []
    faces: list[list[FaceBox]] = []
    alpha = _AlphaSample()
    size = (0, 0)
    for frame in selection.keep(source.frames()):
        if detect is not None and frame.time >= len(faces) * FACE_DETECTION_INTERVAL:
            faces.append(detect(frame))
        alpha.look(frame)
        numbers.append(frame.number)
        times.append(frame.time)
        size = (frame.width, frame.height)
        context.reporter.advance(len(numbers), None)
    _check_count(options, len(numbers))
    followed, others = follow_one(faces)
    if others:
        context.reporter.note(describe_others(followed, others, len(faces), size))
    for error in source.decode_errors():
        if options.strict:
            raise GateError(f"{options.input}: {error} (--strict)")
        context.reporter.warn(f"{options.input}: {error}; the frames before are kept")
    for conversion in source.conversions():
        context.reporter.note(f"{options.input}: {conversion}")
    return {
        "name": options.input.name,
        "sha256": (sha256_of_folder if options.input.is_dir() else sha256_of)(options.input),
        "width": size[0],
        "height": size[1],
        "fps": (len(times) - 1) / (times[-1] - times[0]) if times[-1] > times[0] else 25.0,
        "numbers": numbers,
        "faces": [list(face.corners) for face in followed],
        "faces_looked_for": len(faces),
        "losses": source.decode_errors(),
        "conversions": source.conversions(),
        "alpha": alpha.separates,
    }


def _check_count(options: PrepOptions, count: int) -> None:
    """Check that there are frames for training and for testing."""
    if count == 0:
        raise InputError(
            f"{options.input}: no frame could be decoded, or none is selected; check --start, --end and --frames"
        )
    if count == 1:
        raise InputError(
            f"{options.input}: expected a video with several hundred frames of a moving face, found only one frame"
        )
    if options.tracking is None and count < MINIMUM_FRAMES:
        raise InputError(
            f"{options.input}: too few frames: expected at least {MINIMUM_FRAMES}, and several hundred for a good "
            f"avatar, found {count}; record longer, or check --fps, --start, --end and --frames"
        )


class _AlphaSample:
    """Whether an alpha channel shows something and hides something, judged by two frames a second."""

    def __init__(self) -> None:
        self._due = 0.0
        self._least, self._most = 255, 0

    def look(self, frame: DecodedFrame) -> None:
        """Take a frame into account, if its turn has come."""
        if frame.alpha is None or frame.time < self._due:
            return
        self._due = frame.time + FACE_DETECTION_INTERVAL
        alpha = frame.alpha()
        self._least, self._most = min(self._least, int(alpha.min())), max(self._most, int(alpha.max()))

    @property
    def separates(self) -> bool:
        """Whether there are both clearly transparent and clearly opaque pixels."""
        return self._least < 64 and self._most > 192


def _face_finder(options: PrepOptions) -> Any:
    """A function that gives all faces of a frame."""
    from ggavatar.landmarks.detector import FaceDetector
    from ggavatar.pretrained.resolve import resolve_with_substitutes

    detector = FaceDetector(resolve_with_substitutes("face_landmarker", options.models, options.offline)[0])

    def find(frame: DecodedFrame) -> list[FaceBox]:
        return detector.detect_all(frame.image)

    return find


STAGE = Stage("frames", "Reading the video", inputs, run, version=2)
