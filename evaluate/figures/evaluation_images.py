"""An evaluation together with the pictures it was measured on: what figures and reports are made of."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from evaluate.metrics.catalogue import metric_of
from evaluate.protocols.method_names import display_name
from evaluate.protocols.results import Evaluation
from evaluate.scoring.frame_files import find_frame
from ggavatar.errors import InputError
from ggavatar.io.images import read_rgb


@dataclass(frozen=True)
class EvaluationImages:
    """One method on one subject, with its pictures.

    Attributes:
        evaluation: Numbers and protocol.
        predictions: Folder of renders.
        truth: Folder of ground truth.
        fps: Frames per second of the source video.
        faces: Folders of masks of the face and its parts, which may be missing.
    """

    evaluation: Evaluation
    predictions: Path
    truth: Path
    fps: float = 25.0
    faces: tuple[Path, ...] = ()

    @staticmethod
    def in_folder(evaluation: Evaluation, home: Path) -> EvaluationImages:
        """Pictures and frame rate where `evaluate.scoring.predict` wrote them."""
        try:
            fps = float(json.loads((home / "predict.json").read_text(encoding="utf-8"))["identity"]["fps"])
        except (OSError, ValueError, KeyError, TypeError):
            fps = 25.0
        faces = tuple(home / "regions" / name for name in ("face", "mouth", "eyes"))
        return EvaluationImages(evaluation, home / "predictions", home / "ground_truth", fps, faces)

    def pair(self, frame: int) -> tuple[UInt8[np.ndarray, "H W 3"], UInt8[np.ndarray, "H W 3"]]:
        """Render and ground truth of a frame; `InputError` if one is missing or they differ in size."""
        render, truth = read_rgb(find_frame(self.predictions, frame)), read_rgb(find_frame(self.truth, frame))
        if render.shape != truth.shape:
            raise InputError(
                f"{self.predictions}: frame {frame} has another size than the ground truth; evaluate again"
            )
        return render, truth


def display_names(shown: Sequence[EvaluationImages]) -> list[str]:
    """Distinct labels: the method, with its seed or a number where several share one."""
    methods = [display_name(one.evaluation.method) for one in shown]
    labels = []
    for index, one in enumerate(shown):
        method, seed = methods[index], one.evaluation.seed
        label = method if methods.count(method) == 1 or seed is None else f"{method} (seed {seed})"
        labels.append(label if label not in labels else f"{label} #{index + 1}")
    return labels


def measured_metrics(shown: Sequence[EvaluationImages]) -> list[str]:
    """Columns with at least one value, in the order of the protocol."""
    columns = dict.fromkeys(name for one in shown for name in one.evaluation.protocol.columns)
    return [name for name in columns if any(_any_value(one.evaluation, name) for one in shown)]


def _any_value(evaluation: Evaluation, name: str) -> bool:
    return any(value is not None for value in evaluation.values.get(name, ()))


def worst_frames(shown: Sequence[EvaluationImages], count: int, metric: str = "psnr") -> list[int]:
    """Frames of the first evaluation with the worst values, the worst first; identical frames come last."""
    evaluation = shown[0].evaluation
    values = evaluation.values.get(metric, ())
    sign = 1.0 if metric_of(metric).higher_is_better else -1.0
    known = [
        (sign * value, frame) for value, frame in zip(values, evaluation.frames, strict=False) if value is not None
    ]
    return [frame for _, frame in sorted(known)[:count]]
