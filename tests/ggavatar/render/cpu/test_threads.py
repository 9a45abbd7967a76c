"""The compiled rasterizer gives the same bits whatever the threads do."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from torch import Tensor

from ggavatar.render.cpu import rasterizer
from tests.support.render_scenes import gradients, random_camera, random_gaussians


@pytest.fixture(autouse=True)
def _threads() -> Iterator[None]:
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def everything(seed: int = 0) -> dict[str, Tensor]:
    """Outputs and gradients of a scene of several chunks and tiles."""
    drawn, found = gradients(
        rasterizer.rasterize,
        random_gaussians(5000, 16, torch.float32, seed=seed),
        random_camera(150, 130, torch.float32),
    )
    outputs = {name: getattr(drawn, name).detach() for name in ("image", "alpha", "depth", "radii")}
    return found | outputs | {"positions": drawn.means2d.detach()}


@pytest.mark.parametrize("threads", [1, 2, 3, 4])
def test_any_number_of_threads_gives_the_same_bits(threads: int) -> None:
    torch.set_num_threads(1)
    expected = everything()
    assert {"pose", "background", "means2d", "colors"} <= expected.keys()
    torch.set_num_threads(threads)
    for _ in range(3):
        found = everything()
        assert all(torch.equal(found[name], expected[name]) for name in expected)


def test_two_rasterizers_in_two_threads() -> None:
    torch.set_num_threads(2)
    expected = [everything(seed) for seed in range(2)]
    found: dict[int, list[dict[str, Tensor]]] = {0: [], 1: []}

    def draw(seed: int) -> None:
        found[seed] = [everything(seed) for _ in range(4)]

    workers = [threading.Thread(target=draw, args=(seed,)) for seed in range(2)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    for seed, results in found.items():
        assert len(results) == 4
        for result in results:
            assert all(torch.equal(result[name], expected[seed][name]) for name in result)


# Torch's own parallel loops hang in a child whose parent has used them, so the child may only draw.
FORK = """
import os, sys, torch
sys.path.insert(0, sys.argv[1])
from tests.support.render_scenes import FIELDS, random_camera, random_gaussians
from ggavatar.render.cpu import rasterizer
torch.set_num_threads(2)
cloud, camera, white = random_gaussians(3000, 4, torch.float32), random_camera(300, 290, torch.float32), torch.ones(3)
incoming = torch.randn(290, 300, 3)
for name in FIELDS:
    getattr(cloud, name).requires_grad_()
def draw():
    drawn = rasterizer.rasterize(cloud, camera, white)
    return [drawn.image.detach().numpy().tobytes()] + [
        gradient.numpy().tobytes()
        for gradient in torch.autograd.grad(drawn.image, [getattr(cloud, name) for name in FIELDS], incoming)
    ]
before = draw()
child = os.fork()
if child == 0:
    os._exit(0 if draw() == before else 3)
status = os.waitpid(child, 0)[1]
sys.exit(0 if os.waitstatus_to_exitcode(status) == 0 and draw() == before else 4)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
def test_a_forked_child_draws_too() -> None:
    folder = str(Path(__file__).parents[4])
    done = subprocess.run(
        [sys.executable, "-c", FORK, folder], timeout=120, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
