"""The structure of the packages: layers, file and function sizes, what must never appear, what starts without torch.

Also covers `ggavatar/cli/version.py`.
"""

from __future__ import annotations

import ast
import importlib
import importlib.metadata
import os
import re
import shutil
import statistics
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("ggavatar", "preprocess", "evaluate")
SOURCES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
NAMES = [str(path.relative_to(ROOT)) for path in SOURCES]
ROOMS = sorted({path.parent for path in SOURCES} - {ROOT / package for package in PACKAGES})
UNPICKLER = "ggavatar/io/restricted_unpickler.py"


def lint_imports(root: Path) -> subprocess.CompletedProcess[str]:
    """Check the contracts in pyproject.toml on the packages below `root`."""
    command = [sys.executable, "-c", "from importlinter.cli import lint_imports_command as run; run()", "--no-cache"]
    environment = {**os.environ, "PYTHONPATH": str(root)}
    return subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def copied_tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The packages and the contracts, to plant faults in."""
    root = tmp_path_factory.mktemp("tree")
    for package in PACKAGES:
        shutil.copytree(ROOT / package, root / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", root)
    return root


def test_layers_hold(copied_tree: Path) -> None:
    checked = lint_imports(copied_tree)
    assert checked.returncode == 0, checked.stdout


@pytest.mark.parametrize(
    ("file", "planted", "contract"),
    [
        ("ggavatar/io/npz.py", "from ggavatar.training.plan import preset", "Rooms of ggavatar"),
        ("ggavatar/head/model.py", "from ggavatar.gaussians import binding", "Rooms of ggavatar"),
        ("ggavatar/data/capture.py", "import preprocess.options", "preprocess -> ggavatar <- evaluate"),
        (
            "evaluate/metrics/ssim.py",
            "from preprocess.options import PrepOptions",
            "preprocess -> ggavatar <- evaluate",
        ),
        ("evaluate/metrics/ssim.py", "from evaluate.scoring.score import score", "Rooms of evaluate"),
        ("preprocess/video/crop.py", "from preprocess.pipeline import stage", "Rooms of preprocess"),
        ("ggavatar/methods/flash_avatar.py", "from ggavatar.methods import ggavatar", "Methods know no other method"),
        ("ggavatar/jit/simd.py", "from ggavatar.jit import memory", "circle"),
    ],
)
def test_a_planted_arrow_breaks_its_contract(copied_tree: Path, file: str, planted: str, contract: str) -> None:
    path = copied_tree / file
    text = path.read_text()
    path.write_text(f"{text}\n{planted}\n")
    checked = lint_imports(copied_tree)
    path.write_text(text)
    broken = [line for line in checked.stdout.splitlines() if "BROKEN" in line]
    assert checked.returncode == 1 and any(contract in line for line in broken), checked.stdout


def test_a_room_without_a_place_is_noticed(copied_tree: Path) -> None:
    room = copied_tree / "ggavatar" / "attic"
    room.mkdir()
    (room / "__init__.py").write_text("")
    checked = lint_imports(copied_tree)
    shutil.rmtree(room)
    assert checked.returncode == 1 and "attic" in checked.stdout


@pytest.mark.parametrize("folder", ROOMS, ids=lambda folder: str(folder.relative_to(ROOT)))
def test_every_room_is_on_the_map(folder: Path) -> None:
    """docs/architecture.md names it, in the part on its package."""
    page = (ROOT / "docs" / "architecture.md").read_text()
    package, *_ = folder.relative_to(ROOT).parts
    part = page.partition(f"\n## {package}:")[2].partition("\n## ")[0]
    assert f"`{folder.name}/`" in part


def test_rooms_can_be_overlooked() -> None:
    """No folder holds more than 25 files, half of them at most 9, and package roots next to none."""
    sizes = {folder: len(list(folder.glob("*.py"))) for folder in {path.parent for path in SOURCES}}
    assert max(sizes.values()) <= 25
    assert statistics.median(sizes.values()) <= 9
    assert all(sizes[ROOT / package] <= 3 for package in PACKAGES)


def test_every_module_has_its_tests() -> None:
    """A test file of its name in the mirrored folder, or a test file that imports it or names its path."""
    tests = {path.relative_to(ROOT): path.read_text() for path in (ROOT / "tests").rglob("*.py")}
    missing = []
    for path in SOURCES:
        room, stem = path.relative_to(ROOT).parent, path.stem
        dotted = ".".join((*room.parts, stem))
        mirrored = Path("tests", room, f"test_{stem}.py")
        imported = re.compile(
            rf"\b{re.escape(dotted)}\b|from {re.escape('.'.join(room.parts))} import [^\n]*\b{stem}\b"
        )
        named = (str(path.relative_to(ROOT)) in text or imported.search(text) for text in tests.values())
        if stem != "__init__" and mirrored not in tests and not any(named):
            missing.append(dotted)
    assert not missing


def test_test_files_mirror_the_tree() -> None:
    """A folder of tests below a package is a room of that package."""
    folders = {path.parent.relative_to(ROOT / "tests") for path in (ROOT / "tests").rglob("test_*.py")}
    strangers = [
        folder for folder in folders if folder.parts and folder.parts[0] in PACKAGES and not (ROOT / folder).is_dir()
    ]
    assert not strangers


@pytest.mark.parametrize("package", PACKAGES)
def test_package_init_is_a_docstring(package: str) -> None:
    """The root of ggavatar also has `__version__`, lazily."""
    for path in set((ROOT / package).rglob("__init__.py")) - {ROOT / "ggavatar" / "__init__.py"}:
        body = ast.parse(path.read_text()).body
        assert len(body) == 1 and isinstance(body[0], ast.Expr), path


@pytest.mark.parametrize("path", SOURCES, ids=NAMES)
def test_sizes(path: Path) -> None:
    text = path.read_text()
    assert len(text.splitlines()) <= 450
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            assert (node.end_lineno or 0) - node.lineno + 1 <= 80, f"{path}:{node.lineno} {node.name}"


@pytest.mark.parametrize("path", SOURCES, ids=NAMES)
def test_nothing_that_runs_code_or_wires_a_device(path: Path) -> None:
    name = str(path.relative_to(ROOT))
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            assert called not in {"eval", "exec", "os.system"} and not called.endswith(".cuda"), f"{name}:{node.lineno}"
            assert "pickle.load" not in called and "yaml" not in called, f"{name}:{node.lineno}"
            for keyword in node.keywords:
                constant = keyword.value.value if isinstance(keyword.value, ast.Constant) else None
                assert (keyword.arg, constant) not in {
                    ("shell", True),
                    ("allow_pickle", True),
                    ("weights_only", False),
                }, f"{name}:{node.lineno}"
        if isinstance(node, ast.ExceptHandler):
            assert node.type is not None, f"{name}:{node.lineno} bare except"
        if isinstance(node, (ast.Import, ast.ImportFrom)) and name != UNPICKLER:
            names = {alias.name for alias in node.names} | {getattr(node, "module", None)}
            assert not names & {"pickle", "dill", "joblib", "cloudpickle"}, f"{name}:{node.lineno}"


@pytest.mark.parametrize("path", SOURCES, ids=NAMES)
def test_room_names_say_what_is_inside(path: Path) -> None:
    assert not {"utils", "util", "misc", "helpers", "helper", "manager", "common"} & set(
        path.relative_to(ROOT).with_suffix("").parts
    )


@pytest.mark.parametrize(
    "module",
    [
        "preprocess.cli.prep",
        "preprocess.cli.doctor",
        "preprocess.cli.demo",
        "evaluate.cli.evaluate",
        "ggavatar.data.capture",
    ],
)
def test_starts_without_torch(module: str) -> None:
    code = f"import sys, {module}; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0


@pytest.mark.parametrize("module", ["ggavatar.training.trainer", "ggavatar.cli.train"])
def test_training_core_needs_few_packages(module: str) -> None:
    heavy = {"cv2", "skimage", "scipy", "kornia", "trimesh", "pandas", "matplotlib", "av", "plyfile"}
    code = f"import sys, {module}; print(sorted({heavy!r} & set(sys.modules)))"
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True, text=True)
    assert ran.stdout.strip() == "[]"


def test_version() -> None:
    import ggavatar

    assert ggavatar.__version__ == importlib.metadata.version("ggavatar")
    with pytest.raises(AttributeError, match="no attribute 'spam'"):
        _ = ggavatar.spam


def test_our_evaluate_is_the_one_imported() -> None:
    module = importlib.import_module("evaluate")
    assert module.__file__ == str(ROOT / "evaluate" / "__init__.py")
    assert "evaluate" not in {name.lower() for name in importlib.metadata.packages_distributions().get("evaluate", [])}


@pytest.mark.parametrize(
    "command",
    [
        f"ggavatar-{name}"
        for name in ("demo", "prep", "doctor", "train", "sweep", "export", "models", "render", "view", "eval")
    ],
)
def test_commands_help_and_refuse_unknown_flags(command: str) -> None:
    entry = {point.name: point for point in importlib.metadata.entry_points(group="console_scripts")}[command]
    start = f"import sys; sys.argv[0] = {command!r}; from {entry.module} import {entry.attr} as main; sys.exit(main())"
    shown = subprocess.run([sys.executable, "-c", start, "--help"], capture_output=True, text=True, check=False)
    assert shown.returncode == 0 and command in shown.stdout
    version = subprocess.run([sys.executable, "-c", start, "--version"], capture_output=True, text=True, check=False)
    assert version.returncode == 0 and version.stdout == f"{command} {importlib.metadata.version('ggavatar')}\n"
    refused = subprocess.run(
        [sys.executable, "-c", start, "--no-such-flag"], capture_output=True, text=True, check=False
    )
    assert refused.returncode == 2 and "Traceback" not in refused.stderr and refused.stderr.strip()
