"""Pickles that run code, in every way that the format has to call something."""

from __future__ import annotations

import io
import pickle
import struct
import zipfile
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tests.faults.hostile.bases import FILES
from tests.faults.hostile.fixture import Hostile
from tests.faults.hostile.samples import npy, torch_file

CANARY = "canary"
"""A file that every payload tries to make in the working folder."""
_CODE = f"open({CANARY!r}, 'w')"
_SHELL = f"touch {CANARY}"


class Call(NamedTuple):
    """A function that does harm, and its arguments."""

    module: str
    name: str
    arguments: tuple[object, ...]


CALLS = (
    *(Call(module, "system", (_SHELL,)) for module in ("os", "posix", "nt")),
    Call("os", "popen", (_SHELL,)),
    Call("os", "execvp", ("touch", ["touch", CANARY])),
    Call("os", "posix_spawnp", ("touch", ["touch", CANARY], {})),
    Call("os", "remove", ("victim.txt",)),
    Call("os", "rename", ("victim.txt", CANARY)),
    Call("os", "mkdir", (CANARY,)),
    Call("os", "putenv", ("PATH", ".")),
    Call("os", "kill", (0, 9)),
    Call("os", "_exit", (0,)),
    *(Call("subprocess", name, (_SHELL, -1, None, None, None, None, None, True, True)) for name in ("Popen", "call")),
    *(Call("subprocess", name, (_SHELL,)) for name in ("getoutput", "getstatusoutput")),
    Call("subprocess", "check_output", (["touch", CANARY],)),
    *(Call(module, name, (_CODE,)) for module in ("builtins", "__builtin__") for name in ("eval", "exec")),
    Call("builtins", "open", (CANARY, "w")),
    Call("builtins", "__import__", ("antigravity",)),
    Call("builtins", "getattr", ("x", "__class__")),
    Call("builtins", "compile", (_CODE, "x", "exec")),
    Call("builtins", "breakpoint", ()),
    Call("builtins", "map", (_CODE, [1])),
    Call("builtins", "bytes", (1 << 40,)),
    Call("builtins", "bytearray", (1 << 40,)),
    Call("builtins", "list", ((),)),
    Call("builtins", "range", (1 << 40,)),
    Call("builtins", "pow", (9, 10**9)),
    Call("builtins", "type", ("X", (), {})),
    Call("io", "open", (CANARY, "w")),
    Call("_io", "FileIO", (CANARY, "w")),
    Call("codecs", "open", (CANARY, "w")),
    Call("_codecs", "decode", (b"x" * 99, "zlib")),
    Call("_codecs", "lookup", ("unknown",)),
    Call("pathlib", "Path.write_text", ("victim.txt", "changed")),
    Call("pathlib", "PosixPath", ("victim.txt",)),
    Call("shutil", "rmtree", (".",)),
    Call("shutil", "copyfile", ("victim.txt", CANARY)),
    Call("pty", "spawn", (["touch", CANARY],)),
    Call("runpy", "run_module", ("antigravity",)),
    Call("runpy", "run_path", ("victim.txt",)),
    Call("importlib", "import_module", ("antigravity",)),
    Call("ctypes", "CDLL", ("libc.so.6",)),
    Call("marshal", "loads", (b"\xe3",)),
    Call("pickle", "loads", (b"cos\nsystem\n(S'touch canary'\ntR.",)),
    Call("_pickle", "loads", (b"cos\nsystem\n(S'touch canary'\ntR.",)),
    Call("timeit", "timeit", (_CODE,)),
    Call("cProfile", "run", (_CODE,)),
    Call("pdb", "run", (_CODE,)),
    Call("code", "interact", ()),
    Call("threading", "Timer", (0.0, print)),
    Call("multiprocessing.util", "spawnv_passfds", (b"/bin/touch", [b"touch", b"canary"], [])),
    Call("functools", "partial", (print, "x")),
    Call("operator", "attrgetter", ("__class__.__mro__",)),
    Call("operator", "methodcaller", ("system", _SHELL)),
    Call("types", "FunctionType", (None, {})),
    Call("socket", "create_connection", (("127.0.0.1", 9),)),
    Call("urllib.request", "urlopen", ("http://127.0.0.1:9/",)),
    Call("webbrowser", "open", ("http://127.0.0.1:9/",)),
    Call("smtplib", "SMTP", ("127.0.0.1", 9)),
    Call("tempfile", "mkdtemp", ("", "", ".")),
    Call("numpy", "load", ("victim.npy",)),
    Call("numpy", "memmap", ("victim.txt", "u1", "w+", 0, (9,))),
    Call("numpy", "fromfile", ("victim.txt",)),
    Call("numpy", "zeros", (1 << 40,)),
    Call("numpy.testing", "runstring", (_CODE, {})),
    Call("numpy.f2py", "compile", ("x",)),
    Call("numpy.core.multiarray", "fromstring", ("x",)),
    Call("torch", "load", ("victim.pt",)),
    Call("torch", "from_file", ("victim.txt", True, 100)),
    Call("torch.jit", "load", ("victim.pt",)),
    Call("torch.hub", "load", (".", "x")),
    Call("torch.storage", "UntypedStorage.from_file", ("victim.txt", True, 100)),
    Call("torch.utils.cpp_extension", "load_inline", ("x", "y")),
    Call("torch.utils.collect_env", "run", (_SHELL,)),
    Call("torch.serialization", "load", ("victim.pt",)),
    Call("scipy.sparse", "load_npz", ("victim.npz",)),
    Call("chumpy.ch", "Ch.__init__", (1,)),
    Call("chumpy", "os.system", (_SHELL,)),
    Call("cv2", "imwrite", (CANARY + ".png", 0)),
    Call("ggavatar.io.atomic", "write_text", ("victim.txt", "changed")),
    Call("ggavatar.io.restricted_pickle", "pickle._Unpickler", (1,)),
    Call("copyreg", "_reconstructor", (1, 2, 3)),
    Call("copyreg", "add_extension", ("os", "system", 1)),
    Call("collections", "defaultdict", (print,)),
    Call("__main__", "os.system", (_SHELL,)),
    Call("sys", "modules.clear", ()),
    Call("", "", ()),
    Call("os\0", "system", (_SHELL,)),
    Call(".os", "system", (_SHELL,)),
)


def plain(value: object) -> bytes:
    """A value without the frame of a pickle; functions among arguments become None."""
    try:
        return pickle.dumps(value, 2)[2:-1]
    except Exception:
        return b"N"


def _arguments(call: Call) -> bytes:
    return b"(" + b"".join(plain(None if callable(value) else value) for value in call.arguments) + b"t"


def text(value: str) -> bytes:
    data = value.encode()
    return b"X" + struct.pack("<I", len(data)) + data


def _global(call: Call) -> bytes:
    return f"c{call.module}\n{call.name}\n".encode()


def _stack_global(call: Call) -> bytes:
    return text(call.module) + text(call.name) + b"\x93"


WAYS = {
    "reduce": lambda call: _global(call) + _arguments(call) + b"R.",
    "stack global": lambda call: b"\x80\x04" + _stack_global(call) + _arguments(call) + b"R.",
    "inst": lambda call: b"(" + _arguments(call)[1:-1] + f"i{call.module}\n{call.name}\n.".encode(),
    "obj": lambda call: b"(" + _global(call) + _arguments(call)[1:-1] + b"o.",
    "newobj": lambda call: b"\x80\x02" + _global(call) + _arguments(call) + b"\x81.",
    "newobj ex": lambda call: b"\x80\x04" + _stack_global(call) + _arguments(call) + b"}\x92.",
    "build": lambda call: b"\x80\x02" + _global(call) + b"}" + plain("__setstate__") + _global(call) + b"sb.",
    "build slots": lambda call: b"\x80\x02cnumpy\nndarray\n(N}" + plain("__reduce__") + _global(call) + b"stb.",
    "in a list": lambda call: b"\x80\x02](" + _global(call) + _arguments(call) + b"RNe.",
    "popped": lambda call: b"\x80\x02" + _global(call) + _arguments(call) + b"R0N.",
    "after stop": lambda call: b"\x80\x02N." + _global(call) + _arguments(call) + b"R.",
    "memo": lambda call: b"\x80\x02" + _global(call) + b"q\x00" + b"0h\x00" + _arguments(call) + b"R.",
    "in an array": lambda call: (
        b"\x80\x02cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85C\x01b\x87R(K\x01K\x01\x85"
        + _global(call)
        + _arguments(call)
        + b"R\x89C\x00tb."
    ),
}
"""Ways to call something."""


def calls() -> Iterator[Hostile]:
    """Every call in the usual way, and some calls in every way, through every reader of pickles."""
    for call in CALLS:
        title = f"{call.module or 'no module'}.{call.name!r:.30}"
        yield as_pickle(f"{title} called", WAYS["reduce"](call))
    for way, write in WAYS.items():
        for call in (CALLS[0], Call("builtins", "exec", (_CODE,)), Call("torch", "from_file", ("victim.txt", True, 9))):
            refused = way != "after stop"
            yield as_pickle(f"{call.module}.{call.name} by {way}", write(call), refused)
            yield as_frames(f"{call.module}.{call.name} by {way}", write(call), refused)
    for number, opcode in enumerate((b"\x82\x01", b"\x83\x01\x00", b"\x84\x01\x00\x00\x00", b"Px\n", b"NQ", b"\x97")):
        yield as_pickle(f"outside reference {number}", b"\x80\x05" + opcode + b".")
    yield from containers()


def containers() -> Iterator[Hostile]:
    """Code in the containers that hold a pickle: head models, torch's two formats, arrays of objects."""
    payload = WAYS["reduce"](CALLS[0])
    yield Hostile("code in a head model", FILES, "head", "generic_model.pkl", {"generic_model.pkl": payload}, True)
    for name, reader in (("zip.pt", "pickle"), ("zip.pt", "weights")):
        yield Hostile("code in torch's zip", FILES, reader, name, {name: with_pickle(torch_file(False), payload)}, True)
    for reader in ("pickle", "weights"):
        magic = pickle.dumps(0x1950A86A20F9469CFC6C, 2) + pickle.dumps(1001, 2) + pickle.dumps({}, 2)
        for title, data in (("objects", magic + payload), ("system", magic[:-5] + payload), ("first", payload)):
            files = {"legacy.pth": data}
            yield Hostile(f"code in torch's stream ({title})", FILES, reader, "legacy.pth", files, True)
    objects = npy(np.zeros(3))
    header = objects[10:128].replace(b"<f8", b"|O ").replace(b"(3,)", b"(1,)")
    bad = objects[:10] + header + payload
    yield Hostile("code in an npy", FILES, "npy", "array.npy", {"array.npy": bad}, True)
    for name, reader in _ARCHIVES.items():
        files = {name: _zip({f"{member}.npy": bad for member in ("a", "version", "template", "names", "expression")})}
        yield Hostile(f"code in {name}", FILES, reader, name, files, True)


_ARCHIVES = {
    **{"plain.npz": "npz", "head.npz": "head", "flame.npz": "head", "take.npz": "recording"},
    **{"flame_param.npz": "parameters", "driving.npz": "driving"},
}


def _zip(members: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return stream.getvalue()


def with_pickle(archive: bytes, payload: bytes) -> bytes:
    """torch's zip with another data.pkl."""
    with zipfile.ZipFile(io.BytesIO(archive)) as stored:
        members = {info.filename: stored.read(info) for info in stored.infolist()}
    return _zip({name: payload if name.endswith("data.pkl") else content for name, content in members.items()})


def as_pickle(name: str, data: bytes, refused: bool = True) -> Hostile:
    return Hostile(name, FILES, "pickle", "frame.frame", {"frame.frame": data}, refused)


def as_frames(name: str, data: bytes, refused: bool = True) -> Hostile:
    """All frames of a tracking, since one readable frame of three would be enough."""
    files = {f"tracking/{number:05d}.frame": data for number in range(3)}
    return Hostile(name, "metrical_tracker", "tracking:metrical_tracker", "tracking", files, refused)


def fixtures() -> list[Hostile]:
    """All of them."""
    return list(calls())
