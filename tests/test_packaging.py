"""The wheel and the sdist hold every file, install into a fresh environment, and work outside the repository.

They are built of the files that Dockerfile copies, so that a container gets the same wheel. Reference: the files that
git knows. Also covers `setup.py`. What is installed is the wheel alone: its dependencies are those of this environment.
"""

from __future__ import annotations

import email
import importlib.metadata
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import venv
import zipfile
from email.message import Message
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("ggavatar", "preprocess", "evaluate")
CONTAINERS = ("Dockerfile", "Dockerfile.cuda")
FIRST_SETUPTOOLS = 77
"""The version that pyproject.toml asks for."""
TINY = ("--frames", "24", "--size", "64")
RELATIVE = re.compile(r"\]\((?!https?:|mailto:|#)[^)]*\)")


def known_files(*paths: str) -> set[str]:
    """Files of the repository below some paths, new ones included."""
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z", "--", *paths]
    answer = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, check=False)
    if answer.returncode or not answer.stdout:
        pytest.skip("needs a clone of the repository")
    return {path for path in answer.stdout.split("\0") if path and (ROOT / path).is_file()}


def copied_by(container: str) -> list[str]:
    """What the first stage of a Dockerfile copies from the repository."""
    stage = (ROOT / container).read_text(encoding="utf-8").split("\nFROM ")[1]
    return [path for line in re.findall(r"^COPY (.*) \S+$", stage, re.MULTILINE) for path in line.split()]


def build(kind: str, source: Path, target: Path) -> Path:
    """Build a wheel or an sdist of a folder by the declared build backend; returns the file."""
    code = f"import sys; from setuptools import build_meta; print(build_meta.build_{kind}(sys.argv[1]))"
    target.mkdir(exist_ok=True)
    ended = subprocess.run(
        [sys.executable, "-c", code, str(target)], cwd=source, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr[-2000:]
    return target / ended.stdout.splitlines()[-1]


@pytest.fixture(scope="session")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files that Dockerfile copies, without anything that a build has left in the repository."""
    if int(importlib.metadata.version("setuptools").split(".")[0]) < FIRST_SETUPTOOLS:
        pytest.skip(f"needs setuptools {FIRST_SETUPTOOLS} or newer")
    folder = tmp_path_factory.mktemp("source")
    for path in known_files(*copied_by("Dockerfile")):
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / path, folder / path)
    return folder


@pytest.fixture(scope="session")
def wheel(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build("wheel", source, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="session")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the programs of a fresh environment with the wheel in it, and with the dependencies of this one."""
    folder = tmp_path_factory.mktemp("fresh") / "environment"
    venv.create(folder, symlinks=os.name != "nt")
    programs = folder / ("Scripts" if os.name == "nt" else "bin")
    python = programs / Path(sys.executable).name
    install = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet", "--no-deps", "--no-index"]
    subprocess.run([*install, str(wheel)], check=True)
    site = subprocess.run(
        [str(python), "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.strip()
    Path(site, "dependencies.pth").write_text(sysconfig.get_path("purelib"), encoding="utf-8")
    return programs


def run(programs: Path, folder: Path, name: str, *arguments: str) -> str:
    """What an installed program prints, run in a folder outside the repository and without its path."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    ended = subprocess.run(
        [str(programs / name), *arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stdout[-2000:] + ended.stderr[-2000:]
    return ended.stdout


def files_in(wheel: Path) -> set[str]:
    """Files of a wheel but its metadata."""
    return {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}


def metadata(wheel: Path) -> Message:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return email.message_from_bytes(archive.read(name))


def setup_module() -> ModuleType:
    specification = importlib.util.spec_from_file_location("setup_of_the_project", ROOT / "setup.py")
    assert specification and specification.loader
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def test_the_wheel_holds_every_file_of_the_packages(wheel: Path) -> None:
    expected = known_files(*PACKAGES)
    assert {"evaluate/figures/report.html", "ggavatar/formats/web/page/worker.mjs"} <= expected
    assert {f"{package}/py.typed" for package in PACKAGES} <= expected
    assert files_in(wheel) == expected


def test_a_wheel_made_of_the_sdist_is_the_same(source: Path, wheel: Path, tmp_path: Path) -> None:
    sdist = build("sdist", source, tmp_path)
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path, filter="data")
    (unpacked,) = (path for path in tmp_path.iterdir() if path.is_dir())
    assert (unpacked / "LICENSE").is_file()
    again = build("wheel", unpacked, tmp_path / "wheel")
    assert files_in(again) == files_in(wheel)
    assert str(metadata(again)) == str(metadata(wheel))


def test_the_metadata_are_those_of_the_project(wheel: Path) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    stated = metadata(wheel)
    assert set(stated.get_all("Provides-Extra")) == {"view", "ray", "cuda", "docs", "dev"}
    assert (stated["Name"], stated["Version"]) == ("ggavatar", project["version"])
    assert stated["License-Expression"] == "Apache-2.0" and stated["License-File"] == "LICENSE"
    assert stated["Description-Content-Type"] == "text/markdown"


def test_the_description_needs_no_file_of_the_repository(wheel: Path) -> None:
    """A package index shows README.md alone: a relative address there leads nowhere."""
    text = metadata(wheel).get_payload()
    assert isinstance(text, str) and text.startswith("# GGAvatar") and "make demo" in text and "33.47" in text
    assert not RELATIVE.search(text)


def test_addresses_are_absolute_where_the_repository_has_one() -> None:
    readme = "![P](docs/images/a.jpg)\n\n[b](docs/b.md#c) [d](https://example.org/d) [e](#e)\n"
    shown = setup_module().description(readme, "https://example.org/us/it/")
    assert shown == (
        "![P](https://example.org/us/it/raw/HEAD/docs/images/a.jpg)\n\n"
        "[b](https://example.org/us/it/blob/HEAD/docs/b.md#c) [d](https://example.org/d) [e](#e)\n"
    )
    assert setup_module().description(readme, None) == "\n\nb [d](https://example.org/d) [e](#e)\n"


def test_an_installed_command_starts_outside_the_repository(installed: Path, tmp_path: Path) -> None:
    found = run(installed, tmp_path, "python", "-c", "import ggavatar; print(ggavatar.__file__, ggavatar.__version__)")
    assert Path(found.split()[0]).is_relative_to(installed.parent), found
    assert "usage: ggavatar-doctor" in run(installed, tmp_path, "ggavatar-doctor", "--help")


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_installed_commands_make_an_avatar(installed: Path, tmp_path: Path) -> None:
    """Every command's help; then person, capture, five steps, report with its templates, and the web page."""
    commands = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]
    for name in commands:
        assert f"usage: {name}" in run(installed, tmp_path, name, "--help")
    run(installed, tmp_path, "ggavatar-demo", "--id", "1", *TINY, "-o", "subject")
    given = ("--tracking", "subject/tracking", "--masks", "subject/masks", "--head-model", "subject/head.npz")
    run(installed, tmp_path, "ggavatar-prep", "subject/video.mp4", *given, "--size", "64", "-o", "capture")
    run(installed, tmp_path, "ggavatar-train", "capture", "ggavatar", "--steps", "5", "--offline", "-o", "run")
    run(installed, tmp_path, "ggavatar-eval", "run", "--table", "--no-lpips", "--with-paper", "--offline")
    run(installed, tmp_path, "ggavatar-export", "run", "-o", "avatar.html")
    (report,) = (tmp_path / "run" / "eval").rglob("report.html")
    assert report.stat().st_size > 10_000
    assert "WebGL2" in (tmp_path / "avatar.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("container", CONTAINERS)
def test_containers_copy_what_the_build_needs(container: str) -> None:
    """The wheel is built of what Dockerfile copies (see above); .dockerignore lets it in, and both copy the same."""
    allowed = {line[1:] for line in (ROOT / ".dockerignore").read_text(encoding="utf-8").split() if line[0] == "!"}
    assert copied_by(container) == copied_by("Dockerfile")
    assert {*copied_by(container), "constraints.txt"} == allowed
    assert all((ROOT / path).exists() for path in allowed)


def test_names_of_files_are_possible_on_every_system() -> None:
    """Windows and macOS tell no case apart; Windows knows devices, and characters that no name may have."""
    paths = known_files(".")
    assert len({path.lower() for path in paths}) == len(paths)
    forbidden = re.compile(r'[<>:"\\|?*\x00-\x1f]|[ .](?:/|$)|(?:^|/)(?:con|prn|aux|nul|com\d|lpt\d)(?:\.|/|$)', re.I)
    assert forbidden.search("a/aux.py") and forbidden.search("a:b")
    assert not [path for path in paths if forbidden.search(path)]
