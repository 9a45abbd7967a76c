"""Valid trees of files that fixtures change: single files of every format, tracker outputs, a capture with its run.

They are made by the project's own writers, once, and copied for every worker.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from tests.faults.hostile import samples
from tests.faults.hostile.fixture import remove
from tests.mutations.mutation import ROOT

FILES, RUN, PICTURES, FRAMES = "files", "avatar", "pictures", "frames"
"""Trees: single files; a capture and a run with its evaluation; pictures beside ground truth; a folder of images."""


class Trees:
    """Copies of the valid trees in a worker's sandbox.

    Args:
        originals: Folder of the valid trees.
        sandbox: Folder of the worker.
    """

    def __init__(self, originals: Path, sandbox: Path) -> None:
        self.sandbox, self.scratch, self._originals = sandbox, sandbox / "scratch", originals
        self.scratch.mkdir()
        (sandbox / "victim.txt").write_text("must stay")

    def copy(self, name: str) -> Path:
        """The copy of a tree."""
        tree = self.sandbox / name
        if not tree.exists():
            shutil.copytree(self._originals / name, tree, symlinks=True)
        return tree

    def restore(self, name: str, changed: Sequence[str] | None) -> None:
        """Undo what was done to a tree.

        Args:
            name: Of the tree.
            changed: Its files that were changed; None if a command may have written anything.
        """
        tree, original = self.sandbox / name, self._originals / name
        if changed is None:
            remove(tree)
            shutil.copytree(original, tree, symlinks=True)
        for file in changed or ():
            remove(tree / file)
            if (original / file).is_dir():
                shutil.copytree(original / file, tree / file, symlinks=True)
            elif (original / file).is_file():
                shutil.copyfile(original / file, tree / file)
            for home in (tree / file).relative_to(tree).parents:  # from the innermost; folders made for the file
                if not (original / home).exists() and (tree / home).exists():
                    remove(tree / home)
        for extra in self.sandbox.iterdir():
            if extra.name != "victim.txt" and not (self._originals / extra.name).exists():
                remove(extra)
        self.scratch.mkdir()
        (self.sandbox / "victim.txt").write_text("must stay")


def make_trees(home: Path) -> Path:
    """Make every valid tree below a folder, in a process of its own: trainings handle signals."""
    code = f"from pathlib import Path; from {__name__} import {make_tree.__name__}, names; "
    code += "import sys; [make_tree(name, Path(sys.argv[1]) / name) for name in names()]"
    ended = subprocess.run(
        [sys.executable, "-c", code, str(home)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, f"the valid files could not be made:\n{ended.stderr[-2000:]}"
    return home


def names() -> list[str]:
    """The names of all trees."""
    from preprocess.formats.registry import importer_names

    return [*_MAKERS, *importer_names()]


def make_tree(name: str, folder: Path) -> Path:
    """Make a valid tree; its name says which."""
    if not folder.exists():
        _MAKERS.get(name, _tracking)(folder)
    return folder


def files_of(folder: Path) -> list[str]:
    """The files of a tree, relative to it."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def _files(folder: Path) -> None:
    folder.mkdir(parents=True)
    for name, content in samples.FILES.items():
        (folder / name).write_bytes(content())


def _tracking(folder: Path) -> None:
    """A clip of three frames in the layout of another tracker, whose name is that of the tree."""
    from ggavatar.errors import InputError
    from preprocess.formats.registry import importer
    from tests.support.synthetic_clip import moving_record, sheap_record, still_camera, weak_perspective

    records = [moving_record(3, (96, 96)), moving_record(3, (512, 512))]
    for record in records:
        record.joint_rotations[:, :2] = 0
    for record in (*records, weak_perspective(3), still_camera(3, (96, 96), 300.0), sheap_record(3)):
        try:
            importer(folder.name).write(folder / tracking_target(folder.name), record)
        except InputError:
            remove(folder)
            continue
        return
    raise AssertionError(f"{folder.name} can hold none of the clips; add one such as its tracker makes")


def tracking_target(name: str) -> str:
    """What an importer opens in the tree of its name: a file or a folder."""
    return "tracking.npz" if name == "npz" else "tracking"


def _capture(folder: Path) -> None:
    from ggavatar.data.capture import Capture
    from ggavatar.data.splits import Split
    from ggavatar.head.files import load_head
    from ggavatar.io.npz import read_npz
    from tests.support.synthetic_clip import as_tracking, draw, moving_record

    folder.parent.mkdir(parents=True)
    made = folder.parent / "made.npz"
    made.write_bytes(samples.own_head())
    head, record, numbers = load_head(made), moving_record(6, (48, 48)), tuple(range(6))
    splits = {"every-20th": Split(numbers[1:], (0,))}
    capture = Capture(folder, "ball", 48, 48, 25.0, numbers, splits, as_tracking(record), head.version)
    capture.write((draw(head, record, row) for row in numbers), read_npz(made))
    made.unlink()


def _avatar(folder: Path) -> None:
    """A capture, a run of three steps on it, and its evaluation; moved, so that a copy has its own capture."""
    from evaluate.protocols.results import FRAMES_FILE, read_results
    from tests.faults.hostile.readers import EXPECTED, comparable, run_command

    made = folder.with_name(f"{folder.name}-elsewhere")
    _capture(made / "capture")
    train = ("gaussian_avatars", "--steps", "3", "--device", "cpu", "-q", "--set", "perceptual_weight=0")
    run_command("ggavatar.cli.train:train", str(made / "capture"), *train, "-o", str(made / "run"))
    run_command("evaluate.cli.evaluate:main", str(made / "run"), "--no-learned", "-q")
    (home,) = (made / "run" / "eval").iterdir()
    expected = {"numbers": comparable(read_results(home)), "per_frame.csv": (home / FRAMES_FILE).read_text("utf-8")}
    (made / EXPECTED).write_text(json.dumps(expected), encoding="utf-8")
    made.rename(folder)


def _pictures(folder: Path) -> None:
    from ggavatar.io.images import write_png

    generator = np.random.default_rng(0)
    for number in range(3):
        for name in ("pred", "truth"):
            write_png(folder / name / f"{number:05d}.png", generator.integers(0, 255, (24, 32, 3), dtype=np.uint8))


def _frames(folder: Path) -> None:
    folder.mkdir(parents=True)
    for number in range(3):
        (folder / f"{number:05d}.png").write_bytes(samples.image(".png"))


_MAKERS: dict[str, Callable[[Path], None]] = {FILES: _files, RUN: _avatar, PICTURES: _pictures, FRAMES: _frames}
