"""The shape of the house: import arrows, file and function sizes, what must never appear, what starts without torch."""

from __future__ import annotations

import ast
import importlib
import importlib.metadata
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("ggavatar", "preprocess", "evaluate")
SOURCES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
NAMES = [str(path.relative_to(ROOT)) for path in SOURCES]
ALLOWED = {"ggavatar": {"ggavatar"}, "preprocess": {"ggavatar", "preprocess"}, "evaluate": {"ggavatar", "evaluate"}}
RANK = {"core": 0, "errors": 0, "process": 0, "acceleration": 0, "compiled": 0, "geometry": 1, "triangle_kernel": 1}
RANK |= {"methods": 3, "trainer": 4, "cli": 5, "sweep": 5, "session": 5}
UNPICKLER = "ggavatar/io/restricted_pickle.py"


def imported_modules(path: Path) -> set[str]:
    """Absolute names of all modules a file imports, wherever in the file."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found.add(node.module or "")
    return found


@pytest.mark.parametrize("path", SOURCES, ids=NAMES)
def test_arrows_between_packages(path: Path) -> None:
    package = path.relative_to(ROOT).parts[0]
    ours = {name.split(".")[0] for name in imported_modules(path)} & set(PACKAGES)
    assert ours <= ALLOWED[package]


def test_arrows_inside_ggavatar() -> None:
    wrong = []
    for path in (ROOT / "ggavatar").rglob("*.py"):
        own = RANK.get(path.relative_to(ROOT / "ggavatar").parts[0].removesuffix(".py"), 2)
        for name in imported_modules(path):
            parts = name.split(".")
            if parts[0] == "ggavatar" and len(parts) > 1 and RANK.get(parts[1], 2) > own:
                wrong.append(f"{path.relative_to(ROOT)} imports {name}")
    assert not wrong


@pytest.mark.parametrize("package", PACKAGES)
def test_package_init_is_a_docstring(package: str) -> None:
    for path in (ROOT / package).rglob("__init__.py"):
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


def test_our_evaluate_is_the_one_imported() -> None:
    module = importlib.import_module("evaluate")
    assert module.__file__ == str(ROOT / "evaluate" / "__init__.py")
    assert "evaluate" not in {name.lower() for name in importlib.metadata.packages_distributions().get("evaluate", [])}


@pytest.mark.parametrize(
    "command",
    [f"ggavatar-{name}" for name in ("demo", "prep", "doctor", "train", "sweep", "export", "render", "eval")],
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
