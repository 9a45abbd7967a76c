"""The type of hidden layers against what LLVM says of the processor."""

from __future__ import annotations

import pytest
import torch

from ggavatar.jit import bfloat16


@pytest.mark.parametrize(
    ("features", "expected"),
    [
        ({"avx512bf16": True, "avx2": True}, torch.bfloat16),
        ({"amx-bf16": True}, torch.bfloat16),
        ({"avx512f": True, "avx512bf16": False}, torch.float32),
        ({}, torch.float32),
    ],
)
def test_bfloat16_where_there_are_instructions_for_it(
    features: dict[str, bool], expected: torch.dtype, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("llvmlite.binding.get_host_cpu_features", lambda: features)
    bfloat16._has_bfloat16_products.cache_clear()
    assert bfloat16.matmul_dtype(torch.device("cpu")) == expected
    assert bfloat16.matmul_dtype(torch.device("meta")) == torch.float32
    bfloat16._has_bfloat16_products.cache_clear()


def test_whole_groups_hold_the_wanted_rows_first() -> None:
    wanted = torch.tensor([False, True, False, False, True, True, False])
    assert bfloat16.padded_indices(wanted, 2).tolist() == [1, 4, 5, 0]
    assert bfloat16.padded_indices(wanted, 3).tolist() == [1, 4, 5]
    assert bfloat16.padded_indices(wanted, 100).tolist() == [1, 4, 5, 0, 2, 3, 6]
    assert bfloat16.padded_indices(wanted & ~wanted, 4).tolist() == []
