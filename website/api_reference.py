"""The reference of the public API: what `ggavatar/__init__.pyi` offers, each name where it is defined."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from website.project_links import ROOT

REFERENCE = "api-reference.md"
STUB = ROOT / "ggavatar" / "__init__.pyi"
INTRODUCTION = """# Reference

Names of `import ggavatar`, from their docstrings. Arrays and tensors have their shapes (`Float[Tensor, "N 3"]`),
lengths are meters, images `[0, 1]` unless stated ([conventions](conventions.md)).
"""


def reference_page() -> str:
    """Markdown with a directive of mkdocstrings for each public name: functions, then classes, then their options."""
    names = list(public_names(STUB.read_text(encoding="utf-8")))
    in_order = sorted(names, key=lambda name: (name.rpartition(".")[2][0].isupper(), name.rpartition(".")[2]))
    options = sorted({options for name in names for options in option_types(name)} - {*names})
    return INTRODUCTION + "".join(f"\n::: {name}\n" for name in (*in_order, *options))


def public_names(stub: str) -> Iterator[str]:
    """Where the names are defined that a stub offers: `from MODULE import NAME as NAME`."""
    for node in ast.parse(stub).body:
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield from (f"{node.module}.{alias.name}" for alias in node.names if alias.asname == alias.name)


def option_types(function: str) -> Iterator[str]:
    """Where the keywords of a function are listed, if it takes `**options: Unpack[TYPE]` of its own module."""
    module, _, name = function.rpartition(".")
    path = ROOT.joinpath(*module.split(".")).with_suffix(".py")
    for node in ast.parse(path.read_text(encoding="utf-8")).body if path.is_file() else ():
        if isinstance(node, ast.FunctionDef) and node.name == name and node.args.kwarg:
            match = re.fullmatch(r"Unpack\[(\w+)\]", ast.unparse(node.args.kwarg.annotation or ast.Constant(None)))
            yield from (f"{module}.{found}" for found in (match.groups() if match else ()))
