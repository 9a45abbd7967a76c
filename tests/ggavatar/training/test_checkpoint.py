"""Checkpoints survive truncated files and full disks, restore a training exactly, and hold nothing executable."""

from __future__ import annotations

import errno
import json
from pathlib import Path

import pytest
import torch

from ggavatar.errors import InputError
from ggavatar.training import checkpoint
from ggavatar.training.checkpoint import (
    complete_steps,
    load_checkpoint,
    pack,
    save_checkpoint,
    unpack_avatar,
    unpack_optimizers,
)


def save(folder: Path, *steps: int) -> None:
    for step in steps:
        save_checkpoint(folder, step, {"x": torch.full((3,), float(step))}, {"note": step})


def test_round_trip_is_exact(tmp_path: Path) -> None:
    tensors = {"a": torch.randn(4, 3, generator=torch.Generator().manual_seed(0)), "b": torch.arange(5)}
    save_checkpoint(tmp_path, 7, tensors, {"seconds": 1.5})
    loaded, record = load_checkpoint(tmp_path)
    assert all(torch.equal(loaded[name], value) for name, value in tensors.items())
    assert (record["step"], record["seconds"]) == (7, 1.5)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["step-000000007.json", "step-000000007.safetensors"]


def test_two_newest_are_kept(tmp_path: Path) -> None:
    save(tmp_path, 1, 2, 3, 4)
    assert complete_steps(tmp_path, limit=None) == [4, 3]


@pytest.mark.parametrize("damage", ["truncate", "flip", "no_tensors", "no_json", "torn_json"])
def test_torn_checkpoint_is_skipped_for_the_last_valid_one(tmp_path: Path, damage: str) -> None:
    save(tmp_path, 1, 2)
    tensors = tmp_path / "step-000000002.safetensors"
    data = tensors.read_bytes()
    if damage == "truncate":
        tensors.write_bytes(data[:-4])
    elif damage == "flip":
        tensors.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    elif damage == "no_tensors":
        tensors.unlink()
    elif damage == "no_json":
        tensors.with_suffix(".json").unlink()
    else:
        tensors.with_suffix(".json").write_text('{"step": 2, "byt')
    assert complete_steps(tmp_path) == [1]
    assert float(load_checkpoint(tmp_path)[0]["x"][0]) == 1.0


def test_missing_checkpoint_names_those_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no complete checkpoint"):
        load_checkpoint(tmp_path)
    (tmp_path / "step-000000003.json").write_text("{}")
    with pytest.raises(InputError, match="only damaged ones"):
        load_checkpoint(tmp_path)
    save(tmp_path, 5)
    with pytest.raises(InputError, match="complete checkpoints: 5"):
        load_checkpoint(tmp_path, 6)


def test_not_safetensors_is_refused(tmp_path: Path) -> None:
    import hashlib

    data = b"\x80\x04cos\nsystem\n."
    (tmp_path / "step-000000001.safetensors").write_bytes(data)
    record = {"step": 1, "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    (tmp_path / "step-000000001.json").write_text(json.dumps(record))
    with pytest.raises(InputError, match="not a safetensors file"):
        load_checkpoint(tmp_path)


def test_full_disk_leaves_no_half_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save(tmp_path, 1)

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space left"):
        save(tmp_path, 2)
    monkeypatch.undo()
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".json", ".safetensors"]
    assert complete_steps(tmp_path) == [1]


def test_training_state_resumes_bit_identically(tmp_path: Path) -> None:
    """Compared with the same model trained without interruption."""

    def make() -> tuple[torch.nn.Module, list[torch.optim.Optimizer]]:
        torch.manual_seed(0)
        model = torch.nn.Linear(3, 2)
        return model, [torch.optim.Adam([model.weight], lr=0.1), torch.optim.SGD([model.bias], lr=0.1, momentum=0.9)]

    def advance(model: torch.nn.Module, optimizers: list[torch.optim.Optimizer], steps: int) -> None:
        for _ in range(steps):
            (model(torch.ones(4, 3)) ** 2).sum().backward()
            for optimizer in optimizers:
                optimizer.step()
                optimizer.zero_grad()

    straight, broken, fresh = make(), make(), make()
    advance(*straight, 6)
    advance(*broken, 3)
    tensors, rest = pack(*broken)
    save_checkpoint(tmp_path, 3, tensors, {"optimizers": rest})
    loaded, record = load_checkpoint(tmp_path)
    unpack_avatar(fresh[0], loaded)
    unpack_optimizers(fresh[1], loaded, record["optimizers"])
    advance(*fresh, 3)
    assert torch.equal(straight[0].weight, fresh[0].weight) and torch.equal(straight[0].bias, fresh[0].bias)


def test_checkpoint_of_another_method_is_refused() -> None:
    with pytest.raises(InputError, match="does not match"):
        unpack_avatar(torch.nn.Linear(2, 2), {"avatar.other": torch.zeros(1)})
    with pytest.raises(InputError, match="optimizers"):
        unpack_optimizers([], {}, [{}])


def test_kept_count_is_at_least_two() -> None:
    assert checkpoint.KEPT_CHECKPOINTS >= 2
