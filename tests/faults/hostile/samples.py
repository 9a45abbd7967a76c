"""A small valid file of every format that is read on its own, as bytes by file name."""

from __future__ import annotations

import io
import json
import os
import pickle
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numpy as np

from tests.support.splat_samples import SPLATS

ARRAYS: Mapping[str, np.ndarray] = {
    "a": np.arange(50.0),
    "b": np.array("text"),
    "c": np.zeros((3, 4, 5), np.float32),
}
BUNDLE, NETWORK = "face_landmarker.task", "selfiesegmentation_mlkit_256.f16.tflite"
"""Networks that are read where $GGAVATAR_MODELS has them."""
_MODELS = Path(os.environ.get("GGAVATAR_MODELS", "models"))
COUNT = 4
"""Frames of a sample."""


def npz(arrays: Mapping[str, np.ndarray], compressed: bool = False) -> bytes:
    """An archive as numpy writes it."""
    stream = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(stream, **arrays)
    return stream.getvalue()


def npy(array: np.ndarray) -> bytes:
    """One array as numpy writes it."""
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def image(suffix: str) -> bytes:
    """A picture of 24 × 32 px."""
    pixels = np.random.default_rng(0).integers(0, 255, (24, 32, 3), dtype=np.uint8)
    done, data = cv2.imencode(suffix, pixels)
    assert done
    return data.tobytes()


def video(suffix: str) -> bytes:
    """Ten frames of 48 × 64 px."""
    from tests.support.synthetic_clip import write_video

    images = [np.full((48, 64, 3), 20 * number, np.uint8) for number in range(10)]
    codec = "libvpx-vp9" if suffix == ".webm" else "libx264"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"video{suffix}"
        write_video(path, images, codec=codec)
        return path.read_bytes()


def torch_file(legacy: bool) -> bytes:
    """Tensors by name, in torch's zip or in the stream of older versions."""
    import torch

    stream = io.BytesIO()
    tensors = {"weight": torch.arange(24.0).reshape(4, 6), "bias": torch.ones(3, dtype=torch.float16)}
    torch.save(tensors, stream, _use_new_zipfile_serialization=not legacy)
    return stream.getvalue()


def safetensors() -> bytes:
    """The same as safetensors."""
    import torch
    from safetensors.torch import save

    return save({"weight": torch.arange(24.0).reshape(4, 6), "bias": torch.ones(3)})


def plain_pickle() -> bytes:
    """What a tracker pickles for a frame."""
    values = {"exp": np.zeros(10, np.float32), "pose": np.eye(3), "name": "x", "list": [1, 2.5, None, ("a", b"b")]}
    return pickle.dumps(values, 2)


def flame(suffix: str) -> bytes:
    """A model in FLAME's layout with made-up numbers."""
    from tests.support.flame_files import flame_values, write_model

    values = flame_values()
    values["shapedirs"] = values["shapedirs"][:, :, :320]
    if suffix == ".npz":
        return npz(values)
    with tempfile.TemporaryDirectory() as folder:
        write_model(Path(folder) / "model.pkl", values)
        return (Path(folder) / "model.pkl").read_bytes()


def own_head() -> bytes:
    """A head.npz."""
    from ggavatar.head.files import save_head
    from tests.support.synthetic_clip import ball_head

    with tempfile.TemporaryDirectory() as folder:
        save_head(ball_head(), Path(folder) / "head.npz")
        return (Path(folder) / "head.npz").read_bytes()


def recording(suffix: str) -> bytes:
    """Scores of five moments, in each of the three kinds."""
    from ggavatar.formats.arkit_recording import ARKIT_NAMES

    scores = np.random.default_rng(0).uniform(0, 1, (5, len(ARKIT_NAMES)))
    if suffix == ".npz":
        return npz({"names": np.array(ARKIT_NAMES), "scores": scores, "fps": np.array(30.0)})
    if suffix == ".json":
        listed = [{"weights": row.tolist(), "time": number / 30} for number, row in enumerate(scores)]
        return json.dumps({"names": list(ARKIT_NAMES), "frames": listed}).encode()
    names = [name[0].upper() + name[1:] for name in ARKIT_NAMES]
    lines = [",".join(["Timecode", "BlendShapeCount", *names])]
    for number, row in enumerate(scores):
        lines.append(",".join([f"00:00:00:{number:02d}.000", "52", *(f"{value:.6f}" for value in row)]))
    return "\r\n".join(lines).encode()


def flame_parameters() -> bytes:
    """The flame_param.npz of a trained GaussianAvatars."""
    widths = {"rotation": 3, "neck_pose": 3, "jaw_pose": 3, "eyes_pose": 6, "translation": 3}
    arrays = {name: np.zeros((COUNT, width), np.float32) for name, width in widths.items()}
    return npz(arrays | {"shape": np.zeros(300, np.float32), "expr": np.zeros((COUNT, 100), np.float32)})


def driving() -> bytes:
    """Head parameters that drive an avatar."""
    names = np.array(["root", "neck", "jaw", "left_eye", "right_eye"])
    arrays = {"expression": np.zeros((COUNT, 4)), "joint_rotations": np.zeros((COUNT, 5, 3)), "joint_names": names}
    return npz(arrays | {"version": np.array("ball-1"), "eyelids": np.zeros((COUNT, 2))})


def results() -> bytes:
    """A metrics.json."""
    from evaluate.protocols.results import to_json
    from tests.support.evaluations import evaluation

    return to_json(evaluation("ball", "ggavatar").as_dict()).encode()


def baseline() -> bytes:
    """A baseline file."""
    from evaluate.gates.baselines import write_baseline
    from tests.support.evaluations import evaluation

    with tempfile.TemporaryDirectory() as folder:
        write_baseline(Path(folder) / "baseline.json", [evaluation("ball", "ggavatar")])
        return (Path(folder) / "baseline.json").read_bytes()


def _split() -> bytes:
    return json.dumps({"train": [0, 1, 2, 3], "test": [4, 5]}).encode()


def _object() -> bytes:
    content = {"schema": "x", "frames": list(range(30)), "nested": {"a": [1.5, None, "é"]}}
    return json.dumps(content, ensure_ascii=False).encode()


FILES: dict[str, Callable[[], bytes]] = {
    **SPLATS,
    "plain.npz": lambda: npz(ARRAYS),
    "packed.npz": lambda: npz(ARRAYS, compressed=True),
    "array.npy": lambda: npy(np.arange(24.0).reshape(4, 6)),
    "object.json": _object,
    "picture.png": lambda: image(".png"),
    "picture.jpg": lambda: image(".jpg"),
    "video.mp4": lambda: video(".mp4"),
    "video.webm": lambda: video(".webm"),
    "video.mkv": lambda: video(".mkv"),
    "video.avi": lambda: video(".avi"),
    "frame.frame": plain_pickle,
    "zip.pt": lambda: torch_file(legacy=False),
    "legacy.pth": lambda: torch_file(legacy=True),
    "weights.safetensors": safetensors,
    "generic_model.pkl": lambda: flame(".pkl"),
    "flame.npz": lambda: flame(".npz"),
    "head.npz": own_head,
    "take.csv": lambda: recording(".csv"),
    "take.json": lambda: recording(".json"),
    "take.npz": lambda: recording(".npz"),
    "flame_param.npz": flame_parameters,
    "driving.npz": driving,
    "metrics.json": results,
    "baseline.json": baseline,
    "split.json": _split,
}
"""Content by file name."""
FILES |= {name: (_MODELS / name).read_bytes for name in (BUNDLE, NETWORK) if (_MODELS / name).is_file()}

READERS_OF: dict[str, tuple[str, ...]] = {
    **{name: ("gaussians",) for name in SPLATS},
    "plain.npz": ("npz",),
    "packed.npz": ("npz",),
    "array.npy": ("npy",),
    "object.json": ("json",),
    "picture.png": ("picture",),
    "picture.jpg": ("picture",),
    "video.mp4": ("frames",),
    "video.webm": ("frames",),
    "video.mkv": ("frames",),
    "video.avi": ("frames",),
    "frame.frame": ("pickle",),
    "zip.pt": ("pickle", "weights"),
    "legacy.pth": ("pickle", "weights"),
    "weights.safetensors": ("weights",),
    "generic_model.pkl": ("head",),
    "flame.npz": ("head",),
    "head.npz": ("head",),
    "take.csv": ("recording",),
    "take.json": ("recording",),
    "take.npz": ("recording",),
    "flame_param.npz": ("parameters",),
    "driving.npz": ("driving",),
    "metrics.json": ("results", "eval-results"),
    "baseline.json": ("baseline",),
    "split.json": ("split-file",),
    **{name: ("landmark-networks",) for name in (BUNDLE, NETWORK) if name in FILES},
}
"""Readers by file name."""
