"""Stored avatars are built within the memory that their tensors justify. Reference: sizes of tensors by arithmetic."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import pytest
import torch
from torch import Tensor, nn

from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.training import build_budget, run_folder
from ggavatar.training.build_budget import BuildBudget, BuildTooLargeError, within_budget
from ggavatar.training.registry import load
from ggavatar.training.run_folder import RunConfig, assembled_run
from tests.support.untrained_avatars import untrained

MANY = 10**9
LARGE: dict[str, Callable[[], object]] = {
    "zeros": lambda: torch.zeros(MANY, MANY),
    "random": lambda: torch.randn(2, MANY, generator=torch.Generator()),
    "a layer": lambda: nn.Linear(MANY, 64),
    "a range": lambda: torch.arange(0, MANY, 1, dtype=torch.float64),
    "a grid": lambda: torch.meshgrid(torch.arange(1000), torch.arange(1000), indexing="ij")[0].contiguous(),
    "identity": lambda: torch.eye(100_000),
    "a copy of one value": lambda: torch.zeros(1).expand(MANY).clone(),
    "repeated": lambda: torch.zeros(3).repeat_interleave(MANY),
    "scaled up": lambda: nn.functional.interpolate(torch.zeros(1, 1, 2, 2), size=(100_000, 100_000)),
    "many small layers": lambda: [nn.Linear(1, 1) for _ in range(MANY)],
    "many values": lambda: [torch.zeros(200, 200) for _ in range(MANY)],
}


@pytest.mark.parametrize("what", LARGE)
def test_nothing_large_is_made(what: str) -> None:
    """A thousand times what this machine has: it cannot have been made."""
    with pytest.raises(BuildTooLargeError, match="more than the 1 MiB"), BuildBudget(1 << 20):
        LARGE[what]()


def test_what_fits_is_made_as_without_a_budget() -> None:
    def make() -> tuple[Tensor, ...]:
        torch.manual_seed(3)
        network = nn.Sequential(nn.Linear(300, 64), nn.ReLU(), nn.Linear(64, 3))
        values = torch.randn(400, 300, generator=torch.Generator().manual_seed(1))
        values[values[:, 0] > 0] = 0.5
        return network(values), values.nonzero(), values.expand(2, 400, 300).sum(0), torch.linspace(0, 1, 300)

    assert all(torch.equal(*pair) for pair in zip(within_budget([], make), make(), strict=True))


def test_the_budget_grows_with_what_was_stored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build_budget, "FREE_BYTES", 0)
    stored = torch.zeros(1 << 18)  # 1 MiB, so that 16 MiB may be made
    assert within_budget([stored], lambda: torch.zeros(3 << 20)).shape == (3 << 20,)
    with pytest.raises(BuildTooLargeError, match="more than the 16 MiB"):
        within_budget([stored], lambda: torch.zeros(5 << 20))


def test_a_run_whose_settings_were_changed_is_refused(toy_capture: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its network would have 40 GB."""
    avatar, _ = untrained("flash_avatar", toy_capture, 100)
    tensors = {f"avatar.{name}": value for name, value in avatar.state_dict().items()}
    method = load("flash_avatar").config("default")
    config = RunConfig("flash_avatar", "", method_config=dataclasses.asdict(method) | {"hidden": 100_000})
    split = next(iter(toy_capture.splits.values()))
    stored = run_folder.StoredAvatar(config, toy_capture, avatar.head, split, tensors, 1)
    with pytest.raises(BuildTooLargeError):
        assembled_run(toy_capture.folder, stored, "cpu", "auto", {}, "")
    monkeypatch.setattr(run_folder, "load_head", lambda _: avatar.head)
    monkeypatch.setattr(run_folder, "read_config", lambda _: config)
    monkeypatch.setattr(run_folder, "read_split", lambda _: split)
    monkeypatch.setattr(run_folder, "_read_run_file", lambda _: {})
    with pytest.raises(InputError, match=r"config\.json: expected settings of the checkpoint"):
        run_folder.run_with_tensors(toy_capture.folder, toy_capture, tensors, (1, ""), "cpu", "auto")
