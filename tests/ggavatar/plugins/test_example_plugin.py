"""`examples/plugin/` is installed by pip into an empty folder, and the commands know what it brings.

New processes, which find the folder by PYTHONPATH: nothing of this one is shared with them.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ggavatar.data.capture import Capture

ROOT = Path(__file__).parents[3]
COMMANDS = """
import sys
from evaluate.cli.evaluate import main as evaluate
from ggavatar.cli.export import main as export
from ggavatar.cli.train import train

capture, run = sys.argv[1:]
method = "painted_mesh_without_dssim"
sys.argv = ["ggavatar-train", capture, method, "-o", run, "--steps", "20", "--device", "cpu", "-q"]
codes = [train()]
codes += [evaluate([run, "--table", "--metrics", "psnr", "edge_error", "--no-report", "--device", "cpu", "-q"])]
codes += [export([run, "--format", "xyz", "--device", "cpu"])]
sys.exit(max(codes))
"""


@pytest.fixture(scope="module")
def plugin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that the package was installed into; pip builds it from a copy, without the network."""
    folder = tmp_path_factory.mktemp("environment")
    shutil.copytree(ROOT / "examples" / "plugin", folder / "source")
    flags = ["--no-deps", "--no-index", "--no-build-isolation", "--no-compile", "-q", "--target", str(folder / "site")]
    command = [sys.executable, "-m", "pip", "install", *flags, str(folder / "source")]
    subprocess.run(command, check=True, env={**os.environ, "PIP_DISABLE_PIP_VERSION_CHECK": "1"})
    return folder / "site"


def run(plugin: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Python with the folder on its path."""
    paths = os.pathsep.join((str(plugin), str(ROOT)))
    environment = {**os.environ, "PYTHONPATH": paths, "COLUMNS": "200"}
    return subprocess.run([sys.executable, *arguments], env=environment, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    ("module", "function", "words"),
    [
        ("ggavatar.cli.commands", "train", ("painted_mesh Painted", "painted_mesh_without_dssim", "ggavatar_plus")),
        ("ggavatar.cli.commands", "export", ("spz, glb, xyz",)),
        ("preprocess.cli.commands", "prep", ("head_angles",)),
    ],
)  # fmt: skip
def test_help_names_what_it_brings(plugin: Path, module: str, function: str, words: tuple[str, ...]) -> None:
    code = f"import sys; sys.argv[1:] = ['--help']; from {module} import {function} as main; sys.exit(main())"
    shown = run(plugin, "-c", code)
    text = " ".join(shown.stdout.split())
    assert shown.returncode == 0 and all(word in text for word in words), shown.stdout + shown.stderr


@pytest.mark.slow
def test_it_trains_is_measured_and_exported(plugin: Path, toy_capture: Capture, tmp_path: Path) -> None:
    done = run(plugin, "-c", COMMANDS, str(toy_capture.folder), str(tmp_path / "run"))
    assert done.returncode == 0, done.stdout + done.stderr
    provenance = json.loads((tmp_path / "run" / "provenance.json").read_text())
    assert provenance["method_package"] == {"name": "ggavatar-example", "version": "0.1.0"}
    (results,) = (tmp_path / "run" / "eval").rglob("metrics.json")
    stored = json.loads(results.read_text())
    assert 0 < stored["summary"]["edge_error"]["mean"] < 1 and stored["provenance"]["versions"]["ggavatar-example"]
    table = (tmp_path / "run" / "table.md").read_text()
    assert "Edges ↓" in table and "one Gaussian per triangle" in table
    points = np.loadtxt(tmp_path / "run" / "exports" / "neutral.xyz")
    assert points.shape[1] == 6 and len(points) > 100


@pytest.mark.slow
def test_its_own_tests_pass(plugin: Path) -> None:
    tests = ROOT / "examples" / "plugin"
    done = run(plugin, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", str(tests), str(tests / "tests"))
    assert done.returncode == 0, done.stdout + done.stderr
