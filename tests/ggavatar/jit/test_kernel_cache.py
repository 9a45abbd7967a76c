"""The cache of compiled kernels follows every source, and damaged or foreign files in it are compiled anew.

Also covers `ggavatar/io/cache_folder.py`.
"""

from __future__ import annotations

import importlib
import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from numba.core.dispatcher import Dispatcher

from ggavatar.jit import kernel_cache

ROOT = Path(__file__).parents[3]


def _kernel_modules() -> list[str]:
    """Modules that define compiled functions: those that import `kernel` or `inlined`."""
    names = []
    for package in ("ggavatar", "preprocess"):
        for path in sorted((ROOT / package).rglob("*.py")):
            text = path.read_text()
            if "import inlined" in text or "import kernel" in text or ", kernel" in text:
                name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
                if any(isinstance(value, Dispatcher) for value in vars(importlib.import_module(name)).values()):
                    names.append(name)
    return names


MODULES = _kernel_modules()


def _used_modules(function: Any, found: set[str]) -> set[str]:
    """Modules of all compiled functions that `function` reaches: what Numba really inlines, read from the bytecode."""
    found.add(function.__module__)
    for name in function.__code__.co_names:
        value = function.__globals__.get(name)
        if isinstance(value, Dispatcher) and value.py_func is not function:
            _used_modules(value.py_func, found)
        elif isinstance(value, ModuleType) and value.__name__.split(".")[0] in ("ggavatar", "preprocess"):
            found.add(value.__name__)
    return found


@pytest.mark.parametrize("name", MODULES)
def test_the_sources_of_a_kernel_hold_all_that_it_inlines(name: str) -> None:
    module = importlib.import_module(name)
    used: set[str] = set()
    for value in vars(module).values():
        if isinstance(value, Dispatcher) and value.py_func.__module__ == name:
            _used_modules(value.py_func, used)
    sources = kernel_cache.kernel_sources(Path(str(module.__file__)))
    assert {ROOT.joinpath(*used_name.split(".")).with_suffix(".py") for used_name in used} <= set(sources)


def test_an_edit_of_a_file_changes_every_digest_that_uses_it(tmp_path: Path) -> None:
    """Each file that any kernel is made of is edited in turn, in a copy of the packages."""
    for package in ("ggavatar", "preprocess"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    kernels = [tmp_path.joinpath(*name.split(".")).with_suffix(".py") for name in MODULES]
    assert len(kernels) > 15

    def digests() -> dict[Path, str]:
        kernel_cache.source_digest.cache_clear()
        kernel_cache.imported_files.cache_clear()
        return {path: kernel_cache.source_digest(path, tmp_path) for path in kernels}

    before = digests()
    made_of = {path: set(kernel_cache.kernel_sources(path, tmp_path)) for path in kernels}
    for edited in sorted(set.union(*made_of.values())):
        text = edited.read_text()
        edited.write_text(text + "\n# edited\n")
        after = digests()
        assert {path for path in kernels if after[path] != before[path]} == {
            path for path in kernels if edited in made_of[path]
        }, edited
        edited.write_text(text)
    assert digests() == before


PROGRAM = """
from ggavatar.jit.kernels import kernel

@kernel
def double(x):
    return 2 * x

print(double(21), sum(double.stats.cache_hits.values()))
"""


def _run(script: Path, cache: Path) -> str:
    environment = {**os.environ, "GGAVATAR_CACHE": str(cache), "PYTHONPATH": str(ROOT)}
    environment.pop("NUMBA_CACHE_DIR", None)
    ran = subprocess.run([sys.executable, str(script)], env=environment, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    return ran.stdout.strip()


@pytest.fixture(scope="module")
def compiled_program(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A program with one kernel, and the cache that its first run left."""
    script, cache = tmp_path_factory.mktemp("program") / "program.py", tmp_path_factory.mktemp("cache")
    script.write_text(PROGRAM)
    assert _run(script, cache) == "42 0"
    assert _run(script, cache) == "42 1"
    return script, cache


@pytest.mark.parametrize("damage", ["empty", "cut", "flipped", "foreign", "pickle"])
@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
def test_damaged_cache_files_are_compiled_anew(
    damage: str, suffix: str, compiled_program: tuple[Path, Path], tmp_path: Path
) -> None:
    script, intact = compiled_program
    cache = tmp_path / "cache"
    shutil.copytree(intact, cache)
    (file,) = (cache / "ggavatar" / "compiled").rglob(f"*{suffix}")
    content = file.read_bytes()
    planted = tmp_path / "planted"
    damaged = {
        "empty": b"",
        "cut": content[: len(content) // 2],
        "flipped": content[:-40] + bytes([content[-40] ^ 1]) + content[-39:],
        "foreign": b"\x80\x04K\x01." + bytes(100),
        "pickle": f"cposix\nsystem\n(S'touch {planted}'\ntR.".encode(),
    }
    file.write_bytes(damaged[damage])
    assert _run(script, cache) == "42 0"
    assert not planted.exists()


def test_the_cache_can_be_placed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GGAVATAR_CACHE", str(tmp_path))
    folder = kernel_cache.kernel_folder()
    assert folder == tmp_path / "ggavatar" / "compiled"
    if os.name == "posix":
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700


@pytest.mark.skipif(os.name != "posix", reason="owners and modes of POSIX")
@pytest.mark.parametrize("kind", ["file", "writable by others", "link"])
def test_a_folder_that_others_could_have_written_is_not_trusted(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "ggavatar" / "compiled"
    folder.parent.mkdir()
    if kind == "file":
        folder.write_text("")
    elif kind == "link":
        (tmp_path / "elsewhere").mkdir(mode=0o700)
        folder.symlink_to(tmp_path / "elsewhere")
    else:
        folder.mkdir()
        folder.chmod(0o777)
    monkeypatch.setenv("GGAVATAR_CACHE", str(tmp_path))
    used = kernel_cache.kernel_folder()
    assert tmp_path not in used.parents and kernel_cache.is_private(used)
    assert str(used) in capsys.readouterr().err
    kernel_cache._remove(used, os.getpid() + 1)
    assert used.is_dir()
    kernel_cache._remove(used, os.getpid())
    assert not used.exists()


def test_a_temporary_cache_ends_with_its_process(tmp_path: Path) -> None:
    (tmp_path / "ggavatar").mkdir()
    (tmp_path / "ggavatar" / "compiled").write_text("")
    environment = {**os.environ, "GGAVATAR_CACHE": str(tmp_path), "PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path)}
    environment.pop("NUMBA_CACHE_DIR", None)
    code = "import os; from ggavatar.jit.kernels import CACHE; assert CACHE.is_dir(); print(CACHE)"
    ran = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert str(tmp_path) in ran.stdout and not Path(ran.stdout.strip()).exists()
