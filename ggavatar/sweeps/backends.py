"""Where the jobs of a sweep run: on this computer, or on the machines of a Ray cluster."""

from __future__ import annotations

import functools
import importlib.util
import os
import subprocess
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from ggavatar.errors import EXIT_FAILURE, EXIT_GATE, EXIT_INTERRUPTED, EXIT_TERMINATED, EXIT_USAGE, InputError

FINAL = frozenset({0, EXIT_USAGE, EXIT_GATE, EXIT_INTERRUPTED, EXIT_TERMINATED})
"""Exit codes that trying again does not change."""
LOST_MACHINE_RETRIES = 3
"""How often Ray starts a job again whose machine went away, whatever --retries says about jobs that fail."""

SECONDS_TO_STOP = 10
"""For jobs on a cluster when the sweep is interrupted."""


@dataclass(frozen=True)
class Job:
    """One piece of work.

    Attributes:
        name: For messages; unique.
        attempt: Does it, or goes on where an earlier attempt broke off, and returns its exit code. It is sent to other
            processes: a function of a module, or a `functools.partial` of one.
    """

    name: str
    attempt: Callable[[], int]


@dataclass(frozen=True)
class Outcome:
    """How a job ended.

    Attributes:
        job: Its name.
        code: Exit code; 0 is done.
        attempts: How often it was started.
        reason: What is known beyond the exit code.
    """

    job: str
    code: int
    attempts: int = 1
    reason: str = ""


@runtime_checkable
class Backend(Protocol):
    """Where jobs run. One that fails does not stop the others."""

    def run(self, jobs: Sequence[Job]) -> Iterator[Outcome]:
        """Run all jobs and tell of each as it ends, in any order."""
        ...


@dataclass(frozen=True)
class LocalProcesses:
    """Jobs in processes on this computer.

    Attributes:
        at_once: How many run at the same time.
        retries: How often a job that failed is started again.
    """

    at_once: int = 1
    retries: int = 0

    def run(self, jobs: Sequence[Job]) -> Iterator[Outcome]:
        """Run the jobs on as many threads as may run at the same time; each waits for a process."""
        pool = ThreadPoolExecutor(max(self.at_once, 1), thread_name_prefix="sweep")
        try:
            for future in as_completed([pool.submit(persistently, job, self.retries) for job in jobs]):
                yield future.result()
        finally:
            pool.shutdown(cancel_futures=True)


@dataclass(frozen=True)
class RayCluster:
    """Jobs on a Ray cluster: the one of $RAY_ADDRESS or started with `ray start`, else one on this computer.

    Attributes:
        gpus: GPUs of a job; it is started where as many are free, and sees only these.
        cpus: Cores of a job.
        retries: How often a job that failed is started again.
    """

    gpus: float = 0.0
    cpus: float = 1.0
    retries: int = 0

    def run(self, jobs: Sequence[Job]) -> Iterator[Outcome]:
        """Run the jobs as Ray tasks.

        Raises:
            InputError: Ray is not installed, or no machine of the cluster has as many GPUs or cores.
        """
        ray = _ray()
        ours = not ray.is_initialized()
        if ours:
            ray.init(include_dashboard=False, log_to_driver=False, logging_level="warning")
        try:
            self._require_resources(ray)
            task = ray.remote(num_gpus=self.gpus, num_cpus=self.cpus, max_retries=LOST_MACHINE_RETRIES)(persistently)
            yield from _as_they_end(ray, {task.remote(job, self.retries): job for job in jobs})
        finally:
            if ours:
                ray.shutdown()

    def _require_resources(self, ray: Any) -> None:
        """Ray would wait for ever for a machine that does not exist."""
        nodes = [node.get("Resources", {}) for node in ray.nodes() if node.get("Alive")]
        if not any(node.get("GPU", 0) >= self.gpus and node.get("CPU", 0) >= self.cpus for node in nodes):
            largest = {kind: max((node.get(kind, 0) for node in nodes), default=0) for kind in ("GPU", "CPU")}
            raise InputError(
                f"expected a machine with {self.gpus:g} GPUs and {self.cpus:g} cores for a job, the cluster has up to "
                f"{largest['GPU']:g} GPUs and {largest['CPU']:g} cores; ask for fewer or add machines"
            )


def _ray() -> Any:
    """The package Ray; `InputError` that says how to get it."""
    if importlib.util.find_spec("ray") is None:
        raise InputError("--backend ray needs Ray, which is not installed; pip install ggavatar[ray]")
    import ray

    return ray


def _as_they_end(ray: Any, waiting: dict[Any, Job]) -> Iterator[Outcome]:
    """The outcomes of Ray tasks; what still runs when the caller stops listening is cancelled."""
    try:
        while waiting:
            ended, _ = ray.wait(list(waiting))
            for reference in ended:
                yield _outcome(ray, reference, waiting.pop(reference))
    finally:
        for reference in waiting:
            ray.cancel(reference)
        if waiting:
            ray.wait(list(waiting), num_returns=len(waiting), timeout=SECONDS_TO_STOP)


def _outcome(ray: Any, reference: Any, job: Job) -> Outcome:
    """What a Ray task returned; a task that Ray lost is a job that failed."""
    try:
        outcome: Outcome = ray.get(reference)
    except ray.exceptions.RayError as error:
        return Outcome(job.name, EXIT_FAILURE, 1 + LOST_MACHINE_RETRIES, str(error).strip().split("\n")[-1][:300])
    return outcome


def persistently(job: Job, retries: int) -> Outcome:
    """Try a job until it is done, cannot succeed, or has used up its retries; what it raises is a failure too."""
    for attempt in range(1, retries + 2):
        reason = ""
        try:
            code = job.attempt()
        except (InputError, OSError) as error:
            code, reason = EXIT_USAGE if isinstance(error, InputError) else EXIT_FAILURE, str(error)
        if code in FINAL or attempt == retries + 1:
            return Outcome(job.name, code, attempt, reason)
    raise ValueError(f"expected retries of 0 or more, got {retries}")


def logged(command: Sequence[str], log: Path, cores: int | None = None) -> int:
    """Run a program with its output added to a log; its exit code, 128 + signal if one ended it.

    Args:
        command: Program and arguments.
        log: File.
        cores: What it may use of the machine; what the user has set in the environment stays. None is all.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    share = {} if cores is None else {name: str(cores) for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")}
    surroundings = share | dict(os.environ)
    with log.open("a") as stream:
        code = subprocess.run(
            list(command), stdout=stream, stderr=subprocess.STDOUT, env=surroundings, check=False
        ).returncode
    return code if code >= 0 else 128 - code


def command_job(name: str, command: Sequence[str], log: Path) -> Job:
    """A job that is one program."""
    return Job(name, functools.partial(logged, tuple(command), log))
