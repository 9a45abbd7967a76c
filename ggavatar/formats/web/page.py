"""The page of a web avatar, assembled from its sources in `page/`: one HTML file with style, scripts, shaders and data.

The scripts are ES modules with one import a line, so that node can test each alone. A bundle is the modules that an
entry needs, in the order of their imports, without `import` and `export`, in one scope: no two may define one name.
"""

from __future__ import annotations

import base64
import hashlib
import html
import re
from importlib.resources import files

TEMPLATE, STYLE, MAIN, WORKER = "viewer.html", "viewer.css", "main.mjs", "worker.mjs"
SHADERS = ("splat.vert.glsl", "splat.frag.glsl", "whole.vert.glsl", "show.frag.glsl")
_IMPORT = re.compile(r'^import \{[^}\n]*\} from "\./([\w.]+)";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(?:async function|function|class|const) )", re.MULTILINE)
_PLACEHOLDER = re.compile(r"<!--([A-Z_]+)-->")


def page(title: str, container: bytes) -> str:
    """The whole page.

    Args:
        title: Shown in the browser's tab; any text.
        container: The avatar (`ggavatar.formats.web.container.pack`).
    """
    style, script = source(STYLE), bundle(MAIN)
    values = {
        "TITLE": html.escape(title),
        "STYLE": style,
        "STYLE_HASH": _digest(style),
        "SCRIPT": script,
        "SCRIPT_HASH": _digest(script),
        "WORKER": bundle(WORKER),
        "SHADERS": "".join(f'<script type="text/plain" id="{name}">{source(name)}</script>\n' for name in SHADERS),
        "AVATAR": base64.b64encode(container).decode("ascii"),
    }
    return _PLACEHOLDER.sub(lambda match: values[match[1]], source(TEMPLATE))


def bundle(entry: str) -> str:
    """A module and all that it imports as one plain script in a scope of its own."""
    code = "".join(_EXPORT.sub("", _IMPORT.sub("", source(name))) for name in import_order(entry))
    if left := re.search(r"^(import|export)\b.*|.*</script.*", code, re.MULTILINE):
        raise ValueError(f"expected imports and exports that a bundle can leave out, got {left[0]!r}")
    return f'(() => {{\n"use strict";\n{code}}})();\n'


def import_order(entry: str) -> list[str]:
    """Names of the modules that an entry needs, each after those that it imports, the entry last.

    Raises:
        ValueError: Modules import each other in a circle.
    """
    order: list[str] = []

    def visit(name: str, path: tuple[str, ...]) -> None:
        if name in path:
            raise ValueError(f"expected modules without circular imports, got {' -> '.join((*path, name))}")
        if name not in order:
            for other in _IMPORT.findall(source(name)):
                visit(other, (*path, name))
            order.append(name)

    visit(entry, ())
    return order


def source(name: str) -> str:
    """The text of one file of the page."""
    return (files("ggavatar.formats.web") / "page" / name).read_text(encoding="utf-8")


def _digest(text: str) -> str:
    """What a content security policy calls a script or style: base64 of its SHA-256."""
    return base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")
