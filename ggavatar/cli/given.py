"""What a command was given, told before anything is loaded: of a wrong kind, the message names the command that fits.

Only what can be recognized surely is refused here; the readers of the files judge the rest.
"""

from __future__ import annotations

import contextlib
import difflib
import shlex
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

from ggavatar.errors import InputError
from ggavatar.formats.avatar_suffix import is_avatar_file
from ggavatar.formats.source_options import is_gaussian_file
from ggavatar.io.image_suffixes import IMAGE_SUFFIXES
from ggavatar.io.json_files import read_json

CAPTURE, RUN, EVALUATION, VIDEO, IMAGES = "capture", "run", "evaluation", "video", "folder of images"
AVATAR, GAUSSIANS, DEMO, MISSING, OTHER = "avatar file", "file of Gaussians", "demo", "nothing", "other"
ARTICLES = {EVALUATION: "an evaluation", AVATAR: "an avatar file", DEMO: "the folder of ggavatar-demo"}
VIDEO_SUFFIXES = frozenset({".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".mts", ".wmv"})
MOST_ENTRIES = 2000
"""So many names of a folder are looked at."""


@dataclass(frozen=True)
class Expected:
    """What an argument of a command may be.

    Attributes:
        kinds: Those that the command takes.
        text: The same in words, after "expected".
        trains: Whether the command is the one that trains.
    """

    kinds: Collection[str]
    text: str
    trains: bool = False


A_CAPTURE = Expected({CAPTURE}, "a capture folder written by ggavatar-prep")
TO_TRAIN_ON = Expected(A_CAPTURE.kinds, A_CAPTURE.text, trains=True)
A_VIDEO = Expected({VIDEO, IMAGES}, "a video, or a folder of PNG or JPEG frames")
AN_AVATAR = Expected(
    {RUN, AVATAR, GAUSSIANS}, "a run folder written by ggavatar-train, an avatar file or a file of Gaussians"
)


def check_given(path: Path, expected: Expected) -> None:
    """Refuse a path that is not there, or is surely something else than expected.

    Raises:
        InputError: Says what is there and which command takes it, or the nearest name.
    """
    kind = kind_of(path)
    if kind in expected.kinds:
        return
    if kind == MISSING:
        raise InputError(f"{path}: no such file or folder{_near(path)}; expected {expected.text}")
    if kind != OTHER:
        raise InputError(f"{path}: expected {expected.text}, found {_named(kind)}; {_remedy(path, kind, expected)}")
    for inner in _folders_in(path):
        if (found := kind_of(inner)) in {CAPTURE, RUN} & set(expected.kinds):
            raise InputError(
                f"{path}: expected {expected.text}, found a folder with {_named(found)}; did you mean {inner}?"
            )


def kind_of(path: Path) -> str:
    """What a path is, by its content and, for videos, by its suffix; `OTHER` if it cannot be told."""
    if not path.exists():
        return MISSING
    if path.is_dir():
        return _kind_of_folder(path)
    if is_avatar_file(path):
        return AVATAR
    if path.name == "metrics.json":
        return EVALUATION
    if path.suffix.lower() in VIDEO_SUFFIXES:
        return VIDEO
    with contextlib.suppress(InputError, OSError):
        return GAUSSIANS if is_gaussian_file(path) else OTHER
    return OTHER


def _kind_of_folder(folder: Path) -> str:
    for name, kind in (("capture.json", CAPTURE), ("config.json", RUN), ("metrics.json", EVALUATION)):
        if (folder / name).is_file():
            return kind
    if (folder / "video.mp4").is_file() and (folder / "truth.npz").is_file():
        return DEMO
    with contextlib.suppress(InputError, OSError):
        if is_gaussian_file(folder):
            return GAUSSIANS
    suffixes = {Path(name).suffix.lower() for name in _names_in(folder)}
    return IMAGES if suffixes and suffixes <= IMAGE_SUFFIXES else OTHER


def _remedy(path: Path, kind: str, expected: Expected) -> str:
    """What to type instead."""
    name = clean_stem(path)
    given = shlex.quote(str(path))
    if kind == DEMO:
        return (
            f"make a capture of its video first: ggavatar-prep {shlex.quote(str(path / 'video.mp4'))} -o {name}-capture"
        )
    if kind in (VIDEO, IMAGES):
        return f"make a capture of it first: ggavatar-prep {given} -o captures/{name}"
    if kind == CAPTURE and RUN in expected.kinds:
        return f"train on it first: ggavatar-train {given} -o runs/{name}"
    if kind == CAPTURE:
        return f"it is ready: ggavatar-train {given} -o runs/{name}"
    if kind == RUN:
        return _remedy_for_run(path, expected)
    if kind in (AVATAR, GAUSSIANS):
        return f"to look at it: ggavatar-view {given}"
    return f"to print its scores: ggavatar-eval {given} --table"


def _remedy_for_run(run: Path, expected: Expected) -> str:
    """A run where a capture is expected: that of the run."""
    capture = "CAPTURE"
    with contextlib.suppress(InputError, OSError):
        capture = shlex.quote(str(read_json(run / "config.json")["capture"]))
    given = shlex.quote(str(run))
    if CAPTURE not in expected.kinds:
        return f"it is trained: ggavatar-eval {given} --table"
    if expected.trains:
        return f"to continue it: ggavatar-train {capture} -o {given} --resume"
    return f"its capture is {capture}"


def clean_stem(path: Path) -> str:
    """A short name for what is made of a path, to be typed in a shell."""
    stem = path.resolve().stem if path.is_file() else path.resolve().name
    return shlex.quote(stem or "new")


def _named(kind: str) -> str:
    return ARTICLES.get(kind, f"a {kind}")


def _near(path: Path) -> str:
    """The nearest name beside the part of a path that is missing."""
    missing = next((one for one in reversed(path.parents) if not one.exists()), path)
    close = difflib.get_close_matches(missing.name, list(_names_in(missing.parent)), n=1, cutoff=0.5)
    if close:
        return f" (did you mean {missing.parent / close[0]}?)"
    return "" if missing == path else f" ({missing} is missing)"


def _names_in(folder: Path) -> Iterator[str]:
    """Names in a folder, the first few thousand, without hidden ones; none if it cannot be listed."""
    with contextlib.suppress(OSError):
        for number, path in enumerate(folder.iterdir()):
            if number >= MOST_ENTRIES:
                return
            if not path.name.startswith("."):
                yield path.name


def _folders_in(path: Path) -> Iterator[Path]:
    """Folders in a folder, in alphabetical order."""
    if path.is_dir():
        yield from (path / name for name in sorted(_names_in(path)) if (path / name).is_dir())
