"""The cache of compiled kernels follows every source, and damaged or foreign files in it are compiled anew.

Also covers `ggavatar/io/cache_folder.py` and `ggavatar/jit/private_folder.py`.
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
from ggavatar.jit.private_folder import is_own_file, is_private

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


@pytest.mark.slow
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


def _plant(kind: str, folder: Path) -> None:
    """Make `folder` one that another user could have filled."""
    if kind == "file":
        folder.write_text("")
    elif kind == "link":
        (folder.parent / "elsewhere").mkdir(mode=0o700)
        folder.symlink_to(folder.parent / "elsewhere")
    elif kind == "folder above is a link to a shared one":
        (folder.parent.parent / "shared").mkdir()
        (folder.parent.parent / "shared").chmod(0o777)
        folder.parent.rmdir()
        folder.parent.symlink_to(folder.parent.parent / "shared")
        folder.mkdir(mode=0o700)
    else:
        folder.mkdir(mode=0o700)
        mode = {"group": 0o770, "others": 0o777, "sticky": 0o1777, "folder above": 0o777}[kind]
        (folder.parent if kind == "folder above" else folder).chmod(mode)


@pytest.mark.skipif(os.name != "posix", reason="owners and modes of POSIX")
@pytest.mark.parametrize("variable", ["GGAVATAR_CACHE", "NUMBA_CACHE_DIR"])
@pytest.mark.parametrize(
    "kind", ["file", "link", "group", "others", "sticky", "folder above", "folder above is a link to a shared one"]
)
def test_a_folder_that_others_could_have_written_is_not_trusted(
    kind: str, variable: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv(variable, str(tmp_path if variable == "GGAVATAR_CACHE" else tmp_path / "chosen"))
    folder = tmp_path / ("ggavatar/compiled" if variable == "GGAVATAR_CACHE" else "chosen/ggavatar")
    folder.parent.mkdir()
    _plant(kind, folder)
    used = kernel_cache.kernel_folder()
    assert tmp_path not in used.parents and is_private(used)
    assert str(used) in (said := capsys.readouterr().err) and said.count("\n") == 1
    kernel_cache._remove(used, os.getpid() + 1)
    assert used.is_dir()
    kernel_cache._remove(used, os.getpid())
    assert not used.exists()


@pytest.mark.skipif(os.name != "posix", reason="owners of POSIX")
def test_a_folder_of_another_user_is_not_trusted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder is ours; who we are is changed, since only root could change whose it is."""
    folder = tmp_path / "ours"
    folder.mkdir(mode=0o700)
    (folder / "file").write_text("")
    assert is_private(folder) and is_own_file(str(folder / "file"))
    monkeypatch.setattr(os, "geteuid", lambda: 12345)
    assert not is_private(folder) and not is_own_file(str(folder / "file"))


@pytest.mark.skipif(os.name != "posix", reason="groups of POSIX")
@pytest.mark.parametrize(("members", "trusted"), [([], True), (["somebody"], False)])
def test_a_group_of_the_user_alone_may_write_above(
    members: list[str], trusted: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on systems that give every user a group and let it write (umask 002)."""
    import grp
    import pwd

    user = pwd.getpwuid(os.geteuid()).pw_name
    group = grp.struct_group((user, "x", 0, members))
    monkeypatch.setattr(grp, "getgrgid", lambda _: group)
    folder = tmp_path / "above" / "cache"
    folder.mkdir(parents=True, mode=0o700)
    folder.parent.chmod(0o775)
    assert is_private(folder) is trusted


def test_folders_of_the_cache_are_closed_to_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("GGAVATAR_CACHE", str(tmp_path / "new"))
    before = os.umask(0)
    try:
        folder = kernel_cache.kernel_folder()
    finally:
        os.umask(before)
    assert folder == tmp_path / "new" / "ggavatar" / "compiled"
    if os.name == "posix":
        assert all(stat.S_IMODE(part.stat().st_mode) == 0o700 for part in (folder, folder.parent, tmp_path / "new"))


def test_files_planted_in_a_shared_folder_do_not_run(compiled_program: tuple[Path, Path], tmp_path: Path) -> None:
    """The kernels of another user's cache, with a sound digest, in the place that $NUMBA_CACHE_DIR names."""
    script, intact = compiled_program
    shared = tmp_path / "shared"
    shutil.copytree(intact / "ggavatar" / "compiled", shared / "ggavatar")
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(shared), "PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path)}
    for mode, hits in ((0o700, "42 1"), (0o777, "42 0")):
        shared.chmod(mode)
        ran = subprocess.run([sys.executable, str(script)], env=environment, capture_output=True, text=True, check=True)
        assert ran.stdout.strip() == hits, mode
        assert ("for this process only" in ran.stderr) == (mode == 0o777)


def test_a_temporary_cache_ends_with_its_process(tmp_path: Path) -> None:
    (tmp_path / "ggavatar").mkdir()
    (tmp_path / "ggavatar" / "compiled").write_text("")
    environment = {**os.environ, "GGAVATAR_CACHE": str(tmp_path), "PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path)}
    environment.pop("NUMBA_CACHE_DIR", None)
    code = "import os; from ggavatar.jit.kernels import CACHE; assert CACHE.is_dir(); print(CACHE)"
    ran = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert str(tmp_path) in ran.stdout and not Path(ran.stdout.strip()).exists()
