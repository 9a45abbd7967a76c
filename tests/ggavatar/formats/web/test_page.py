"""The page's assembly: bundles, hashes of its policy, hostile titles, and that node accepts every module."""

from __future__ import annotations

import base64
import hashlib
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from ggavatar.formats.web import page as assembling
from ggavatar.formats.web.page import MAIN, WORKER, bundle, import_order, page, source

PAGE = Path(assembling.__file__).parent / "page"
NAMES = re.compile(r"^(?:export )?(?:async )?(?:function|class|const|let) (\w+)", re.MULTILINE)
HOSTILE = "</title><script>alert(1)</script>&<!--AVATAR-->"


def test_the_policy_names_exactly_what_is_in_the_page() -> None:
    text = page(HOSTILE, b"\0\1 bytes")
    style, script = (
        re.search(pattern, text, re.DOTALL) for pattern in (r"<style>(.*?)</style>", r"<script>(.*?)</script>")
    )
    assert style and script
    for kind, found in (("style", style[1]), ("script", script[1])):
        digest = base64.b64encode(hashlib.sha256(found.encode()).digest()).decode()
        assert f"{kind}-src 'sha256-{digest}'" in text
    assert "default-src 'none'" in text and "unsafe" not in text
    assert text.count("<script>") == 1, "no other script runs"
    assert "&lt;/title&gt;&lt;script&gt;alert(1)&lt;/script&gt;&amp;&lt;!--AVATAR--&gt;" in text
    assert base64.b64decode(re.search(r'id="avatar">([^<]*)<', text)[1]) == b"\0\1 bytes"  # type: ignore[index]
    assert not re.search(r"https?://|@import|url\(|fetch\(|XMLHttp|WebSocket|import\(|innerHTML|eval\(", text)
    assert text == page(HOSTILE, b"\0\1 bytes")


@pytest.mark.parametrize("entry", [MAIN, WORKER])
def test_a_bundle_is_its_modules_in_the_order_of_their_imports(entry: str) -> None:
    order = import_order(entry)
    assert order[-1] == entry and len(set(order)) == len(order)
    text = bundle(entry)
    names = [name for module in order for name in NAMES.findall(source(module))]
    assert len(names) == len(set(names)), f"two modules define {[name for name in names if names.count(name) > 1][:1]}"
    assert all(re.search(rf"\b{name}\b", text) for name in names)


def test_every_module_is_in_a_bundle() -> None:
    assert {path.name for path in PAGE.glob("*.mjs")} == {*import_order(MAIN), *import_order(WORKER)}
    assert {path.name for path in PAGE.glob("*.glsl")} == set(assembling.SHADERS)


def test_circles_and_imports_over_several_lines_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    sources = {
        "a.mjs": 'import { b } from "./b.mjs";\n',
        "b.mjs": 'import { a } from "./a.mjs";\n',
        "c.mjs": "import {\n",
    }
    monkeypatch.setattr(assembling, "source", sources.__getitem__)
    with pytest.raises(ValueError, match=r"a\.mjs -> b\.mjs -> a\.mjs"):
        import_order("a.mjs")
    with pytest.raises(ValueError, match="can leave out"):
        bundle("c.mjs")


def test_node_accepts_every_module(tmp_path: Path) -> None:
    if shutil.which("node") is None:
        pytest.skip("needs node")
    for name in (MAIN, WORKER):
        (tmp_path / "bundle.js").write_text(bundle(name))
        ran = subprocess.run(
            ["node", "--check", str(tmp_path / "bundle.js")], capture_output=True, text=True, check=False
        )
        assert ran.returncode == 0, ran.stderr


def test_modules_are_small() -> None:
    """Code of the page is code: lines and files as short as ours."""
    for path in PAGE.iterdir():
        lines = path.read_text(encoding="utf-8").split("\n")
        limit = 160 if path.suffix == ".css" else 140
        assert len(lines) <= 320 and max(map(len, lines)) <= limit + 80 * (path.suffix == ".html"), path.name
