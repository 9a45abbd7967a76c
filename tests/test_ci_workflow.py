"""The workflow of docs/ci.md: its steps run as a script, in a folder with nothing but a baseline.

Reference: exit codes of gates (0 and 3). The actions themselves (checkout, cache, artifact) run on GitHub only; of them
the form is checked.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

yaml = pytest.importorskip("yaml", reason="needs PyYAML, which comes with the extra docs")

ROOT = Path(__file__).parents[1]
SMALLER = {
    "--frames 100": "--frames 40",
    "--size 128": "--size 64",
    "--steps 600": "--steps 20",
    "psnr=20": "psnr=3",
    " --table": " --table --no-lpips",
}
"""What makes minutes of the page seconds here."""


def page() -> str:
    return (ROOT / "docs" / "ci.md").read_text(encoding="utf-8")


def steps() -> list[dict[str, Any]]:
    """The steps of the workflow on the page."""
    (text,) = re.findall(r"```yaml\n(.*?)```", page(), re.DOTALL)
    return yaml.safe_load(text)["jobs"]["avatar"]["steps"]


def commands(name: str) -> str:
    """What a step of the page runs."""
    (found,) = (step["run"] for step in steps() if step.get("name") == name)
    return found


def run(script: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a step as GitHub does, in a folder with the installed commands on the path, with smaller numbers."""
    for large, small in SMALLER.items():
        script = script.replace(large, small)
    summary = {"GITHUB_STEP_SUMMARY": str(folder / "summary.md"), "GGAVATAR_OFFLINE": "1"}
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    shell = ["bash", "-e", "-o", "pipefail", "-c", script]
    environment = {**os.environ, **summary, "PATH": path, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    return subprocess.run(shell, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def test_steps_are_named_or_pinned_actions_and_the_caches_are_in_time() -> None:
    order = [step.get("name") or step["uses"] for step in steps()]
    assert all(re.fullmatch(r"actions/[a-z-]+@v\d+", step["uses"]) for step in steps() if "uses" in step)
    assert [name for name in order if "/" not in name] == ["Install", "Models", "Capture", "Train", "Gate"]
    caches = [place for place, name in enumerate(order) if name.startswith("actions/cache")]
    assert caches[0] < order.index("Models") < caches[1] < order.index("Capture")
    paths = [step["with"]["path"] for step in steps() if step.get("uses", "").startswith("actions/cache")]
    assert paths == ["~/.cache/ggavatar", "capture"]


def test_commands_of_the_page_exist() -> None:
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]
    named = set(re.findall(r"\bggavatar-[a-z]+\b(?= [-a-z])", page()))
    assert named and named <= scripts.keys()


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.skipif(sys.platform == "win32", reason="the workflow is one for bash")
def test_the_workflow_passes_and_fails_as_it_should(tmp_path: Path) -> None:
    for name in ("Capture", "Train"):  # Install and Models need the network
        ended = run(commands(name), tmp_path)
        assert ended.returncode == 0, f"{name}: {ended.stdout[-1000:]}{ended.stderr[-2000:]}"
    (baseline,) = re.findall(r"```sh\n(ggavatar-eval .*?)```", page(), re.DOTALL)
    made = run(baseline.replace("ggavatar-eval run", "ggavatar-eval run --no-lpips"), tmp_path)
    assert made.returncode == 0, made.stdout[-1000:] + made.stderr[-2000:]
    passed = run(commands("Gate"), tmp_path)
    assert passed.returncode == 0, passed.stdout[-1000:] + passed.stderr[-2000:]
    assert (tmp_path / "junit.xml").is_file() and (tmp_path / "run" / "table.html").is_file()
    assert "psnr" in (tmp_path / "summary.md").read_text(encoding="utf-8").lower()
    better = json.loads((tmp_path / "baseline.json").read_text(encoding="utf-8"))
    (tmp_path / "baseline.json").write_text(json.dumps(raised(better)), encoding="utf-8")
    failed = run(commands("Gate"), tmp_path)
    assert failed.returncode == 3, failed.stdout[-1000:] + failed.stderr[-2000:]


def raised(value: Any, key: str = "") -> Any:
    """A baseline whose PSNR is 5 dB higher."""
    if isinstance(value, dict):
        return {name: raised(part, name if name.startswith("psnr") else key) for name, part in value.items()}
    if isinstance(value, list):
        return [raised(part, key) for part in value]
    return value + 5.0 if key and isinstance(value, float) else value
