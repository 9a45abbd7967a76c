"""What opens a file that somebody gave us: the functions behind the commands, and the commands themselves.

A reader gets a path in a tree of `bases.py`, reads all that a user's command would, and may return what it found.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np


class CommandFailed(Exception):
    """A command refused its input with exit code 2; the message is what it printed."""


@dataclass(frozen=True)
class Reader:
    """A way to open a file.

    Attributes:
        open: Reads it; raises an `InputError` (or `CommandFailed`) for anything that cannot be used.
        writes: It writes into the tree, as commands do.
        longest: Most characters of a message.
        forgets: Files and folders of its own making that it would read instead of making them again; removed before it
            opens the unchanged tree, and, if it works `anew`, each time.
    """

    open: Callable[[Path], Any]
    writes: bool = False
    longest: int = 2000
    forgets: tuple[str, ...] = ()
    anew: bool = False


def pickle(path: Path) -> None:
    """Other people's pickles and torch files."""
    from ggavatar.io.restricted_pickle import read_pickle

    read_pickle(path)


def npz(path: Path) -> None:
    """Every array of an archive."""
    from ggavatar.io.npz import npz_headers, read_npz

    npz_headers(path)
    read_npz(path)


def npy(path: Path) -> None:
    """One array."""
    from ggavatar.io.npz import read_npy

    read_npy(path, 1 << 20)


def json_object(path: Path) -> None:
    """One JSON object."""
    from ggavatar.io.json_files import read_json

    read_json(path)


def head(path: Path) -> None:
    """A head model of any kind, posed once."""
    from ggavatar.head.any_head import open_head

    model = open_head(path)
    assert np.isfinite(model.template.numpy()).all()
    model.vertices(model.neutral_drive())


def tracking(path: Path) -> str:
    """Another tracker's output, its format detected as `ggavatar-prep --tracking` does."""
    from preprocess.formats.registry import read_tracking_record
    from preprocess.options import PrepOptions

    name, record = read_tracking_record(PrepOptions(path, path, tracking=path))
    assert np.isfinite(record.expression).all() and np.isfinite(record.world_to_camera).all()
    return name


def tracking_as(name: str) -> Callable[[Path], None]:
    """The same where `--format` names it."""

    def read(path: Path) -> None:
        from preprocess.formats.registry import importer

        record = importer(name).read(path)
        assert len(record.numbers) > 0

    return read


def capture(path: Path) -> None:
    """A capture with its head and every pixel, as training and evaluation read it."""
    from ggavatar.data.capture import Capture
    from ggavatar.head.files import load_head

    opened = Capture.open(path)
    load_head(opened.head_path)
    for number in opened.frames:
        opened.image(number), opened.mask(number)


def run(path: Path) -> None:
    """A run as evaluation and export open it."""
    from ggavatar.training.run_folder import open_run

    opened = open_run(path)
    list(opened.frames(opened.split.test))


def journal(path: Path) -> None:
    """The lines of a journal, as `curves.png` shows them."""
    from ggavatar.training.journal import read_journal

    read_journal(path)


def results(path: Path) -> None:
    """Stored scores, as tables and gates read them."""
    from evaluate.gates.baselines import read_baselines
    from evaluate.protocols.results import read_results

    found = read_results(path)
    found.as_dict()
    read_baselines(path)


def baseline(path: Path) -> None:
    """A file of means of a repository."""
    from evaluate.gates.baselines import read_baselines

    read_baselines(path)


def picture(path: Path) -> None:
    """An image as color and as mask."""
    from ggavatar.io.images import read_gray, read_rgb

    read_rgb(path)
    read_gray(path)


def frames(path: Path) -> None:
    """A video or a folder of images, every frame decoded."""
    from preprocess.video.sources import open_source

    source = open_source(path)
    for frame in source.frames():
        assert frame.image.size <= 3 * 34_000_000
    source.decode_errors()


def gaussians(path: Path) -> None:
    """A file of Gaussians of any kind."""
    from ggavatar.formats.gaussian_files import digest, read_gaussians

    rows = read_gaussians(path)
    arrays = (rows.means, rows.sh_dc, rows.sh_rest, rows.opacity_logits, rows.log_scales, rows.quats)
    assert len(rows) > 0 and all(np.isfinite(array).all() for array in arrays)
    digest(path)


def recording(path: Path) -> None:
    """A recording of ARKit's scores."""
    from ggavatar.formats.arkit_recording import read_arkit_recording

    found = read_arkit_recording(path)
    assert np.isfinite(found.scores).all()


def parameters(path: Path) -> None:
    """FLAME parameters of GaussianAvatars."""
    from ggavatar.formats.flame_parameters import read_flame_parameters

    read_flame_parameters(path)


def driving(path: Path) -> None:
    """A driving sequence of `ggavatar-render --drive`."""
    from evaluate.motion.driving_sequence import read_driving_sequence

    read_driving_sequence(path)


def weights(path: Path) -> None:
    """Weights of a pretrained network."""
    from ggavatar.pretrained.weights import load_weights

    load_weights(path)


def landmark_networks(path: Path) -> None:
    """MediaPipe's bundle or a network of its own, run once."""
    import cv2

    from ggavatar.landmarks.bundle import canonical_face, load_network

    if path.suffix == ".task":
        canonical_face(path)
    network = load_network(path, "landmarks")
    network.setInput(cv2.dnn.blobFromImage(np.zeros((256, 256, 3), np.float32)))
    network.forward()


def mask_network(path: Path) -> None:
    """A mask network that the user gives, run on one image."""
    from preprocess.masks.matting import open_matting

    matting = open_matting(str(path), None, True)
    list(matting.masks([np.zeros((64, 64, 3), np.uint8)]))


def split_file(path: Path) -> None:
    """Lists of frames for `--split file:PATH`."""
    from ggavatar.data.splits import split_frames

    split_frames(tuple(range(6)), f"file:{path}")


def pictures(path: Path) -> None:
    """Pictures of another program with their ground truth: names and pixels."""
    from evaluate.scoring.frame_pairs import pair_folders
    from evaluate.scoring.image_decoding import read_scored

    for pair in pair_folders(path / "pred", path / "truth"):
        read_scored(pair.prediction, (1.0, 1.0, 1.0))
        read_scored(pair.truth, (1.0, 1.0, 1.0))


def command(entry: str, *arguments: str) -> Callable[[Path], str]:
    """A reader that runs a command in this process; `{}` in its arguments is the path."""
    return lambda path: run_command(entry, *(argument.replace("{}", str(path)) for argument in arguments))


def run_command(entry: str, *arguments: str, code: int = 0) -> str:
    """Run a command, `module:function`, in this process; what it wrote to stderr.

    Raises:
        CommandFailed: Exit code 2.
        AssertionError: Another exit code than `code` and 2.
    """
    module, _, name = entry.partition(":")
    function = getattr(importlib.import_module(module), name)
    errors, saved = io.StringIO(), sys.argv
    sys.argv = ["command", *arguments]
    try:
        with contextlib.redirect_stderr(errors):
            found = function()
    except SystemExit as stop:
        found = stop.code
    finally:
        sys.argv = saved
    text = errors.getvalue()
    if found == 2:
        raise CommandFailed(text)
    assert found == code, f"exit code {found}: {text[-500:]}"
    return text


def names(path: Path) -> None:
    """A table of stored scores in all its formats, checked for what its names must not become."""
    from tests.faults.hostile.outputs import check_outputs

    folder = path.parent / "tables"
    printed = io.StringIO()
    flags = ("--table", "--fail-below", "psnr=99", "--junit", str(folder / "junit.xml"), "-o", str(folder))
    with contextlib.redirect_stdout(printed):
        text = run_command("evaluate.cli.evaluate:main", str(path), *flags, code=3)
    wrong = check_outputs(folder, printed.getvalue() + text)
    assert not wrong, "; ".join(wrong[:5])


class _Listener:
    """Keeps the warnings of an evaluation."""

    def __init__(self) -> None:
        self.warnings: list[str] = []

    def progress(self, title: str) -> None:
        """Nothing is shown."""

    def warn(self, text: str) -> None:
        """Keep it."""
        self.warnings.append(text)


def comparable(evaluation: Any) -> dict[str, Any]:
    """The numbers of an evaluation without those that another run of the same would not repeat: times, places."""
    found = json.loads(json.dumps(evaluation.as_dict()))
    costs = {name: value for name, value in found["efficiency"].items() if not name.startswith("fps")}
    parts = ("seed", "protocol", "summary", "hashes", "identical", "unmeasured", "frames", "per_frame", "setup")
    return {"efficiency": costs, **{name: found[name] for name in parts}}


def numbers(path: Path) -> str:
    """Evaluate a run; other numbers than before must be warned of."""
    from evaluate.options import Options
    from evaluate.scoring.run import evaluate_run

    listener = _Listener()
    evaluation, files = evaluate_run(path / "run", Options(no_learned=True), listener)
    expected = json.loads((path / EXPECTED).read_text(encoding="utf-8"))
    found = {"numbers": comparable(evaluation), "per_frame.csv": files[1].read_text(encoding="utf-8", errors="replace")}
    changed = [
        name
        for name, value in {**found, **found["numbers"]}.items()
        if {**expected, **expected["numbers"]}[name] != value
    ]
    assert not changed or listener.warnings, f"other {', '.join(changed)}, and no word about it"
    return "; ".join(listener.warnings)


EXPECTED = "expected.json"
"""File of a tree with the numbers of its run."""

_TRAIN = ("ggavatar.cli.train:train", "{}/capture", "gaussian_avatars", "--device", "cpu", "-q", "-o", "{}/run")

READERS: dict[str, Reader] = {
    "pickle": Reader(pickle),
    "npz": Reader(npz),
    "npy": Reader(npy),
    "json": Reader(json_object),
    "head": Reader(head),
    "tracking": Reader(tracking, longest=4000),
    "capture": Reader(capture),
    "run": Reader(run),
    "journal": Reader(journal),
    "results": Reader(results),
    "baseline": Reader(baseline),
    "picture": Reader(picture),
    "frames": Reader(frames),
    "gaussians": Reader(gaussians),
    "recording": Reader(recording),
    "parameters": Reader(parameters),
    "driving": Reader(driving),
    "weights": Reader(weights),
    "landmark-networks": Reader(landmark_networks),
    "mask-network": Reader(mask_network),
    "split-file": Reader(split_file),
    "pictures": Reader(pictures),
    "names": Reader(names, writes=True),
    "numbers": Reader(numbers, writes=True, forgets=("run/eval",)),
    "numbers-anew": Reader(numbers, writes=True, forgets=("run/eval",), anew=True),
    "eval": Reader(
        command("evaluate.cli.evaluate:main", "{}/run", "--no-learned", "-q"), writes=True, forgets=("run/eval",)
    ),
    "eval-results": Reader(command("evaluate.cli.evaluate:main", "{}", "--no-learned", "-q"), writes=True),
    "resume": Reader(command(*_TRAIN, "--resume"), writes=True),
    "export-run": Reader(command("ggavatar.cli.export:main", "{}/run", "--overwrite"), writes=True),
    "export-file": Reader(command("ggavatar.cli.export:main", "{}", "-o", "{}.out.ply", "--overwrite"), writes=True),
    "export-capture": Reader(command("ggavatar.cli.export:main", "{}/capture", "--format", "vhap"), writes=True),
    "doctor": Reader(command("preprocess.cli.doctor:main", "{}/capture"), writes=True),
}
"""By name; `tracking:NAME` (see `reader_of`) is an importer that was chosen by name."""


def reader_of(name: str) -> Reader:
    """The reader of that name."""
    kind, _, choice = name.partition(":")
    return Reader(tracking_as(choice)) if choice else READERS[kind]
