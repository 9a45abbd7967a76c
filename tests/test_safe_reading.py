"""Nothing that is read can run code, and files are opened in one place: every call that could has a reason here.

The syntax trees of the three packages are searched; what is allowed is listed here by file and call, and an entry that
is no longer needed fails too. That hostile files are refused is tested beside the readers.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("ggavatar", "preprocess", "evaluate")

RUNNERS = {
    *("eval", "exec", "compile", "__import__", "import_module", "system", "popen", "Popen", "startfile"),
    *("run_path", "run_module", "CDLL", "LoadLibrary", "load_module", "exec_module", "entry_points", "load_library"),
}
"""Last names of functions that run what they are given."""

RUNNING_MODULES = {
    "subprocess",
    "pickle",
    "marshal",
    "shelve",
    "dill",
    "cloudpickle",
    "joblib",
    "yaml",
    "runpy",
}
RUNNING_PARTS = ("torch.jit", "torch.hub", "torch.package", "torch.classes", "torch.ops", "webbrowser")

OPENERS = {
    *("open", "read_text", "read_bytes", "load", "loads", "load_file", "safe_open", "ZipFile", "TarFile", "FileIO"),
    *("fromfile", "from_file", "memmap", "loadtxt", "genfromtxt", "imread", "imreadmulti", "VideoCapture"),
    *("FileStorage", "InferenceSession", "create", "open_code", "read_csv"),
}
"""Last names of functions that read files, or what is in them, by a path."""

OWN = {"Capture.open", "registry.load", "self.load", "load", "PAPER.open", "plugin.load", "source.plugin.load"}
"""Our own functions of such names; `PAPER` is a table of the package."""

WRITING = {"w", "wb", "a", "ab", "x", "xb"}

ALLOWED_TO_RUN = {
    ("ggavatar/cli/likely_device.py", "ctypes.CDLL"): "the driver of CUDA, by the system's name",
    ("ggavatar/networks/linear_relu.py", "torch.ops.aten.threshold_backward"): "an operation of torch itself",
    ("ggavatar/cli/process.py", "ctypes.CDLL"): "the C library of this process",
    ("ggavatar/cli/sweep.py", "subprocess.run"): "our own commands, as lists of arguments",
    ("ggavatar/cli/viewer_process.py", "subprocess.Popen"): "our own command, as a list of arguments",
    ("ggavatar/plugins/entry_points.py", "importlib.metadata.entry_points"): "packages that are installed",
    ("ggavatar/formats/performances.py", "entry_points"): "packages that are installed",
    ("ggavatar/__init__.py", "import_module"): "names in our code",
    ("ggavatar/jit/dispatch.py", "importlib.import_module"): "names in our code",
    ("ggavatar/pretrained/pip_settings.py", "subprocess.run"): "pip of this Python, to read its settings",
    ("ggavatar/render/backends.py", "importlib.import_module"): "names in our code",
    ("ggavatar/render/discs/rasterizer.py", "importlib.import_module"): "names in our code",
    ("ggavatar/sweeps/backends.py", "subprocess.Popen"): "our own commands, as lists of arguments",
    ("ggavatar/training/registry.py", "importlib.import_module"): "files of the package; the name is checked first",
    ("preprocess/formats/registry.py", "importlib.import_module"): "files of the package; the name is checked first",
}

ALLOWED_TO_OPEN = {
    ("ggavatar/cli/likely_device.py", "(Path(found.origin).parent / 'version.py').read_text"): "torch's own file",
    ("ggavatar/cli/process.py", "os.open"): "the null device",
    ("ggavatar/__init__.py", "points[name].load"): "our own package",
    ("ggavatar/formats/capture_layouts.py", "own[kind].load"): "our own package",
    ("ggavatar/plugins/entry_points.py", "point.load"): "packages that are installed",
    ("ggavatar/formats/splats/ply.py", "np.memmap"): "after the header and the size were checked",
    ("ggavatar/formats/splats/ply.py", "np.loadtxt"): "lines of an opened file",
    ("ggavatar/formats/splats/splat.py", "np.memmap"): "after its size was checked",
    ("ggavatar/formats/web/page.py", "(files('ggavatar.formats.web') / 'page' / name).read_text"): "the package's page",
    ("ggavatar/formats/performances.py", "points[0].load"): "packages that are installed",
    ("ggavatar/io/dataclass_json.py", "json.loads"): "what json.dumps has just written",
    ("ggavatar/io/npz.py", "archive.open"): "a member of a checked archive",
    ("ggavatar/io/picture_decoding.py", "Image.open"): "bytes, as JPEG only",
    ("ggavatar/io/regular_files.py", "os.open"): "the one place",
    ("ggavatar/io/zip_files.py", "archive.open"): "a member of a checked archive",
    ("ggavatar/io/zip_files.py", "zipfile.ZipFile"): "the one place for archives",
    ("ggavatar/jit/kernel_cache.py", "path.read_bytes"): "our own sources",
    ("ggavatar/jit/kernel_cache.py", "file.read_bytes"): "our own sources",
    ("ggavatar/jit/kernel_cache.py", "Path(path).read_bytes"): "the user's own cache",
    ("ggavatar/pretrained/package_index.py", "tarfile.open"): "archives whose SHA-256 is known",
    ("ggavatar/pretrained/package_index.py", "zipfile.ZipFile"): "archives whose SHA-256 is known",
    ("ggavatar/pretrained/weights.py", "torch.load"): "weights only, of a file whose SHA-256 is known",
    ("ggavatar/formats/avatar_file/container.py", "safetensors.load"): "bytes whose size and digest were compared",
    ("ggavatar/pretrained/weights.py", "safetensors.torch.load_file"): "after its kind and size were checked",
    ("ggavatar/training/checkpoint.py", "safetensors.load"): "bytes whose digest was compared",
    ("ggavatar/training/snapshot.py", "safetensors.load"): "bytes, of a bounded size",
    ("ggavatar/training/journal.py", "path.open"): "to append to it",
    ("preprocess/masks/networks.py", "onnxruntime.InferenceSession"): "bytes; operators and numbers only",
    ("preprocess/video/alpha_stream.py", "av.CodecContext.create"): "a decoder by name",
    ("preprocess/video/decoding.py", "av.open"): "an opened file, and containers that name no other files",
    ("evaluate/viewer/moving_pictures.py", "av.open"): "an opened file, and containers that name no other files",
    ("evaluate/viewer/moving_pictures.py", "cv2.VideoCapture"): "a camera by its number",
    ("evaluate/metrics/faces.py", "cv2.FaceRecognizerSF.create"): "a file whose SHA-256 is known",
}


def called(node: ast.Call) -> tuple[str, str]:
    """The function of a call as written, and its last name."""
    text = ast.unparse(node.func)
    return text, text.rpartition(".")[2]


def is_writing(node: ast.Call) -> bool:
    """Whether a file is opened to be written: a mode says so."""
    values = [*node.args, *(keyword.value for keyword in node.keywords)]
    return any(isinstance(value, ast.Constant) and value.value in WRITING for value in values)


def may_run(text: str, last: str) -> bool:
    """Whether a call could run what it is given."""
    if last in ("compile", "eval", "exec"):  # re.compile, module.eval
        return text == last
    modules = set(text.split(".")[:-1])
    return last in RUNNERS or bool(modules & RUNNING_MODULES) or text.startswith(RUNNING_PARTS)


def findings(source: str) -> Iterator[tuple[str, str, int]]:
    """Kind ("run" or "open"), function and line of every call that runs or reads what it is given."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call):
            continue
        text, last = called(node)
        if may_run(text, last) and not text.endswith((".items", "UnpicklingError")):
            yield "run", text, node.lineno
        elif reads(node, text, last):
            yield "open", text, node.lineno


def reads(node: ast.Call, text: str, last: str) -> bool:
    """Whether a call reads a file by its path; OpenCV's networks may be given as bytes."""
    if last.startswith("readNet"):
        return not any("frombuffer" in ast.unparse(value) for value in node.args)
    return last in OPENERS and text not in OWN and not is_writing(node)


def in_packages(kind: str) -> dict[tuple[str, str], int]:
    """File and function of all findings of a kind, with a line, outside of kernels (their `load` is no file)."""
    found = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            for each, text, line in findings(path.read_text(encoding="utf-8")):
                is_ours = text in ("builder.load", "tl.load", "self._storages.load") or "_RestrictedUnpickler(" in text
                if each == kind and not is_ours:
                    found[name, text] = line
    return found


@pytest.mark.parametrize(("kind", "allowed"), [("run", ALLOWED_TO_RUN), ("open", ALLOWED_TO_OPEN)])
def test_every_such_call_has_a_reason(kind: str, allowed: dict[tuple[str, str], str]) -> None:
    found = in_packages(kind)
    unknown = {f"{name}:{line}: {text}" for (name, text), line in found.items() if (name, text) not in allowed}
    assert not unknown, (
        "read files with ggavatar.io (regular_files, json_files, npz, images, zip_files), or say why not"
    )
    assert not set(allowed) - set(found), "no longer there"


@pytest.mark.parametrize(
    "planted",
    [
        "torch.jit.load(path)",
        "subprocess.run(name)",
        "pickle.load(stream)",
        "yaml.load(text)",
        "eval(text)",
        "os.system(name)",
        "importlib.import_module(name)",
        "open(path)",
        "path.open('rb')",
        "Path(path).read_text()",
        "np.load(path)",
        "json.loads(text)",
        "cv2.imread(name)",
        "zipfile.ZipFile(path)",
        "cv2.dnn.readNetFromONNX(name)",
        "torch.load(path)",
    ],
)
def test_planted_calls_are_found(planted: str) -> None:
    assert list(findings(planted))


def test_weights_are_read_as_weights() -> None:
    """`torch.load` runs pickles unless it is told not to; `av.open` follows playlists unless containers are listed."""
    for name, text, wanted in (
        ("ggavatar/pretrained/weights.py", "torch.load", "weights_only=True"),
        ("preprocess/video/decoding.py", "av.open", "options={'format_whitelist': _CONTAINERS}"),
        ("ggavatar/io/picture_decoding.py", "Image.open", "formats=['JPEG']"),
    ):
        tree = ast.parse((ROOT / name).read_text(encoding="utf-8"))
        calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and called(node)[0] == text]
        assert calls and all(wanted in ast.unparse(call) for call in calls)
