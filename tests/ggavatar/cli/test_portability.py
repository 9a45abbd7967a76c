"""Everything can be imported, and every command started, where POSIX modules and functions do not exist, as on Windows.

The libraries are imported first: what is tested is that our own files need nothing of the kind.
"""

from __future__ import annotations

import importlib.metadata
import os
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import evaluate
import ggavatar
import preprocess
from ggavatar.training.progress import ConsoleListener, peak_memory_mib

POSIX_MODULES = ("fcntl", "grp", "pwd", "resource", "termios", "tty", "pty", "syslog", "posix")
POSIX_FUNCTIONS = {
    "os": (
        *("register_at_fork", "fork", "getuid", "geteuid", "getgid", "getegid", "chown", "fchmod", "sched_getaffinity"),
        *("killpg", "getpgid", "setsid", "mkfifo", "posix_fallocate", "statvfs", "nice", "uname", "getloadavg"),
    ),
    "signal": ("SIGHUP", "SIGKILL", "SIGALRM", "SIGUSR1", "SIGUSR2", "SIGCHLD", "SIGPIPE", "alarm", "setitimer"),
}
LIBRARIES = (
    *("torch", "numba", "cv2", "av", "scipy.spatial", "scipy.optimize", "scipy.signal", "skimage.metrics", "pandas"),
    *("matplotlib.pyplot", "PIL.Image", "rich.console", "rich.progress", "tyro", "jinja2", "plyfile", "zstandard"),
    *("safetensors.torch", "filelock", "platformdirs", "trimesh", "kornia", "multiprocessing.pool", "shutil"),
    *("unearth", "concurrent.futures", "subprocess", "tempfile", "importlib.metadata", "xml.etree.ElementTree"),
)
OPTIONAL = ("gsplat", "ray", "triton")
"""Extras and what only some systems have, which need not be installed."""
EXTRAS = (*OPTIONAL, "viser", "onnxruntime", "mkdocs")
"""Everything that no command may need before it is asked for what it is for."""
WITHOUT_EXTRAS = f"""
class NoExtras:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {EXTRAS!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

for name in [name for name in sys.modules if name.split(".")[0] in {EXTRAS!r}]:
    del sys.modules[name]
sys.meta_path.insert(0, NoExtras())
"""
PREPARE = f"""
import contextlib, ctypes, importlib, io, os, signal, sys, warnings
warnings.simplefilter("ignore")
for name in {LIBRARIES!r}:
    importlib.import_module(name)

class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name in {POSIX_MODULES!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}} on this system", name=name)

for name in {POSIX_MODULES!r}:
    sys.modules.pop(name, None)
sys.meta_path.insert(0, Blocker())
for module, names in {POSIX_FUNCTIONS!r}.items():
    for name in names:
        if hasattr(sys.modules[module], name):
            delattr(sys.modules[module], name)
load = ctypes.CDLL.__init__
def refuse(self, name, *rest, **more):
    if name is None:
        raise TypeError("argument of type 'NoneType' is not iterable")  # what Windows says
    load(self, name, *rest, **more)
ctypes.CDLL.__init__ = refuse
"""


def every_module() -> list[str]:
    """Names of all modules of the three packages."""
    packages = (ggavatar, preprocess, evaluate)
    found = (module.name for one in packages for module in pkgutil.walk_packages(one.__path__, f"{one.__name__}."))
    return sorted(name for name in found if not name.endswith("__main__"))


def without_posix(code: str) -> subprocess.CompletedProcess[str]:
    """Run code in a process without POSIX modules and functions."""
    return subprocess.run([sys.executable, "-c", PREPARE + code], capture_output=True, text=True, check=False)


def test_every_module_can_be_imported() -> None:
    modules = every_module()
    assert len(modules) > 300 and "preprocess.cli.prep" in modules
    code = f"""
failed = []
for name in {modules!r}:
    try:
        importlib.import_module(name)
    except Exception as error:
        if getattr(error, "name", None) not in {OPTIONAL!r}:
            failed.append(f"{{name}}: {{error!r}}")
print("\\n".join(failed))
"""
    ended = without_posix(code)
    assert (ended.returncode, ended.stdout.strip()) == (0, ""), ended.stdout + ended.stderr[-2000:]


def test_every_command_shows_its_help_without_extras() -> None:
    points = [point for point in importlib.metadata.entry_points(group="console_scripts") if point.name[:4] == "ggav"]
    assert len({point.name for point in points}) == 10
    code = WITHOUT_EXTRAS + "".join(
        f"""
sys.argv, shown = [{point.name!r}, "--help"], io.StringIO()
with contextlib.redirect_stdout(shown):
    try:
        getattr(importlib.import_module({point.module!r}), {point.attr!r})()
    except SystemExit as stop:
        assert not stop.code, stop.code
assert "usage: {point.name}" in shown.getvalue(), shown.getvalue()
"""
        for point in points
    )
    ended = without_posix(code)
    assert ended.returncode == 0, ended.stderr[-2000:]


def test_locks_and_atomic_writes_work_without_posix_functions(tmp_path: Path) -> None:
    code = f"""
from pathlib import Path
from ggavatar.io.folder_lock import lock_folder
from ggavatar.io.json_files import read_json, write_json
place = Path({str(tmp_path)!r})
with lock_folder(place):
    write_json(place / "sub" / "a.json", {{"a": 1}})
assert read_json(place / "sub" / "a.json") == {{"a": 1}}
"""
    ended = without_posix(code)
    assert ended.returncode == 0, ended.stderr[-2000:]
    assert [path.name for path in tmp_path.iterdir()] == ["sub"]


def test_a_file_that_another_program_has_open_is_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows refuses to replace it for as long."""
    from ggavatar.io import atomic

    plain, refused = os.replace, []

    def replace(source: str, target: Path) -> None:
        if len(refused) < 2:
            refused.append(source)
            raise PermissionError(13, "Access is denied", source)
        plain(source, target)

    monkeypatch.setattr(atomic, "_IS_WINDOWS", True)
    monkeypatch.setattr(atomic.os, "replace", replace)
    atomic.write_text(tmp_path / "a.txt", "1")
    assert (tmp_path / "a.txt").read_text() == "1" and len(refused) == 2
    monkeypatch.setattr(atomic, "_IS_WINDOWS", False)
    refused.clear()
    with pytest.raises(PermissionError):
        atomic.write_text(tmp_path / "a.txt", "2")
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_memory_that_is_not_known_is_left_out(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "resource", None)
    assert peak_memory_mib() is None
    ConsoleListener(0, 3).step(3, lambda: 0.5, 1234)
    (line,) = capsys.readouterr().out.splitlines()
    assert line.endswith("loss 0.5000 · 1234 Gaussians")
