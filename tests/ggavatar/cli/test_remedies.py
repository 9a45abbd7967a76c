"""What a message advises can be done: every flag that it names exists on the command that says it.

The flags of the commands' own dataclasses are the reference. A module's messages belong to the commands that import it,
in whatever depth; exceptions are listed with their reason.
"""

from __future__ import annotations

import ast
import errno
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

from ggavatar.cli.flags import spellings_of
from ggavatar.cli.remedies import exhausted, less_memory, next_step
from website.command_pages import PAGES

ROOT = Path(__file__).parents[3]
FLAGS = {program: spellings_of(page.options) for program, page in PAGES.items()}
ENTRIES = {
    program: f"{package}.cli.{program.removeprefix('ggavatar-').replace('eval', 'evaluate')}"
    for package, programs in {
        "ggavatar": ("ggavatar-train", "ggavatar-sweep", "ggavatar-export", "ggavatar-models"),
        "preprocess": ("ggavatar-prep", "ggavatar-doctor", "ggavatar-demo"),
        "evaluate": ("ggavatar-render", "ggavatar-eval", "ggavatar-view"),
    }.items()
    for program in programs
}
ONLY_ON = {
    "evaluate.protocols.protocol": ({"ggavatar-eval"}, "others take protocols as they are"),
    "evaluate.rendering.driven": ({"ggavatar-render"}, "--reenact of ggavatar-eval drives in its own way"),
    "evaluate.scoring.ground_truth": ({"ggavatar-eval"}, "ggavatar-render scores nothing"),
    "ggavatar.cli.remedies": (set[str](), "they are given the flags of the command; see the tests below"),
    "ggavatar.data.splits": ({"ggavatar-train", "ggavatar-eval"}, "others read splits, these make them"),
    "ggavatar.formats.any_avatar": ({"ggavatar-render", "ggavatar-export"}, "ggavatar-view passes no step"),
    "ggavatar.formats.driving_options": ({"ggavatar-render"}, "the options of --drive"),
    "ggavatar.formats.licensed_heads": ({"ggavatar-export"}, "ggavatar-view exports nothing"),
    "ggavatar.formats.output_folder": ({"ggavatar-export"}, "ggavatar-view exports nothing"),
    "ggavatar.formats.web.clips": ({"ggavatar-export"}, "ggavatar-view exports nothing"),
    "ggavatar.formats.web.export": ({"ggavatar-export"}, "ggavatar-view exports nothing"),
    "ggavatar.formats.web.options": ({"ggavatar-export"}, "ggavatar-view exports nothing"),
    "ggavatar.io.frame_names": ({"ggavatar-prep"}, "others pass no camera, and say nothing of the one they use"),
    "ggavatar.pretrained.catalogue": ({"ggavatar-prep"}, "what a model is for"),
    "ggavatar.pretrained.folders": ({"ggavatar-train", "ggavatar-prep", "ggavatar-eval"}, "others pass no folder"),
    "ggavatar.render.backends": ({"ggavatar-train", "ggavatar-eval"}, "ggavatar-prep passes auto"),
    "ggavatar.sweeps.cell": ({"ggavatar-train"}, "the command line of a cell"),
    "ggavatar.training.session": ({"ggavatar-train"}, "ggavatar-sweep only configures; its cells are ggavatar-train"),
    "preprocess.doctor": ({"ggavatar-prep"}, "findings are printed as flags of ggavatar-prep"),
    "preprocess.options": ({"ggavatar-prep"}, "its options"),
}
"""Commands that can say what is in a module or in its room, where that are not all that import it, and why."""
CAPTURE_IS_GIVEN = {"ggavatar-train", "ggavatar-sweep"}
"""These are told the capture and never look for it, as `ggavatar.training.run_folder` does for others."""
RUN_FOLDER = {"--capture": set(FLAGS) - CAPTURE_IS_GIVEN, "-o": {"ggavatar-train"}, "--overwrite": {"ggavatar-train"}}
NOT_TYPED = {
    "--wait",
    "--eval-every",
    "--no-refine",
    "--tracker",
    "--bind_to_mesh",
    "--white_background",
    "--table",
    "--layout",
}
"""Of our own programs among themselves, taken before the parser, the beginning of a name, or of other programs."""
WORDS = re.compile(r"(ggavatar-[a-z]+)|([;(])|(?<![\w-])(--[a-z][\w.-]*|-o\b)")


def modules() -> dict[str, Path]:
    """Every module of the three packages."""
    paths = (path for package in ("ggavatar", "preprocess", "evaluate") for path in (ROOT / package).rglob("*.py"))
    return {".".join(path.relative_to(ROOT).with_suffix("").parts): path for path in paths}


def importers(trees: dict[str, ast.Module]) -> dict[str, set[str]]:
    """The commands that import each module, also inside functions."""
    imports: dict[str, set[str]] = {}
    for name, tree in trees.items():
        nodes = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module]
        imports[name] = {f"{node.module}.{alias.name}" for node in nodes for alias in node.names}
        imports[name] |= {str(node.module) for node in nodes}
    reached = defaultdict(set)
    for program, entry in ENTRIES.items():
        todo = [entry]
        while todo:
            name = todo.pop()
            if name in trees and program not in reached[name]:
                reached[name].add(program)
                todo += imports[name]
    return reached


def texts(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and text of every string that is no docstring; what is filled in is a zero byte."""
    inner = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    inner |= {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield node.lineno, "".join(str(one.value) if isinstance(one, ast.Constant) else "\0" for one in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inner:
            yield node.lineno, node.value


def wrong_flags(module: str, text: str, reached: set[str]) -> list[str]:
    """Flags in a text that a command which says it does not have."""
    room = ".".join(module.split(".")[:2])
    sayers = next((ONLY_ON[name][0] for name in (module, room) if name in ONLY_ON), reached)
    command, wrong = "", []
    for found in WORDS.finditer(text):
        if found[1] or found[2]:
            command = found[1] or ""
            continue
        flag = found[3].rstrip(".")
        own = reached & RUN_FOLDER.get(flag, {"ggavatar-train"}) if module == "ggavatar.training.run_folder" else sayers
        lacking = [one for one in ([command] if command in FLAGS else own) if flag not in FLAGS[one]]
        if lacking and flag not in NOT_TYPED:
            wrong.append(f"{flag} is not on {', '.join(sorted(lacking))}")
    return wrong


def test_every_flag_named_in_a_message_exists_on_the_command_that_says_it() -> None:
    trees = {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in modules().items()}
    reached = importers(trees)
    wrong = [
        f"{name}:{line}: {fault} in {text!r}"
        for name, tree in trees.items()
        for line, text in texts(tree)
        if "-" in text
        for fault in wrong_flags(name, text, reached[name])
    ]
    assert wrong == []
    assert set(ONLY_ON) <= set(trees) | {".".join(name.split(".")[:2]) for name in trees}


def test_a_wrong_remedy_is_found() -> None:
    assert wrong_flags("x.y.z", "choose another with -o", {"ggavatar-view"}) == ["-o is not on ggavatar-view"]
    assert wrong_flags("x.y.z", "run ggavatar-eval \0 --orbit", {"ggavatar-view"}) == [
        "--orbit is not on ggavatar-eval"
    ]
    assert wrong_flags("x.y.z", "run ggavatar-render \0 --orbit", {"ggavatar-view"}) == []


@pytest.mark.parametrize("program", sorted(FLAGS))
def test_remedies_name_flags_of_their_command(program: str) -> None:
    own = FLAGS[program]
    said = [next_step(code, own) for code in (errno.ENOSPC, errno.EACCES, errno.EROFS, errno.EMFILE)]
    said += [less_memory(own), less_memory(own, on_device=True), less_memory(frozenset())]
    for text in said:
        assert text and wrong_flags("x.y.z", text.replace("(-", " -"), {program}) == [], text


def test_errors_that_say_what_is_exhausted() -> None:
    found = exhausted(RuntimeError("DefaultCPUAllocator: can't allocate memory"), FLAGS["ggavatar-train"])
    assert found is not None and "fewer Gaussians (--max-gaussians)" in found[1] and "intact" in found[1]
    found = exhausted(RuntimeError("can't start new thread"), FLAGS["ggavatar-eval"])
    assert found is not None and "--threads" in found[1] and "--max-gaussians" not in found[1]
    assert exhausted(RuntimeError("another fault"), frozenset()) is None
