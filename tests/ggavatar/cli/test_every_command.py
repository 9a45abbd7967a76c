"""Every command in a poor environment: streams closed or broken, no home, C locale, few files; exit code, no traceback.

The commands are those of pyproject.toml, each in processes of its own. What they do when they work is in their tests.
"""

from __future__ import annotations

import importlib.metadata
import os
import subprocess
import sys
from pathlib import Path

import pytest

POINTS = {
    point.name: point.value
    for point in importlib.metadata.entry_points(group="console_scripts")
    if point.name.startswith("ggavatar-")
}
CONTEXTS = {
    "COMMAND --help >&- 2>&- <&-; echo $?": "0",
    "COMMAND --help | true; echo ${PIPESTATUS[0]}": "0",
    "COMMAND --no-such-flag 2>&- >&-; echo $?": "2",
    "COMMAND --no-such-flag 2>&1 | true; echo ${PIPESTATUS[0]}": "2",
    "env -u HOME -u XDG_CACHE_HOME LC_ALL=C PYTHONIOENCODING=ascii COMMAND --help <&- >/dev/null; echo $?": "0",
    "(ulimit -n 24; HOME=/proc/none COMMAND --help >/dev/null; echo $?)": "0",
}
MISTAKES = {
    "ggavatar-prep": "absent.mp4 -o out",
    "ggavatar-train": "absent -o out",
    "ggavatar-sweep": "absent -o out",
    "ggavatar-export": "absent",
    "ggavatar-render": "absent",
    "ggavatar-eval": "absent",
    "ggavatar-view": "absent",
    "ggavatar-doctor": "absent",
    "ggavatar-models": "--fetch absent",
    "ggavatar-demo": "-o out --frames 0",
}


def shell(script: str, name: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a line of bash in which COMMAND is a command of ours."""
    module, _, function = POINTS[name].partition(":")
    (folder / name).write_text(f"import sys\nfrom {module} import {function}\nsys.exit({function}())\n")
    line = script.replace("COMMAND", f'"{sys.executable}" "{folder / name}"')
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.run(
        ["bash", "-c", line], cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=240
    )


def test_every_command_is_here() -> None:
    assert set(POINTS) == set(MISTAKES)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(MISTAKES))
def test_poor_environments(name: str, tmp_path: Path) -> None:
    for script, code in CONTEXTS.items():
        ended = shell(script, name, tmp_path)
        assert ended.stdout.strip() == code, (script, ended.stderr[-2000:])
        assert "Traceback" not in ended.stderr and "Exception" not in ended.stderr, script
    assert [path.name for path in tmp_path.iterdir()] == [name], "nothing is written, not even a folder ~"


@pytest.mark.parametrize("name", sorted(MISTAKES))
def test_a_mistake_is_code_2_and_leaves_nothing(name: str, tmp_path: Path) -> None:
    """Without a home, with a narrow encoding and a closed stdin; the corrected command finds nothing in its way."""
    poor = "env -u HOME -u XDG_CACHE_HOME LC_ALL=C PYTHONIOENCODING=ascii"
    ended = shell(f"{poor} COMMAND {MISTAKES[name]} <&-; echo $?", name, tmp_path)
    assert ended.stdout == "2\n" and ended.stderr.startswith("error: "), ended.stderr[-2000:]
    assert ended.stderr.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == [name]
