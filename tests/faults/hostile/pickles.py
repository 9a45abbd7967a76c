"""Pickles that run code, in every way the format has to call something, and that take time and memory out of all proportion."""

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


def _plain(value: object) -> bytes:
    """A value without the frame of a pickle; functions among arguments become None."""
    try:
        return pickle.dumps(value, 2)[2:-1]
    except Exception:
        return b"N"


def _arguments(call: Call) -> bytes:
    return b"(" + b"".join(_plain(None if callable(value) else value) for value in call.arguments) + b"t"


def _text(value: str) -> bytes:
    data = value.encode()
    return b"X" + struct.pack("<I", len(data)) + data


def _global(call: Call) -> bytes:
    return f"c{call.module}\n{call.name}\n".encode()


def _stack_global(call: Call) -> bytes:
    return _text(call.module) + _text(call.name) + b"\x93"


WAYS = {
    "reduce": lambda call: _global(call) + _arguments(call) + b"R.",
    "stack global": lambda call: b"\x80\x04" + _stack_global(call) + _arguments(call) + b"R.",
    "inst": lambda call: b"(" + _arguments(call)[1:-1] + f"i{call.module}\n{call.name}\n.".encode(),
    "obj": lambda call: b"(" + _global(call) + _arguments(call)[1:-1] + b"o.",
    "newobj": lambda call: b"\x80\x02" + _global(call) + _arguments(call) + b"\x81.",
    "newobj ex": lambda call: b"\x80\x04" + _stack_global(call) + _arguments(call) + b"}\x92.",
    "build": lambda call: b"\x80\x02" + _global(call) + b"}" + _plain("__setstate__") + _global(call) + b"sb.",
    "build slots": lambda call: b"\x80\x02cnumpy\nndarray\n(N}" + _plain("__reduce__") + _global(call) + b"stb.",
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
        yield _pickle(f"{title} called", WAYS["reduce"](call))
    for way, write in WAYS.items():
        for call in (CALLS[0], Call("builtins", "exec", (_CODE,)), Call("torch", "from_file", ("victim.txt", True, 9))):
            refused = way != "after stop"
            yield _pickle(f"{call.module}.{call.name} by {way}", write(call), refused)
            yield _frame(f"{call.module}.{call.name} by {way}", write(call), refused)
    for number, opcode in enumerate((b"\x82\x01", b"\x83\x01\x00", b"\x84\x01\x00\x00\x00", b"Px\n", b"NQ", b"\x97")):
        yield _pickle(f"outside reference {number}", b"\x80\x05" + opcode + b".")
    yield from containers()


def containers() -> Iterator[Hostile]:
    """Code in the containers that hold a pickle: head models, torch's two formats, arrays of objects."""
    payload = WAYS["reduce"](CALLS[0])
    yield Hostile("code in a head model", FILES, "head", "generic_model.pkl", {"generic_model.pkl": payload}, True)
    for name, reader in (("zip.pt", "pickle"), ("zip.pt", "weights")):
        yield Hostile("code in torch's zip", FILES, reader, name, {name: _with_pickle(torch_file(False), payload)}, True)
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


def _with_pickle(archive: bytes, payload: bytes) -> bytes:
    """torch's zip with another data.pkl."""
    with zipfile.ZipFile(io.BytesIO(archive)) as stored:
        members = {info.filename: stored.read(info) for info in stored.infolist()}
    return _zip({name: payload if name.endswith("data.pkl") else content for name, content in members.items()})


def _pickle(name: str, data: bytes, refused: bool = True) -> Hostile:
    return Hostile(name, FILES, "pickle", "frame.frame", {"frame.frame": data}, refused)


def _frame(name: str, data: bytes, refused: bool = True) -> Hostile:
    """All frames of a tracking, since one readable frame of three would be enough."""
    files = {f"tracking/{number:05d}.frame": data for number in range(3)}
    return Hostile(name, "metrical_tracker", "tracking:metrical_tracker", "tracking", files, refused)


def bombs() -> Iterator[Hostile]:
    """Pickles that hang, exhaust the memory or the stack."""
    for name, data in _bombs().items():
        yield _pickle(name, data, refused=False)
        if len(data) < 1 << 20:
            yield _frame(name, data, refused=False)
            files = {"generic_model.pkl": data}
            yield Hostile(name, FILES, "head", "generic_model.pkl", files, True)
    for name, data in _tensor_bombs().items():
        for reader in ("pickle", "weights"):
            yield Hostile(name, FILES, reader, "zip.pt", {"zip.pt": _with_pickle(torch_file(False), data)})


def _doubling(level: int, close: bytes) -> bytes:
    """A value that holds the one before twice, that many times."""
    return b"".join(b"0(h" + bytes([n]) + b"h" + bytes([n]) + close + b"q" + bytes([n + 1]) for n in range(level))


def _array(shape: bytes, kind: bytes, data: bytes) -> bytes:
    """A numpy array as pickled, with the parts as opcodes."""
    head = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(K\x00tC\x01btR(K\x01" + shape
    return head + b"cnumpy\ndtype\n(" + kind + b"K\x00K\x01tR(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89" + data + b"tb"


def _bombs() -> dict[str, bytes]:
    start, many = b"\x80\x02", 200_000
    big = _text("x" * 600_000)
    encode = b"c_codecs\nencode\n" + big + b"q\x01" + _text("latin1") + b"q\x02\x86R"
    return {
        "tuples as keys that double": start + b"Nq\x00" + _doubling(60, b"t") + b"}" + b"h\x3cNs.",
        "tuples in a set that double": b"\x80\x04Nq\x00" + _doubling(60, b"t") + b"\x8f(h\x3c\x90.",
        "frozenset of doubling tuples": b"\x80\x04Nq\x00" + _doubling(60, b"t") + b"(h\x3c\x91.",
        "lists that double": start + b"Nq\x00" + _doubling(200, b"l") + b".",
        "dictionaries that double": start + b"Nq\x00" + _doubling(60, b"t") + b".",
        "the same text encoded 2,000 times": start + b"(" + encode + (b"c_codecs\nencode\nh\x01h\x02\x86R") * 2000 + b"l.",
        "nested 200,000 deep": start + b"]" * many + b"a" * (many - 1) + b".",
        "nested tuples 200,000 deep": start + b"N" + b"\x85" * many + b".",
        "marks without end": start + b"(" * (10 * many),
        "a million empty lists": start + b"(" + b"]" * 1_000_000 + b"l.",
        "three million empty dictionaries": start + b"(" + b"}" * 3_000_000 + b"l.",
        "duplicates without end": start + b"](" + b"2" * 1_000_000 + b"l.",
        "a list that holds itself": start + b"]q\x00h\x00a.",
        "a dictionary that holds itself": start + b"}q\x00K\x01h\x00s.",
        "memo index of 2^31": start + b"Nr\xff\xff\xff\x7f.",
        "memo index of 2^64": b"\x80\x02Np18446744073709551615\n.",
        "a million memo entries": start + b"N" + b"".join(b"r" + struct.pack("<I", n) for n in range(300_000)) + b".",
        "a frame of 2^60 bytes": b"\x80\x04\x95" + struct.pack("<Q", 1 << 60) + b"N.",
        "bytes of 2^60": b"\x80\x04\x8e" + struct.pack("<Q", 1 << 60) + b"x.",
        "text of 2^60": b"\x80\x04\x8d" + struct.pack("<Q", 1 << 60) + b"x.",
        "a bytearray of 2^40": b"\x80\x05\x96" + struct.pack("<Q", 1 << 40) + b"x.",
        "bytes of 4 GB": start + b"B" + struct.pack("<I", 0xFFFFFFFF) + b"x.",
        "text of 4 GB": start + b"X" + struct.pack("<I", 0xFFFFFFFF) + b"x.",
        "a negative length": start + b"T" + struct.pack("<i", -1) + b"x.",
        "a whole number of 2 GB": start + b"\x8b" + struct.pack("<i", (1 << 31) - 1) + b"x.",
        "a whole number of negative size": start + b"\x8b" + struct.pack("<i", -5) + b"x.",
        "a number of a million digits": b"I" + b"9" * 1_000_000 + b"\n.",
        "a long of a million digits": b"L" + b"9" * 1_000_000 + b"L\n.",
        "a float of a million digits": b"F" + b"9" * 1_000_000 + b"\n.",
        "a line without end": b"S'" + b"x" * 1_000_000,
        "escapes": b"S'" + b"\\x41" * 250_000 + b"'\n.",
        "unicode escapes": b"V" + b"\\u0041" * 100_000 + b"\n.",
        "an array of 2^62 numbers": start + _array(b"\x8a\x08" + struct.pack("<q", 1 << 62) + b"\x85", b"U\x02f8", b"C\x00") + b".",
        "an array of negative size": start + _array(b"J\xff\xff\xff\xff\x85", b"U\x02f8", b"C\x00") + b".",
        "an array of 60 dimensions": start + _array(b"(" + b"K\x00" * 60 + b"t", b"U\x02f8", b"C\x00") + b".",
        "numbers of 2^31 bytes": start + _array(b"K\x00\x85", b"U\x0bS2147483647", b"C\x00") + b".",
        "empty texts of 2^29 characters": start + _array(b"K\x01\x85", b"U\x0aU536870911", b"C\x00") + b".",
        "an array of objects": start + _array(b"K\x01\x85", b"U\x01O", b"]Na") + b".",
        "a structured array": start + _array(b"K\x01\x85", b"U\x05i4,i4", b"C\x08aaaaaaaa") + b".",
        "an empty file": b"",
        "one byte": b"\x80",
        "protocol 255": b"\x80\xff.",
        "stop at once": b".",
        "a stack that is empty": start + b"0000.",
        "a set item without a dictionary": start + b"NNNs.",
        "an append to a number": start + b"K\x01Na.",
        "a build of text": start + _text("x") + b"}b.",
        "unhashable keys": start + b"}]Ns.",
        "zeros": bytes(100_000),
        "two pickles": pickle.dumps(1) + pickle.dumps(2),
        "sparse matrix of 2^40 entries": _sparse((1 << 20, 1 << 20)),
        "sparse matrix outside of itself": _sparse((4, 4), rows=99),
    }  # fmt: skip


def _sparse(shape: tuple[int, int], rows: int = 0) -> bytes:
    from tests.support.flame_files import chumpy_pickle

    arrays = {"data": np.ones(1), "indices": np.array([rows]), "indptr": np.array([0, 1])}
    return chumpy_pickle({"J_regressor": ("csc", {"_shape": shape, **arrays})})


def _tensor_bombs() -> dict[str, bytes]:
    """data.pkl of torch's zip whose tensors are not what their storage can hold."""

    def tensor(count: int, offset: int, size: tuple[int, ...], stride: tuple[int, ...]) -> bytes:
        storage = b"(" + _text("storage") + b"ctorch\nFloatStorage\n" + _text("0") + _text("cpu") + _plain(count) + b"tQ"
        view = _plain(offset) + _plain(size) + _plain(stride) + b"\x89ccollections\nOrderedDict\n)R"
        return b"\x80\x02}" + _text("weight") + b"ctorch._utils\n_rebuild_tensor_v2\n(" + storage + view + b"tRs."

    return {
        "a tensor of one number spread to 10^10": tensor(24, 0, (100_000, 100_000), (0, 0)),
        "a tensor of one number spread to 10^8": tensor(24, 0, (10_000, 10_000), (0, 0)),
        "a tensor beyond its storage": tensor(24, 20, (24,), (1,)),
        "a tensor of negative stride": tensor(24, 20, (20,), (-1,)),
        "a tensor of negative size": tensor(24, 0, (-1, 3), (3, 1)),
        "a tensor at a negative place": tensor(24, -8, (2,), (1,)),
        "a storage of 2^60 numbers": tensor(1 << 60, 0, (1 << 60,), (1,)),
        "a storage of negative size": tensor(-1, 0, (2,), (1,)),
        "a tensor of huge stride": tensor(24, 0, (2, 2), (1 << 62, 1 << 62)),
        "a tensor of 60 dimensions": tensor(24, 0, (1,) * 60, (1,) * 60),
        "a tensor without numbers": tensor(24, 0, (0, 1 << 62), (1, 1)),
    }


def fixtures() -> list[Hostile]:
    """All of them."""
    return [*calls(), *bombs()]
