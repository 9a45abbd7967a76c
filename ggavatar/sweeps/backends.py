"""Where the cells of a sweep are trained: in processes on this computer, or on the machines of a Ray cluster."""

from __future__ import annotations

import functools
import importlib.util
import os
import subprocess
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Protocol, runtime_checkable

from ggavatar.errors import (
    EXIT_FAILURE,
    EXIT_GATE,
    EXIT_INTERRUPTED,
    EXIT_TERMINATED,
    EXIT_USAGE,
    InputError,
    Terminated,
)
from ggavatar.io.held_folders import make_folder

FINAL_EXIT_CODES = frozenset({0, EXIT_USAGE, EXIT_GATE, EXIT_INTERRUPTED, EXIT_TERMINATED})
"""Exit codes that a retry would not change."""

LOST_MACHINE_RETRIES = 3
"""How often Ray restarts a training whose machine was lost; --retries is about trainings that fail."""

STOP_TIMEOUT = 10
"""Time for trainings on a cluster to stop when the sweep is interrupted, s."""


@dataclass(frozen=True)
class CellTraining:
    """The training of one cell.

    Attributes:
        name: Name of the cell, for messages; unique.
        train: Trains the cell, or resumes an earlier attempt, and returns the exit code; called with `gpu=…` to run on
            one device of several. It is sent to other processes: a module-level function, or a `functools.partial` of
            one.
    """

    name: str
    train: Callable[..., int]


@dataclass(frozen=True)
class Outcome:
    """How the training of a cell ended.

    Attributes:
        cell: Name of the cell.
        code: Exit code; 0 is success.
        attempts: How often it was started.
        reason: What is known beyond the exit code.
    """

    cell: str
    code: int
    attempts: int = 1
    reason: str = ""


@runtime_checkable  # the tests' run-time type checker needs it
class Backend(Protocol):
    """Trains the cells of a sweep; a cell that fails does not stop the others."""

    def run(self, trainings: Sequence[CellTraining]) -> Iterator[Outcome]:
        """Run all trainings and yield the outcome of each as it ends, in any order."""
        ...


@dataclass(frozen=True)
class LocalProcesses:
    """Trains cells in processes on this computer.

    Attributes:
        parallel: Number of cells trained at the same time.
        retries: How often a training that failed is started again.
        gpus: CUDA devices, as in $CUDA_VISIBLE_DEVICES; a cell sees one, and cells that run at the same time see
            different ones as long as there are enough. Without any, cells see what this process sees.
    """

    parallel: int = 1
    retries: int = 0
    gpus: tuple[str, ...] = ()

    def run(self, trainings: Sequence[CellTraining]) -> Iterator[Outcome]:
        """Run the trainings on a pool of threads, each of which waits for one process at a time."""
        pool = ThreadPoolExecutor(max(self.parallel, 1), thread_name_prefix="sweep")
        try:
            free = free_gpus(self.gpus, max(self.parallel, 1))
            futures = [pool.submit(_run_on_a_gpu, training, self.retries, free) for training in trainings]
            for future in as_completed(futures):
                yield future.result()
        except Terminated:  # Ctrl-C reaches the trainings by itself, since it goes to all processes of a terminal
            pool.shutdown(wait=False, cancel_futures=True)
            stop_running()
            raise
        finally:
            pool.shutdown(cancel_futures=True)


@dataclass(frozen=True)
class RayCluster:
    """Trains cells on a Ray cluster: that of $RAY_ADDRESS or `ray start`, else a new one on this computer.

    Attributes:
        gpus: GPUs of a cell; it is started where as many are free, and sees only these. None is one if a machine of
            the cluster has any, else none.
        cpus: Cores of a cell.
        retries: How often a training that failed is started again.
    """

    gpus: float | None = None
    cpus: float = 1.0
    retries: int = 0

    def run(self, trainings: Sequence[CellTraining]) -> Iterator[Outcome]:
        """Run the trainings as Ray tasks.

        Raises:
            InputError: Ray is not installed, or no machine of the cluster has as many GPUs or cores.
        """
        ray = _import_ray()
        is_new = not ray.is_initialized()
        if is_new:
            ray.init(include_dashboard=False, log_to_driver=False, logging_level="warning")
        try:
            gpus = self._gpus_of_a_cell(ray)
            options = {"num_gpus": gpus, "num_cpus": self.cpus, "max_retries": LOST_MACHINE_RETRIES}
            task = ray.remote(**options)(run_with_retries)
            yield from _as_completed(ray, {task.remote(training, self.retries): training for training in trainings})
        finally:
            if is_new:
                ray.shutdown()

    def _gpus_of_a_cell(self, ray: Any) -> float:
        """GPUs to ask for, or an `InputError` if no machine is large enough: Ray would wait for one forever."""
        nodes = [node.get("Resources", {}) for node in ray.nodes() if node.get("Alive")]
        gpus = self.gpus
        if gpus is None:
            gpus = 1.0 if any(node.get("GPU", 0) >= 1 for node in nodes) else 0.0
        if not any(node.get("GPU", 0) >= gpus and node.get("CPU", 0) >= self.cpus for node in nodes):
            largest = {kind: max((node.get(kind, 0) for node in nodes), default=0) for kind in ("GPU", "CPU")}
            raise InputError(
                f"expected a machine with {gpus:g} GPUs and {self.cpus:g} cores for a cell, found up to "
                f"{largest['GPU']:g} GPUs and {largest['CPU']:g} cores in the cluster; request fewer or add machines"
            )
        return gpus


def _import_ray() -> Any:
    if importlib.util.find_spec("ray") is None:
        raise InputError("--backend ray needs Ray, which is not installed; run pip install ggavatar[ray]")
    import ray

    return ray


def _as_completed(ray: Any, waiting: dict[Any, CellTraining]) -> Iterator[Outcome]:
    """The outcomes of Ray tasks; those still running when the caller stops iterating are canceled."""
    try:
        while waiting:
            ended, _ = ray.wait(list(waiting))
            for reference in ended:
                yield _outcome(ray, reference, waiting.pop(reference))
    finally:
        for reference in waiting:
            ray.cancel(reference)
        if waiting:
            ray.wait(list(waiting), num_returns=len(waiting), timeout=STOP_TIMEOUT)


def _outcome(ray: Any, reference: Any, training: CellTraining) -> Outcome:
    """What a Ray task returned; a task that Ray lost is a training that failed."""
    try:
        outcome: Outcome = ray.get(reference)
    except ray.exceptions.RayError as error:
        reason = str(error).strip().split("\n")[-1][:300]
        return Outcome(training.name, EXIT_FAILURE, 1 + LOST_MACHINE_RETRIES, reason)
    return outcome


def free_gpus(gpus: Sequence[str], parallel: int) -> SimpleQueue[str]:
    """A place for every cell that runs at the same time: each device once, then again, if there are more cells."""
    places: SimpleQueue[str] = SimpleQueue()
    for number in range(max(parallel, len(gpus)) if gpus else 0):
        places.put(gpus[number % len(gpus)])
    return places


def _run_on_a_gpu(training: CellTraining, retries: int, free: SimpleQueue[str]) -> Outcome:
    """`run_with_retries` on a device that no other cell uses, if there are devices."""
    if free.empty():
        return run_with_retries(training, retries)
    gpu = free.get()
    try:
        return run_with_retries(CellTraining(training.name, functools.partial(training.train, gpu=gpu)), retries)
    finally:
        free.put(gpu)


def run_with_retries(training: CellTraining, retries: int) -> Outcome:
    """Run a training until it succeeds, cannot succeed, or has used up its retries; an exception is a failure too."""
    for attempt in range(1, retries + 2):
        reason = ""
        try:
            code = training.train()
        except (InputError, OSError) as error:
            code, reason = EXIT_USAGE if isinstance(error, InputError) else EXIT_FAILURE, str(error)
        if code in FINAL_EXIT_CODES or attempt == retries + 1:
            return Outcome(training.name, code, attempt, reason)
    raise ValueError(f"expected retries of 0 or more, got {retries}")


def run_logged(command: Sequence[str], log: Path, cores: int | None = None, gpu: str | None = None) -> int:
    """Run a program, append its output to a log, and return its exit code (128 + signal if a signal ended it).

    Args:
        command: Program and arguments.
        log: The log file.
        cores: Number of threads for OpenMP and Numba, unless the user's environment sets it; None sets nothing.
        gpu: The CUDA device that it sees; None leaves what this process sees.
    """
    make_folder(log.parent)
    share = {} if cores is None else {name: str(cores) for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")}
    environment = share | dict(os.environ) | ({} if gpu is None else {"CUDA_VISIBLE_DEVICES": gpu})
    with log.open("a") as stream:
        process = subprocess.Popen(
            list(command), stdin=subprocess.DEVNULL, stdout=stream, stderr=subprocess.STDOUT, env=environment
        )
    _running.add(process)
    try:
        code = process.wait()
    finally:
        _running.discard(process)
    return code if code >= 0 else 128 - code


_running: set[subprocess.Popen[bytes]] = set()


def stop_running() -> None:
    """Let the programs of `run_logged` end: trainings save and stop; each is waited for where it was started."""
    for process in tuple(_running):
        process.terminate()
