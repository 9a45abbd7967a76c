"""NeRSemble's monocular avatar benchmark: rendered frames as the zip of videos that it takes as a submission.

Layout and numbers: nersemble-benchmark, data/submission_data.py and constants.py: `PERSON/SEQUENCE/cam_SERIAL.mp4`,
H.264 at quality 14, 24.3 frames per second, 512 × 512 px, every frame of the hidden sequences.
"""

from __future__ import annotations

import re
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import IO

from ggavatar.errors import InputError, nearest
from ggavatar.formats.output_folder import check_output_file, output_file
from ggavatar.io.atomic import write_atomically
from ggavatar.io.images import image_header, read_rgb

PERSONS = (393, 404, 461, 477, 486)
SEQUENCES = ("FREE", "EMO-1-shout+laugh", "SEN-09-frown_events_bad", "SEN-10-port_strong_smokey")
CAMERAS = ("222200037", "222200046", "220700191", "222200039")
"""The training camera, and those held out at the left, center and right."""

SIDE = 512
FPS = Fraction(243, 10)
QUALITY = 14
_PLACE = re.compile(r"^(\d{1,4})/([^/]+)/cam_(\w+)$")


@dataclass(frozen=True)
class Submission:
    """What was written.

    Attributes:
        path: The zip.
        frames: Number of frames of all videos.
        videos: Their names in the zip.
        missing: Names of the videos that a complete submission has besides.
    """

    path: Path
    frames: int
    videos: tuple[str, ...]
    missing: tuple[str, ...]


def write_submission(folder: Path, path: Path, overwrite: bool = False) -> Submission:
    """Encode `FOLDER/PERSON/SEQUENCE/cam_SERIAL/` (PNG frames, or `frames/` as ggavatar-render writes) into a zip.

    Raises:
        InputError: No such folders, a name that the benchmark does not have, a gap in the frames, images that are not
            512 × 512 px, cameras of a sequence that differ in length, or the zip exists already.
    """
    check_output_file(path, overwrite)
    clips = _clips(folder)
    _check_lengths(folder, clips)
    names = {place: f"{place}.mp4" for place in clips}

    def write(stream: IO[bytes]) -> None:
        with zipfile.ZipFile(stream, "w") as archive, tempfile.TemporaryDirectory() as temporary:
            for place, images in clips.items():
                video = Path(temporary) / "video.mp4"
                _encode(images, video)
                archive.write(video, names[place])

    with output_file(path, overwrite):
        write_atomically(path, write)
    expected = [f"{person}/{name}/cam_{camera}.mp4" for person in PERSONS for name in SEQUENCES for camera in CAMERAS]
    missing = tuple(name for name in expected if name not in names.values())
    return Submission(path, sum(map(len, clips.values())), tuple(names.values()), missing)


def _clips(folder: Path) -> dict[str, list[Path]]:
    """Images in order, by `PERSON/SEQUENCE/cam_SERIAL`."""
    clips = {}
    for place in sorted(folder.glob("*/*/cam_*")):
        name = place.relative_to(folder).as_posix()
        match = _PLACE.match(name)
        if match is None or not place.is_dir():
            continue
        for found, known in zip(match.groups(), (tuple(map(str, PERSONS)), SEQUENCES, CAMERAS), strict=True):
            if found not in known:
                raise InputError(
                    f"{place}: expected one of {', '.join(known)}, found {found!r}{nearest(found, known)}; rename it"
                )
        clips[name] = _frames(place / "frames" if (place / "frames").is_dir() else place)
    if not clips:
        raise InputError(
            f"{folder}: expected folders such as {PERSONS[0]}/{SEQUENCES[0]}/cam_{CAMERAS[0]}, found none; render them "
            "with ggavatar-render RUN -o to such folders"
        )
    return clips


def _frames(folder: Path) -> list[Path]:
    """The frames of a folder, numbered from 0 without gaps."""
    images = {int(path.stem): path for path in folder.glob("*.png") if path.stem.isdecimal() and len(path.stem) < 10}
    if sorted(images) != list(range(len(images))) or not images:
        gap = next((number for number in range(len(images)) if number not in images), 0)
        raise InputError(f"{folder}: expected every frame from 0 on as PNG, found no frame {gap}; render all frames")
    for path in images.values():
        header = image_header(path)
        if (header.width, header.height) != (SIDE, SIDE):
            found = f"{header.width}×{header.height}"
            raise InputError(
                f"{path}: expected {SIDE}×{SIDE} px, found {found}; render with ggavatar-render --width {SIDE}"
            )
    return [images[number] for number in range(len(images))]


def _check_lengths(folder: Path, clips: dict[str, list[Path]]) -> None:
    """Refuse cameras of one sequence that differ in length."""
    lengths: dict[str, tuple[str, int]] = {}
    for place, images in clips.items():
        sequence = place.rsplit("/", 1)[0]
        first, count = lengths.setdefault(sequence, (place, len(images)))
        if count != len(images):
            raise InputError(
                f"{folder / place}: expected {count} frames as in {first}, found {len(images)}; render all frames"
            )


def _encode(images: Sequence[Path], path: Path) -> None:
    """Write an H.264 video without color tags, as the benchmark's own writer does."""
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=FPS)
        stream.width, stream.height, stream.pix_fmt = SIDE, SIDE, "yuv420p"
        stream.options = {"crf": str(QUALITY)}
        for image in images:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(read_rgb(image), format="rgb24")))
        container.mux(stream.encode())
