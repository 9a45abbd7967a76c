"""Modules of the web avatar's page, run by node; tests that need it are skipped where it is not installed."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from base64 import b64decode
from pathlib import Path
from typing import Any

import pytest

PAGE = Path(__file__).parents[2] / "ggavatar/formats/web/page"


def run_modules(script: str, *names: str, folder: Path, values: Any = None) -> Any:
    """What a script returns, as JSON: the body of an async function that sees all exports of the named modules.

    Args:
        script: Its body; `values` is what was given.
        names: Modules, such as "algebra".
        folder: For temporary files.
        values: Plain values for the script.
    """
    if shutil.which("node") is None:
        pytest.skip("needs node, which runs the page's modules without a browser")
    given, result = folder / "given.json", folder / "result.json"
    given.write_text(json.dumps(values))
    imports = "".join(f'import * as {name} from "{(PAGE / f"{name}.mjs").as_uri()}";\n' for name in names)
    spread = ", ".join(f"...{name}" for name in names)
    body = (
        'import fs from "node:fs";\n'
        f"{imports}const run = async (values, fs, {{ {_exports(names)} }}) => {{\n{script}\n}};\n"
        f"const values = JSON.parse(fs.readFileSync({json.dumps(str(given))}, 'utf8'));\n"
        f"const found = await run(values, fs, {{ {spread} }});\n"
        f"fs.writeFileSync({json.dumps(str(result))}, JSON.stringify(found ?? null));\n"
    )
    main = folder / "main.mjs"
    main.write_text(body)
    ran = subprocess.run(["node", str(main)], capture_output=True, text=True, check=False, timeout=200)
    assert ran.returncode == 0, ran.stderr
    return json.loads(result.read_text())


def _exports(names: tuple[str, ...]) -> str:
    found = re.compile(r"^export (?:async function|function|class|const) (\w+)", re.MULTILINE)
    return ", ".join(name for module in names for name in found.findall((PAGE / f"{module}.mjs").read_text()))


def carried_bytes(page: Path) -> bytes:
    """The compressed container inside a page."""
    match = re.search(r'id="avatar">([^<]*)<', page.read_text(encoding="utf-8"))
    assert match is not None
    return b64decode(match[1])
