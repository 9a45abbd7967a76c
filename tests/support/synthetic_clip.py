"""A small synthetic subject: a skinned ball with a nose, its video, masks and metrical-tracker files."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from ggavatar.data.capture import Tracking
from ggavatar.head.files import save_head
from ggavatar.head.model import HeadModel
from ggavatar.io.images import write_png
from preprocess.formats.importers import metrical_tracker
from preprocess.formats.tracking_record import TrackingRecord
from preprocess.tracking.geometry.projection import posed_vertices, project, silhouette


def ball_head(version: str = "ball-1", expressions: int = 4) -> HeadModel:
    """An egg of 12 × 16 vertices with a nose towards +Z, a jaw joint and two eye joints."""
    rings, spokes = 12, 16
    theta = np.linspace(0.05, np.pi - 0.05, rings)[:, None]
    phi = np.linspace(0, 2 * np.pi, spokes, endpoint=False)[None]
    unit = np.stack((np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi, np.sin(theta) * np.cos(phi)), axis=-1)
    unit[rings // 2, 0, 2] *= 1.5
    unit[rings - 3 :, [1, 2, 3], 0] += 0.35
    template = (unit * [0.075, 0.11, 0.09]).reshape(-1, 3)
    quads = [(r * spokes + s, r * spokes + (s + 1) % spokes) for r in range(rings - 1) for s in range(spokes)]
    faces = [(a, a + spokes, b) for a, b in quads] + [(b, a + spokes, b + spokes) for a, b in quads]
    vertices, generator = len(template), np.random.default_rng(1)
    weights = np.zeros((vertices, 5))
    weights[:, 1] = 1
    low = (template[:, 1] < -0.04) & (template[:, 2] > 0)
    weights[low, 1], weights[low, 2] = 0.2, 0.8
    regressor = np.zeros((5, vertices))
    regressor[:, generator.integers(0, vertices, 5)] = 1 / 5
    lids = np.zeros((vertices, 3, 2))
    lids[(template[:, 0] > 0.02) & (template[:, 1] > 0.03), 1, 0] = -0.004
    lids[(template[:, 0] < -0.02) & (template[:, 1] > 0.03), 1, 1] = -0.004

    def tensor(array: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))

    return HeadModel(
        template=tensor(template),
        faces=torch.tensor(faces),
        expression_basis=tensor(generator.normal(0, 0.002, (vertices, 3, expressions))),
        pose_basis=tensor(np.zeros((vertices, 3, 0))),
        eyelid_basis=tensor(lids),
        joint_regressor=tensor(regressor),
        skinning_weights=tensor(weights),
        parents=(-1, 0, 1, 1, 1),
        joint_names=("root", "neck", "jaw", "left_eye", "right_eye"),
        version=version,
    )


def moving_record(count: int = 24, size: tuple[int, int] = (96, 96), expressions: int = 4) -> TrackingRecord:
    """A head that turns and sways in front of a still camera, as metrical-tracker would store it (the camera moves)."""
    width, height = size
    time = np.arange(count) / 4
    generator = np.random.default_rng(2)
    poses = np.tile(np.eye(4), (count, 1, 1))
    for row, moment in enumerate(time):
        yaw, roll = 0.5 * np.sin(moment), 0.2 * np.sin(1.3 * moment)
        turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
        tilt = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
        poses[row, :3, :3] = np.diag([1, -1, -1]) @ tilt @ turn
        poses[row, :3, 3] = [0.05 * np.sin(1.7 * moment), 0.02 * np.cos(moment), 1.0]
    focal = 3.2 * height
    intrinsics = np.tile(np.array([[focal, 0, width / 2 + 1], [0, focal, height / 2 - 1], [0, 0, 1.0]]), (count, 1, 1))
    joints = np.zeros((count, 5, 3))
    joints[:, 2, 0] = 0.2 * (1 - np.cos(3 * time))
    joints[:, 3:, 1] = 0.1 * np.sin(time)[:, None]
    return TrackingRecord(
        numbers=np.arange(count),
        width=width,
        height=height,
        intrinsics=intrinsics,
        world_to_camera=poses,
        expression=generator.normal(0, 1, (count, expressions)),
        joint_rotations=joints,
        eyelids=generator.uniform(0, 1, (count, 2)),
        translation=np.zeros((count, 3)),
        shape=np.zeros(3),
    )


def weak_perspective(count: int) -> TrackingRecord:
    """A record such as DECA's codes can hold."""
    record = moving_record(count, (224, 224))
    poses = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (count, 1, 1))
    poses[:, :3, 3] = [[0.01 * row, -0.02, 5000 / (112 * (8 + row))] for row in range(count)]
    intrinsics = np.tile(np.array([[5000.0, 0, 112], [0, 5000, 112], [0, 0, 1]]), (count, 1, 1))
    joints = record.joint_rotations.copy()
    joints[:, 0] = [0.1, 0.2, 0.0]
    joints[:, 3:] = 0
    return dataclasses.replace(record, world_to_camera=poses, intrinsics=intrinsics, joint_rotations=joints)


def still_camera(count: int, size: tuple[int, int], focal: float) -> TrackingRecord:
    """A head moved by FLAME's root and translation in front of a camera at (0, 0, 1), its center in the middle."""
    record = moving_record(count, size)
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 1
    joints = record.joint_rotations.copy()
    joints[:, 0] = [[0.1, 0.2 * np.sin(row), 0.05] for row in range(count)]
    joints[:, 1] = [0.02, -0.1, 0.0]
    return dataclasses.replace(
        record,
        joint_rotations=joints,
        translation=np.array([[0.01 * np.cos(row), 0.002 * row, 0.0] for row in range(count)]),
        world_to_camera=np.tile(pose, (count, 1, 1)),
        intrinsics=np.tile([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1.0]], (count, 1, 1)),
    )


def sheap_record(count: int) -> TrackingRecord:
    """A record such as SHeaP's dictionary can hold."""
    return still_camera(count, (224, 224), 112 / np.tan(np.radians(14.2539 / 2)))


def as_tracking(record: TrackingRecord) -> Tracking:
    names = ("intrinsics", "world_to_camera", "expression", "joint_rotations", "eyelids", "translation")
    return Tracking(**{name: getattr(record, name) for name in names})


def draw(head: HeadModel, record: TrackingRecord, row: int) -> tuple[np.ndarray, np.ndarray]:
    """An image [H, W, 3] and mask [H, W] of one frame: a shaded head on a striped wall."""
    pixels, depth = project(
        posed_vertices(head, as_tracking(record), row), record.intrinsics[row], record.world_to_camera[row]
    )
    mask = silhouette(pixels, depth, head.faces.numpy(), (record.width, record.height))
    image = np.zeros((record.height, record.width, 3), np.uint8)
    image[:, :, 1] = (np.arange(record.width) // 8 % 2 * 60 + 60)[None]
    image[mask] = [200, 120, 90]
    for vertex in np.flatnonzero((head.template[:, 2] > 0.02).numpy()):
        x, y = (round(float(place)) for place in pixels[vertex])
        image[max(0, y - 1) : y + 2, max(0, x - 1) : x + 2] = [40 + 50 * (vertex % 4), 30, 200 - 40 * (vertex % 5)]
    image[~mask, 0] = 0
    return image, mask.astype(np.uint8) * 255


def write_video(path: Path, images: list[np.ndarray], rate: int = 25, codec: str = "libx264", **options: str) -> None:
    """An mp4 of RGB images with next to no loss."""
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=rate, options={"crf": "12", **options})
        stream.width, stream.height = images[0].shape[1], images[0].shape[0]
        stream.pix_fmt = "yuv420p"
        for image in images:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())


@dataclass(frozen=True)
class Clip:
    """A user's data on disk."""

    folder: Path
    head: HeadModel
    record: TrackingRecord

    @property
    def arguments(self) -> list[str]:
        """The command line that makes a capture of it, without -o."""
        names = ("video.mp4", "tracking", "masks", "head.npz")
        video, tracking, masks, head = (str(self.folder / name) for name in names)
        return [video, "--tracking", tracking, "--masks", masks, "--head-model", head, "--size", "96"]


def make_clip(folder: Path, count: int = 24, size: tuple[int, int] = (96, 96)) -> Clip:
    """Write video.mp4, masks, tracking and head.npz."""
    head, record = ball_head(), moving_record(count, size)
    folder.mkdir(parents=True, exist_ok=True)
    drawn = [draw(head, record, row) for row in range(count)]
    write_video(folder / "video.mp4", [image for image, _ in drawn])
    for row, (_, mask) in enumerate(drawn):
        write_png(folder / "masks" / f"{row:05d}.png", mask)
    metrical_tracker.write(folder / "tracking", record)
    save_head(head, folder / "head.npz")
    return Clip(folder, head, record)
