"""Every kernel compiled for GPUs that are not here: it must fit into the registers of a thread (255, without spilling).

The launches that are compiled are those of a small scene, with its types and constants.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from tests.support.kernel_compiler import Launch, recorded_launches
from tests.support.render_scenes import gradients, random_camera, random_gaussians
from tests.support.triton_kernels import interpreted

pytestmark = interpreted
MOST_REGISTERS = {
    "project_gaussians": 80, "list_pairs": 32, "finish_lists": 32, "draw_tiles": 64,
    "differentiate_tiles": 232, "differentiate_gaussians": 168, "finish_pose": 64,
}  # fmt: skip
"""More would let fewer threads run at once; 65,536 are shared by the threads of a multiprocessor."""


@pytest.fixture(scope="module")
def launches() -> list[Launch]:
    from ggavatar.render.triton.rasterizer import TileRasterizer

    with recorded_launches() as found:
        for coefficients in (0, 16):
            cloud = random_gaussians(4, coefficients, torch.float32)
            gradients(TileRasterizer(), cloud, random_camera(8, 8, torch.float32))
    different: list[Launch] = []
    for launch in found:
        if launch not in different:
            different.append(launch)
    assert {launch.name for launch in different} == MOST_REGISTERS.keys()
    return different


@pytest.mark.parametrize("name", MOST_REGISTERS)
def test_kernels_compile_without_spilling(
    name: str, launches: list[Launch], registers_of: Callable[..., dict[str, int]]
) -> None:
    found = registers_of([launch for launch in launches if launch.name == name])
    assert found[name] <= MOST_REGISTERS[name]
