"""Programs of npm that read or check our files, where they are installed; nothing is downloaded."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

SPLAT_TRANSFORM = "GGAVATAR_SPLAT_TRANSFORM"
"""Variable with the path of the executable of @playcanvas/splat-transform."""
NODE_MODULES = "GGAVATAR_NODE_MODULES"
"""Variable with a folder `node_modules` that holds gltf-validator and @gltf-transform/core."""


def splat_transform() -> list[str]:
    """The command of @playcanvas/splat-transform; skips the test where it is not installed."""
    given = os.environ.get(SPLAT_TRANSFORM)
    if given:
        return [given]
    npx = shutil.which("npx")
    if npx is None or shutil.which("node") is None:
        pytest.skip("needs node and @playcanvas/splat-transform: npm install -g @playcanvas/splat-transform")
    command = [npx, "--no-install", "splat-transform"]
    offline = os.environ | {"npm_config_offline": "true"}
    tried = subprocess.run(
        [*command, "--version"], capture_output=True, env=offline, stdin=subprocess.DEVNULL, check=False, timeout=60
    )
    if tried.returncode:
        pytest.skip(f"needs @playcanvas/splat-transform: npm install -g it, or set ${SPLAT_TRANSFORM} to it")
    return command


def transform(command: list[str], *arguments: object) -> None:
    """Run splat-transform without a GPU."""
    line = [*command, "-w", "-g", "cpu", *map(str, arguments)]
    ran = subprocess.run(line, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False, timeout=120)
    assert ran.returncode == 0, ran.stdout + ran.stderr


def node(script: str, package: str, *arguments: object) -> str:
    """What a script for node prints; skips the test where node or a package is not installed."""
    folder = os.environ.get(NODE_MODULES, "")
    if shutil.which("node") is None or not (Path(folder) / package / "package.json").is_file():
        pytest.skip(f"needs node and {package}: npm install it, and set ${NODE_MODULES} to its node_modules")
    line = ["node", "--input-type=commonjs", "-e", script, *map(str, arguments)]
    environment = os.environ | {"NODE_PATH": folder}
    ran = subprocess.run(line, capture_output=True, text=True, env=environment, check=False, timeout=120)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout
