"""The jobs of ggavatar-render: views of a split, an orbit or a driving sequence, and the figure for each."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from torch import Tensor

from evaluate.figures.novel_views import novel_views
from evaluate.figures.reenactment import reenactment, representative_rows
from evaluate.figures.video import playback_fps
from evaluate.motion.driving_sequence import driving_sequence_of_run
from evaluate.motion.neutral import neutral_row
from evaluate.motion.orbit import head_center, orbit_angles, orbit_camera
from evaluate.motion.retarget import drives_and_cameras
from evaluate.protocols.method_names import display_name
from evaluate.protocols.protocol import GIVEN
from evaluate.rendering.driven import perform_as_asked
from evaluate.rendering.standalone_file import StandaloneGaussians, open_standalone
from evaluate.rendering.views import (
    DRIVE_FIGURE,
    FRAMES,
    ORBIT_FIGURE,
    RGBA,
    VIDEO,
    Output,
    View,
    claimed_folder,
    method_of_output,
    render_views,
)
from evaluate.scoring.frame_files import find_frame
from evaluate.scoring.gaussian_files import open_gaussian_file, refuse_file_flags
from evaluate.scoring.ground_truth import GroundTruth
from ggavatar.core import Camera, Drive
from ggavatar.data.background import Color, parse_background
from ggavatar.data.capture import DESCRIPTION, HEAD, TRACKING, Capture
from ggavatar.errors import InputError
from ggavatar.formats.any_avatar import open_avatar
from ggavatar.formats.source_options import is_gaussian_file
from ggavatar.io.digests import sha256_of
from ggavatar.io.held_folders import hold_folder
from ggavatar.io.images import read_rgb, write_png
from ggavatar.pretrained.resolve import ModelFinder
from ggavatar.render.backends import resolve_device
from ggavatar.text.terminal import write_err
from ggavatar.training.run_folder import Run
from ggavatar.training.same_capture import change_since_training

if TYPE_CHECKING:
    from evaluate.rendering.options import Options

COLUMNS = 6
"""Frames in the reenactment figure."""
DEFAULT_FPS = 25.0
"""Frame rate of an orbit around a file without a capture."""


@dataclasses.dataclass(frozen=True)
class RenderPlan:
    """What to render.

    Attributes:
        name: Name of the folder under RUN/renders.
        views: Views in order.
        fps: Frames per second of the video.
        write_figure: Writes the figure once the views are rendered, and returns its path, or None without a figure.
    """

    name: str
    views: Sequence[View]
    fps: float
    write_figure: Callable[[Output], Path | None]


def render(options: Options, progress: Callable[[int, int], None]) -> list[Path]:
    """Render what the options ask for and return the paths written: folders, video, figure.

    Raises:
        InputError: Options, run or output folder cannot be used, or the device is not available.
    """
    with hold_folder(options.run) if options.run.is_dir() else contextlib.nullcontext():
        return _render(options, progress)


def _render(options: Options, progress: Callable[[int, int], None]) -> list[Path]:
    run = _open(options, resolve_device(options.device))
    background = _background(options, run)
    if isinstance(run, StandaloneGaussians):
        plan = _orbit(options, run, run.front_view(), DEFAULT_FPS, background)
    else:
        plan = _plan(options, run, background)
    views = [_with_width(view, options.width) for view in _selected(plan.views, options.frames)]
    folder = options.output_dir or run.folder / "renders" / plan.name
    fps = (options.fps or plan.fps) if options.video else None
    output = Output(folder, background, fps, options.alpha)
    with claimed_folder(output, _content(options, run), options.overwrite, options.resume):
        render_views(run.avatar, run.rasterize, views, output, progress)
        figure = plan.write_figure(output)
    wanted = {FRAMES: True, RGBA: options.alpha, VIDEO: options.video}
    return [folder / name for name, is_there in wanted.items() if is_there] + ([figure] if figure else [])


def _open(options: Options, device: str) -> Run | StandaloneGaussians:
    """A run, or a file of Gaussians with or without a capture."""
    source = options.source
    if is_gaussian_file(options.run):
        if source.capture is None:
            return open_standalone(options.run, source, device, options.backend)
        return open_gaussian_file(options.run, source, GIVEN, device, options.backend)
    refuse_file_flags(options.run, source)
    moved = [] if source.capture is None else [source.capture]
    run = open_avatar(options.run, device, options.step, options.backend, *moved)
    if change := change_since_training(run):
        write_err(f"warning: {change}")
    return run


def _plan(options: Options, run: Run, background: Color) -> RenderPlan:
    if options.drive is not None:
        return _driven(options, run, background)
    if options.orbit:
        return _orbit(options, run, _neutral_view(options, run), run.capture.fps, background)
    frames_of = {"test": run.split.test, "train": run.split.train, "all": run.capture.frames}
    frames = frames_of[options.split]
    views = [View(frame, run.reader.drive(frame), run.reader.camera(frame)) for frame in frames]
    return RenderPlan(options.split, views, playback_fps(frames, run.capture.fps), lambda output: None)


def _neutral_view(options: Options, run: Run) -> tuple[Drive, Camera, Tensor]:
    """Drive and camera of the neutral frame, and the center of the head, m."""
    frame = options.driving.target_neutral
    if frame is None:
        frame = run.capture.frames[neutral_row(driving_sequence_of_run(run))]
    drive, camera = run.reader.drive(frame), run.reader.camera(frame)
    return drive, camera, head_center(run.head, drive)


def _orbit(
    options: Options, run: Run | StandaloneGaussians, view: tuple[Drive, Camera, Tensor], fps: float, background: Color
) -> RenderPlan:
    """An orbit with a fixed drive, starting at a camera and about a point."""
    drive, camera, center = view
    angles = orbit_angles(options.views, float(np.radians(options.yaw)), float(np.radians(options.pitch)))
    views = [View(index, drive, orbit_camera(camera, center, yaw, pitch)) for index, (yaw, pitch) in enumerate(angles)]

    def write_figure(output: Output) -> Path:
        path = output.folder / ORBIT_FIGURE
        write_png(path, novel_views(run.avatar, run.rasterize, view, background))
        return path

    return RenderPlan("orbit", views, fps, write_figure)


def _driven(options: Options, run: Run, background: Color) -> RenderPlan:
    source = options.drive or Path()
    performance = perform_as_asked(run, source, options.driving, ModelFinder())
    driver, moved = performance.driver, performance.moved
    if performance.note:
        write_err(f"note: {performance.note}")
    views = [View(*item) for item in drives_and_cameras(moved, run.head)]

    def write_figure(output: Output) -> Path:
        frames = [view.number for view in _selected(views, options.frames)]
        rows = np.array([driver.row(frame) for frame in frames])
        chosen = [frames[row] for row in representative_rows(driver.rows(rows), COLUMNS)]
        path = output.folder / DRIVE_FIGURE
        folders = _output_folders(display_name(run.method), output.folder, options.beside)
        results = {
            name: [read_rgb(find_frame(folder / FRAMES, frame)) for frame in chosen] for name, folder in folders.items()
        }
        captions = [f"frame {frame}" for frame in chosen]
        write_png(path, reenactment(_driver_images(source, chosen, background), results, captions))
        return path

    return RenderPlan(f"drive-{source.stem}", views, driver.fps, write_figure)


def _output_folders(method: str, own: Path, folders: Sequence[Path]) -> dict[str, Path]:
    """This output folder and earlier ones, by distinct method names."""
    found = {method: own}
    for folder in folders:
        name = display_name(method_of_output(folder))
        found[name if name not in found else f"{name} ({folder.name})"] = folder
    return found


def _driver_images(source: Path, frames: Sequence[int], background: Color) -> list[np.ndarray]:
    """The driver's own images, if it is a capture."""
    if not source.is_dir():
        return []
    capture = Capture.open(source)
    return [GroundTruth(background).image_and_mask(capture, frame)[0] for frame in frames]


def _background(options: Options, run: Run | StandaloneGaussians) -> Color:
    red, green, blue = run.background.tolist()
    if options.background is None:
        return red, green, blue
    return parse_background(options.background)


def _selected(views: Sequence[View], part: str | None) -> Sequence[View]:
    """The views selected by START:STOP:STEP; `InputError` if it is malformed or selects none."""
    if part is None:
        return views
    try:
        bounds = [int(text) if text else None for text in part.split(":")]
        chosen = views[slice(*bounds)] if 2 <= len(bounds) <= 3 else []
    except ValueError:
        chosen = []
    if not chosen:
        raise InputError(f"expected --frames START:STOP or START:STOP:STEP over {len(views)} frames, found {part!r}")
    return chosen


def _with_width(view: View, width: int | None) -> View:
    if width is None:
        return view
    height = max(1, round(view.camera.height * width / view.camera.width))
    return view._replace(camera=view.camera.resized(width, height))


def _motion_digest(path: Path) -> str:
    """SHA-256 of what moves an avatar: a file, or head, cameras and parameters of a capture, without its images."""
    files = [path / name for name in (DESCRIPTION, TRACKING, HEAD)] if path.is_dir() else [path]
    return hashlib.sha256("".join(map(sha256_of, files)).encode()).hexdigest()


def _content(options: Options, run: Run | StandaloneGaussians) -> dict[str, Any]:
    """Everything that determines the images, as plain values; compared by --resume."""
    skipped = {"run", "output_dir", "resume", "overwrite", "video", "fps", "device", "beside", "source"}
    chosen = {key: value for key, value in dataclasses.asdict(options).items() if key not in skipped}
    chosen |= chosen.pop("driving")
    chosen["drive"] = None if options.drive is None else str(options.drive.resolve())
    chosen["drive_sha256"] = None if options.drive is None else _motion_digest(options.drive)
    subject = run.subject if isinstance(run, StandaloneGaussians) else run.capture.subject
    content = {"subject": subject, "method": run.method, "step": run.step, "options": chosen}
    if isinstance(run, Run):
        content |= {"checkpoint_sha256": run.sha256, "motion_sha256": _motion_digest(run.capture.folder)}
    if "file_sha256" in run.provenance:
        opened = {name: None if value is None else str(value) for name, value in vars(options.source).items()}
        content["file"] = {"sha256": run.provenance["file_sha256"], **opened}
    return content
