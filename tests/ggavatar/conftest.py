"""A toy capture: an egg that opens its mouth and turns, 24 frames of 48×48 px, rendered by the reference rasterizer."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from ggavatar.core import Camera, Drive, Gaussians
from ggavatar.data.capture import Capture, Tracking
from ggavatar.data.splits import Split
from ggavatar.geometry.transforms import axis_angle_to_matrix, matrix_to_quaternion, rigid
from ggavatar.geometry.triangles import triangle_frames
from ggavatar.head.model import HeadModel
from ggavatar.render.reference import rasterize

SIZE, FRAMES, EXPRESSIONS = 48, 24, 3
JOINTS = ("root", "neck", "jaw", "left_eye", "right_eye")


def egg(rings: int = 7, sides: int = 10) -> HeadModel:
    """A closed egg of 10 cm with five joints, a jaw region and three expressions."""
    polar = torch.linspace(0, torch.pi, rings + 2)[1:-1]
    around = torch.arange(sides) * (2 * torch.pi / sides)
    ring = torch.stack(torch.meshgrid(polar, around, indexing="ij"), dim=-1).reshape(-1, 2)
    points = torch.stack(
        (ring[:, 0].sin() * ring[:, 1].sin(), ring[:, 0].cos(), ring[:, 0].sin() * ring[:, 1].cos()), dim=-1
    )
    points = torch.cat((points, torch.tensor([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]))) * torch.tensor([0.08, 0.1, 0.08])
    top, bottom = rings * sides, rings * sides + 1
    faces = []
    for side in range(sides):
        after = (side + 1) % sides
        faces.append((top, side, after))
        for row in range(rings - 1):
            a, b, c, d = row * sides + side, row * sides + after, (row + 1) * sides + side, (row + 1) * sides + after
            faces += [(a, c, b), (b, c, d)]
        faces.append((bottom, (rings - 1) * sides + after, (rings - 1) * sides + side))
    count = len(points)
    front = torch.sigmoid(points[:, 2] * 60) * torch.sigmoid(-points[:, 1] * 60)
    basis = torch.zeros(count, 3, EXPRESSIONS)
    basis[:, 1, 0], basis[:, 2, 1], basis[:, 0, 2] = -0.02 * front, 0.02 * front, 0.01 * front
    weights = torch.zeros(count, 5)
    weights[:, 2] = 0.6 * front
    weights[:, 1] = 1 - weights[:, 2]
    return HeadModel(
        template=points,
        faces=torch.tensor(faces),
        expression_basis=basis,
        pose_basis=torch.zeros(count, 3, 0),
        eyelid_basis=torch.zeros(count, 3, 2),
        joint_regressor=torch.full((5, count), 1 / count),
        skinning_weights=weights,
        parents=(-1, 0, 1, 1, 1),
        joint_names=JOINTS,
        version="egg-1",
        regions={"mouth": front.topk(6).indices},
    )


def head_arrays(head: HeadModel) -> dict[str, np.ndarray]:
    """A head as the arrays of head.npz."""
    names = (
        "template",
        "faces",
        "expression_basis",
        "pose_basis",
        "eyelid_basis",
        "joint_regressor",
        "skinning_weights",
    )
    arrays = {name: getattr(head, name).numpy() for name in names}
    arrays |= {
        "parents": np.array(head.parents),
        "joint_names": np.array(head.joint_names),
        "version": np.array(head.version),
    }
    return arrays | {f"region/{name}": rows.numpy() for name, rows in head.regions.items()}


def toy_tracking() -> Tracking:
    """A slow turn with a talking mouth."""
    time = torch.linspace(0, 1, FRAMES)
    expression = torch.stack((torch.sin(17 * time), torch.sin(11 * time), torch.cos(23 * time)), dim=1)
    joints = torch.zeros(FRAMES, 5, 3)
    joints[:, 2, 0] = 0.2 * (1 + torch.sin(13 * time))
    axes = torch.stack((torch.zeros_like(time), 0.5 * torch.sin(6 * time), torch.zeros_like(time)), dim=1)
    flip = torch.diag(torch.tensor([1.0, -1.0, -1.0]))
    views = torch.stack([rigid(flip @ axis_angle_to_matrix(axis), torch.tensor([0.0, 0.0, 0.8])) for axis in axes])
    intrinsics = torch.tensor([[2.6 * SIZE, 0, SIZE / 2], [0, 2.6 * SIZE, SIZE / 2], [0, 0, 1]]).expand(FRAMES, 3, 3)
    arrays = {"intrinsics": intrinsics, "world_to_camera": views, "expression": expression, "joint_rotations": joints}
    arrays |= {"eyelids": torch.zeros(FRAMES, 2), "translation": torch.zeros(FRAMES, 3)}
    return Tracking(**{name: value.numpy().copy() for name, value in arrays.items()})


def paint(head: HeadModel, drive: Drive, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """The egg in colors that change with the mouth, 8-bit, and its coverage."""
    frames = triangle_frames(head.vertices(drive), head.faces)
    x, y, z = triangle_frames(head.neutral(), head.faces).centers.unbind(-1)
    colors = torch.stack((0.5 + 4 * x, 0.5 + 4 * y, 0.5 + 0.3 * torch.sin(80 * x + 60 * z)), dim=-1)
    colors = (colors + 0.1 * drive.expression[0] * (z > 0)[:, None]).clamp(0, 1)
    scales = frames.scales[:, None] * torch.tensor([0.45, 0.08, 0.45])
    quats = matrix_to_quaternion(frames.rotations)
    drawn = rasterize(
        Gaussians(frames.centers, quats, scales, torch.full_like(x, 0.98), colors), camera, torch.zeros(3)
    )
    coverage = drawn.alpha.clamp_min(1e-6)
    image = (drawn.image / coverage).clamp(0, 1)
    return (image * 255).round().to(torch.uint8).numpy(), (drawn.alpha[..., 0] * 255).round().to(torch.uint8).numpy()


@pytest.fixture(scope="session")
def toy_head() -> HeadModel:
    """The egg."""
    return egg()


@pytest.fixture(scope="session")
def toy_capture(tmp_path_factory: pytest.TempPathFactory, toy_head: HeadModel) -> Capture:
    """The toy capture, opened; tests must not change it."""
    tracking = toy_tracking()
    numbers = tuple(range(3, 3 + FRAMES))
    images = []
    for row in range(FRAMES):
        values = {name: torch.from_numpy(value[row]) for name, value in tracking.arrays().items()}
        view = values["world_to_camera"]
        drive = Drive(values["expression"], values["joint_rotations"], values["eyelids"], values["translation"], view)
        images.append(paint(toy_head, drive, Camera(values["intrinsics"], view, SIZE, SIZE)))
    test = numbers[::5]
    split = Split(tuple(number for number in numbers if number not in test), test)
    folder = Path(tmp_path_factory.mktemp("toy")) / "egg capture"
    described = Capture(folder, "egg", SIZE, SIZE, 25.0, numbers, {"every-20th": split}, tracking, toy_head.version)
    described.write(images, head_arrays(toy_head))
    return Capture.open(folder)


@pytest.fixture
def registers_of(
    record_property: Callable[[str, object], None], capsys: pytest.CaptureFixture[str]
) -> Callable[[list[Any]], dict[str, int]]:
    """Compile launches for A100, RTX 4090 and H100; the most registers by kernel, and nothing may be spilled."""
    from tests.support.kernel_compiler import compiled

    def compile_all(launches: list[Any]) -> dict[str, int]:
        most: dict[str, int] = {}
        for result in compiled(launches, (80, 89, 90)):
            line = f"{result['kernel']} sm_{result['target']} {result['constants']}: {result['registers']} registers"
            record_property("kernel", line)
            with capsys.disabled():
                sys.stdout.write(f"\n{line}")
            assert result["spilled"] == 0, f"{line}, {result['spilled']} bytes spilled"
            most[result["kernel"]] = max(most.get(result["kernel"], 0), result["registers"])
        return most

    return compile_all
