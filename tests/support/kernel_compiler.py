"""Compiles Triton kernels for GPUs that are not here, and says how many registers they need.

As a program: reads launches as lines of JSON on stdin, as `Launch.as_json` makes them, and writes one line of JSON for
each of them and every target. It runs in a process of its own, because kernels are either interpreted or compiled.
"""

from __future__ import annotations

import dataclasses
import importlib
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

TYPES = {
    "torch.float32": "*fp32", "torch.int16": "*i16", "torch.int32": "*i32", "torch.int64": "*i64",
    "torch.uint8": "*u8", "torch.bool": "*i1", "torch.bfloat16": "*bf16",
}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Launch:
    """What decides the machine code of a launch: the types of its arguments, and its constants."""

    module: str
    name: str
    types: tuple[str, ...]
    constants: dict[str, Any]
    warps: int

    def as_json(self) -> str:
        return json.dumps(dataclasses.asdict(self))


@contextmanager
def recorded_launches() -> Iterator[list[Launch]]:
    """Record every launch, which also runs."""
    from torch.utils._python_dispatch import _disable_current_modes

    from ggavatar.jit import device_kernels

    found: list[Launch] = []
    before = device_kernels.launch

    def record(kernel: Any, programs: int, *arguments: Any, warps: int = 4, **constants: Any) -> None:
        types = tuple(_type(argument) for argument in arguments)
        found.append(Launch(kernel.fn.__module__, kernel.fn.__name__, types, constants, warps))
        with _disable_current_modes():  # the interpreter copies
            before(kernel, programs, *arguments, warps=warps, **constants)

    device_kernels.launch = record
    try:
        yield found
    finally:
        device_kernels.launch = before


def _type(argument: Any) -> str:
    """Triton's name of the type of an argument."""
    if hasattr(argument, "dtype"):
        return TYPES[str(argument.dtype)]
    if isinstance(argument, float):
        return "fp32"
    return "i32"


def compiled(launches: list[Launch], targets: tuple[int, ...]) -> list[dict[str, Any]]:
    """Compile launches for GPUs (90 for sm_90) in a new process: for each, registers, bytes spilled, shared memory."""
    environment = {name: value for name, value in os.environ.items() if name != "TRITON_INTERPRET"}
    with tempfile.TemporaryDirectory() as cache:
        done = subprocess.run(
            [sys.executable, "-m", "tests.support.kernel_compiler", *map(str, targets)],
            input="\n".join(launch.as_json() for launch in launches),
            env={**environment, "TRITON_CACHE_DIR": cache}, cwd=Path(__file__).parents[2],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def _compile(launch: Launch, capability: int) -> dict[str, Any]:
    import triton
    from triton.backends.compiler import GPUTarget
    from triton.compiler import ASTSource

    kernel = getattr(importlib.import_module(launch.module), launch.name)
    names = kernel.arg_names
    signature = dict(zip(names, launch.types, strict=False)) | dict.fromkeys(launch.constants, "constexpr")
    signature = {name: signature[name] for name in names}
    constants = {(names.index(name),): value for name, value in launch.constants.items()}
    pointers = {number for number, kind in enumerate(launch.types) if kind.startswith("*")}
    numbers = {name for name, kind in zip(names, launch.types, strict=False) if kind.startswith("i")}
    # Triton compiles a variant for every kind of value of other numbers: 1, multiples of 16, the rest.
    assert numbers <= set(kernel.do_not_specialize), numbers - set(kernel.do_not_specialize)
    attributes = {(number,): [["tt.divisibility", 16]] for number in pointers}  # torch aligns its memory
    source = ASTSource(kernel, signature, constants, attributes)
    made = triton.compile(source, target=GPUTarget("cuda", capability, 32), options={"num_warps": launch.warps})
    with tempfile.NamedTemporaryFile(suffix=".ptx") as file:
        file.write(made.asm["ptx"].encode())
        file.flush()
        ptxas = Path(triton.__file__).parent / "backends" / "nvidia" / "bin" / "ptxas"
        target = re.search(r"\.target (\w+)", made.asm["ptx"])
        assert target
        command = [str(ptxas), "-v", f"--gpu-name={target[1]}", file.name, "-o", os.devnull]
        said = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    registers, spilled = re.search(r"Used (\d+) registers", said), re.findall(r"(\d+) bytes spill", said)
    assert registers and len(spilled) == 2, said
    return {
        "kernel": launch.name, "target": capability, "constants": launch.constants,
        "registers": int(registers[1]), "spilled": sum(map(int, spilled)), "shared": made.metadata.shared,
    }  # fmt: skip


if __name__ == "__main__":
    for line in sys.stdin.read().splitlines():
        for target in sys.argv[1:]:
            sys.stdout.write(json.dumps(_compile(Launch(**json.loads(line)), int(target))) + "\n")
