"""Backends of sweeps: what both promise, with programs that take milliseconds in place of trainings."""

from __future__ import annotations

import functools
import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from ggavatar.cli import sweep
from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.sweeps.backends import (
    Backend,
    CellTraining,
    LocalProcesses,
    Outcome,
    RayCluster,
    free_gpus,
    run_logged,
    run_with_retries,
)

FLAKY = (
    "import pathlib, sys\n"
    "seen = pathlib.Path(sys.argv[1])\n"
    "seen.write_text(seen.read_text() + 'x' if seen.exists() else 'x')\n"
    "print('attempt', len(seen.read_text()))\n"
    "sys.exit(0 if len(seen.read_text()) >= int(sys.argv[2]) else 1)\n"
)


def program(folder: Path, name: str, code: str, *arguments: object) -> CellTraining:
    command = (sys.executable, "-c", code, *map(str, arguments))
    return CellTraining(name, functools.partial(run_logged, command, folder / f"{name}.log"))


def four_trainings(folder: Path) -> list[CellTraining]:
    """One that succeeds, one that fails for good, one that needs three attempts, one that kills itself."""
    return [
        program(folder, "fine", "print('hello')"),
        program(folder, "bad", "import sys; sys.exit(2)"),
        program(folder, "flaky", FLAKY, folder / "count", 3),
        program(folder, "killed", "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"),
    ]


EXPECTED = {
    "fine": Outcome("fine", 0, 1),
    "bad": Outcome("bad", 2, 1),
    "flaky": Outcome("flaky", 0, 3),
    "killed": Outcome("killed", 128 + 9, 3),
}


@pytest.mark.parametrize("parallel", [1, 3])
def test_local_processes_keep_the_promises(tmp_path: Path, parallel: int) -> None:
    backend = LocalProcesses(parallel, retries=2)
    assert isinstance(backend, Backend)
    assert {outcome.cell: outcome for outcome in backend.run(four_trainings(tmp_path))} == EXPECTED
    assert (tmp_path / "flaky.log").read_text() == "attempt 1\nattempt 2\nattempt 3\n"
    assert (tmp_path / "count").read_text() == "xxx"


def test_without_retries_nothing_is_started_twice(tmp_path: Path) -> None:
    outcomes = {outcome.cell: outcome for outcome in LocalProcesses().run(four_trainings(tmp_path))}
    assert outcomes["flaky"] == Outcome("flaky", 1, 1) and (tmp_path / "count").read_text() == "x"


@pytest.mark.parametrize(("cores", "set_by_user", "expected"), [(3, None, "3"), (3, "1", "1"), (None, None, "None")])
def test_a_program_gets_its_share_of_the_cores_unless_the_user_said_otherwise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cores: int | None, set_by_user: str | None, expected: str
) -> None:
    for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
        if set_by_user is not None:
            monkeypatch.setenv(name, set_by_user)
    tell = "import os; print(os.environ.get('OMP_NUM_THREADS'), os.environ.get('NUMBA_NUM_THREADS'))"
    assert run_logged([sys.executable, "-c", tell], tmp_path / "log", cores) == 0
    assert (tmp_path / "log").read_text() == f"{expected} {expected}\n"


def test_cells_share_the_cores_of_the_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    shares = [sweep.cores_per_cell(arguments(tmp_path, tmp_path, jobs=jobs)) for jobs in (1, 2, 3, 20)]
    assert shares == [None, 4, 2, 1]
    assert sweep.cores_per_cell(arguments(tmp_path, tmp_path, backend="ray", cpus_per_job=2.5)) == 2


def _refuse() -> int:
    raise InputError("no such command")


def _deny() -> int:
    raise PermissionError("no")


def test_a_training_that_cannot_start_is_a_failure_with_a_reason() -> None:
    assert run_with_retries(CellTraining("a", _refuse), 5) == Outcome("a", 2, 1, "no such command")
    assert run_with_retries(CellTraining("b", _deny), 1) == Outcome("b", 1, 2, "no")


def test_ray_keeps_the_same_promises(tmp_path: Path) -> None:
    """In a process of its own: Ray's threads and warnings stay out of this one."""
    if importlib.util.find_spec("ray") is None:
        pytest.skip("needs Ray: pip install ggavatar[ray]")
    script = (
        "import json, sys, pathlib\n"
        f"sys.path.insert(0, {str(Path(__file__).parents[3])!r})\n"
        "from tests.ggavatar.sweeps import test_backends as t\n"
        "from ggavatar.errors import InputError\n"
        "folder = pathlib.Path(sys.argv[1])\n"
        "import ray\n"
        "ray.init(num_cpus=2, num_gpus=1, include_dashboard=False, log_to_driver=False, logging_level='error')\n"
        "outcomes = t.RayCluster(gpus=0.5, retries=2).run(t.four_trainings(folder))\n"
        "found = {o.cell: [o.code, o.attempts] for o in outcomes}\n"
        "try:\n"
        "    list(t.RayCluster(gpus=8.0).run(t.four_trainings(folder)))\n"
        "except InputError as error:\n"
        "    found['refused'] = str(error)\n"
        "ray.shutdown()\n"
        "print(json.dumps(found))\n"
    )
    ran = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path)], capture_output=True, text=True, check=False, timeout=240
    )
    assert ran.returncode == 0, ran.stderr[-2000:]
    found = json.loads(ran.stdout.strip().split("\n")[-1])
    assert "8 GPUs" in found.pop("refused")
    assert found == {name: [outcome.code, outcome.attempts] for name, outcome in EXPECTED.items()}
    assert (tmp_path / "flaky.log").read_text() == "attempt 1\nattempt 2\nattempt 3\n"


def test_missing_ray_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install ggavatar\[ray\]"):
        list(RayCluster().run(four_trainings(tmp_path)))


class Recorder:
    """A backend that trains nothing: cells named after seed 8 fail, the others leave a finished run."""

    def __init__(self, shared: bool = True) -> None:
        self.trainings: list[CellTraining] = []
        self.shared = shared

    def run(self, trainings: Sequence[CellTraining]) -> Iterator[Outcome]:
        self.trainings += trainings
        for training in trainings:
            folder = Path(training.name)
            if folder.name == "seed-8":
                yield Outcome(training.name, 1, 2, "machine lost")
                continue
            if self.shared:
                folder.mkdir(parents=True)
                (folder / "provenance.json").write_text('{"finished": true}')
            yield Outcome(training.name, 0)


def arguments(capture: Path, output: Path, **changes: object) -> sweep.Arguments:
    return sweep.Arguments((capture,), output, seeds=(7, 8), train_only=True, **changes)  # type: ignore[arg-type]


def test_sweep_reports_cells_through_any_backend(
    toy_capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    backend = Recorder()
    monkeypatch.setattr(sweep, "make_backend", lambda _: backend)
    assert sweep.sweep(arguments(toy_capture.folder, tmp_path / "grid")) == 1
    shown = capsys.readouterr()
    assert "1 of 2 cells trained" in shown.out and "1 of 2: trained" in shown.out
    assert "failed with exit code 1 after 2 attempts" in shown.err and "machine lost" in shown.err
    train = backend.trainings[0].train
    assert isinstance(train, functools.partial) and train.func is sweep.train_cell
    assert train.args[0].folder.is_absolute() and train.args[0].capture.is_absolute()
    assert sweep.sweep(arguments(toy_capture.folder, tmp_path / "grid")) == 1
    assert len(backend.trainings) == 3, "what is finished is not trained again"


def test_results_must_be_on_a_shared_folder(
    toy_capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sweep, "make_backend", lambda _: Recorder(shared=False))
    assert sweep.sweep(arguments(toy_capture.folder, tmp_path / "grid")) == 1
    assert "all machines must share" in capsys.readouterr().err


def test_backends_are_chosen_and_their_flags_kept_apart(tmp_path: Path) -> None:
    assert sweep.make_backend(arguments(tmp_path, tmp_path, jobs=3, retries=1)) == LocalProcesses(3, 1)
    chosen = sweep.make_backend(arguments(tmp_path, tmp_path, backend="ray", gpus_per_job=0.5, retries=2))
    assert chosen == RayCluster(0.5, 1.0, 2)
    for wrong in ({"gpus_per_job": 1.0}, {"backend": "ray", "jobs": 2}, {"retries": -1}, {"jobs": 0}):
        with pytest.raises(InputError):
            sweep.make_backend(arguments(tmp_path, tmp_path, **wrong))


def test_a_log_that_exists_is_added_to(tmp_path: Path) -> None:
    for word in ("one", "two"):
        assert run_logged([sys.executable, "-c", f"print({word!r})"], tmp_path / "new" / "x.log") == 0
    assert (tmp_path / "new" / "x.log").read_text() == "one\ntwo\n"


RECORD = (
    "import os, pathlib, sys, time\n"
    "pathlib.Path(sys.argv[1]).write_text(os.environ['CUDA_VISIBLE_DEVICES'])\n"
    "time.sleep(0.3)\n"
)


def test_cells_that_run_side_by_side_see_different_gpus(tmp_path: Path) -> None:
    """Two devices: of four cells, two at a time, each sees one, and both are used."""
    trainings = [program(tmp_path, f"cell-{number}", RECORD, tmp_path / f"seen-{number}") for number in range(4)]
    assert [outcome.code for outcome in LocalProcesses(2, gpus=("3", "GPU-8f")).run(trainings)] == [0] * 4
    seen = [(tmp_path / f"seen-{number}").read_text() for number in range(4)]
    assert set(seen[:2]) == {"3", "GPU-8f"} and set(seen) == {"3", "GPU-8f"}


def test_cells_share_gpus_evenly_if_there_are_too_few() -> None:
    places = free_gpus(("0", "1"), 5)
    assert [places.get() for _ in range(places.qsize())] == ["0", "1", "0", "1", "0"]
    assert free_gpus((), 5).empty()


def test_gpus_are_those_that_the_sweep_sees(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "2, 5")
    assert sweep.visible_gpus(arguments(tmp_path, tmp_path, jobs=2)) == ("2", "5")
    assert sweep.visible_gpus(arguments(tmp_path, tmp_path, jobs=2, device="cpu")) == ()
    assert sweep.visible_gpus(arguments(tmp_path, tmp_path)) == ()
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES")
    monkeypatch.setattr("torch.cuda.device_count", lambda: 3)
    assert sweep.visible_gpus(arguments(tmp_path, tmp_path, jobs=2, device="cuda")) == ("0", "1", "2")


def test_a_ray_cell_asks_for_a_gpu_where_there_is_one(tmp_path: Path) -> None:
    class Cluster:
        def __init__(self, gpus: int) -> None:
            self.gpus = gpus

        def nodes(self) -> list[dict[str, object]]:
            return [{"Alive": True, "Resources": {"CPU": 4, "GPU": self.gpus}}]

    assert [RayCluster()._gpus_of_a_cell(Cluster(count)) for count in (0, 1, 8)] == [0.0, 1.0, 1.0]
    assert RayCluster(0.5)._gpus_of_a_cell(Cluster(1)) == 0.5
    assert sweep.make_backend(arguments(tmp_path, tmp_path, backend="ray", device="cpu")) == RayCluster(0.0, 1.0, 0)
