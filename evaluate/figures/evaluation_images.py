"""Evaluations together with the images they were measured on, the input of figures and reports."""

from __future__ import annotations

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
from ggavatar.io.json_files import read_json

DEFAULT_FPS = 25.0


@dataclass(frozen=True)
class EvaluationImages:
    """One method on one subject, with its images.

    Attributes:
        evaluation: Scores and protocol.
        predictions: Folder of predictions.
        truth: Folder of ground truth.
        fps: Frames per second of the source video.
        face_masks: Folders of masks of the face and its parts, which may be missing.
    """

    evaluation: Evaluation
    predictions: Path
    truth: Path
    fps: float = DEFAULT_FPS
    face_masks: tuple[Path, ...] = ()

    @staticmethod
    def in_folder(evaluation: Evaluation, home: Path) -> EvaluationImages:
        """Images and frame rate from a folder written by `evaluate.scoring.predict`."""
        try:
            fps = float(read_json(home / "predict.json")["identity"]["fps"])
        except (OSError, ValueError, KeyError, TypeError):
            fps = DEFAULT_FPS
        face_masks = tuple(home / "regions" / name for name in ("face", "mouth", "eyes"))
        return EvaluationImages(evaluation, home / "predictions", home / "ground_truth", fps, face_masks)

    def pair(self, frame: int) -> tuple[UInt8[np.ndarray, "H W 3"], UInt8[np.ndarray, "H W 3"]]:
        """Prediction and ground truth of a frame; `InputError` if one is missing or they differ in size."""
        prediction, truth = read_rgb(find_frame(self.predictions, frame)), read_rgb(find_frame(self.truth, frame))
        if prediction.shape != truth.shape:
            raise InputError(
                f"{self.predictions}: frame {frame} has another size than the ground truth; evaluate again"
            )
        return prediction, truth


def display_names(compared: Sequence[EvaluationImages]) -> list[str]:
    """Distinct names: the method's display name, with the seed or a number where several share it."""
    methods = [display_name(one.evaluation.method) for one in compared]
    labels = []
    for index, one in enumerate(compared):
        method, seed = methods[index], one.evaluation.seed
        label = method if methods.count(method) == 1 or seed is None else f"{method} (seed {seed})"
        labels.append(label if label not in labels else f"{label} #{index + 1}")
    return labels


def measured_metrics(compared: Sequence[EvaluationImages]) -> list[str]:
    """Metrics with at least one value, in the order of the protocol."""
    columns = dict.fromkeys(name for one in compared for name in one.evaluation.protocol.columns)
    return [name for name in columns if any(_any_value(one.evaluation, name) for one in compared)]


def _any_value(evaluation: Evaluation, name: str) -> bool:
    return any(value is not None for value in evaluation.values.get(name, ()))


def worst_frames(compared: Sequence[EvaluationImages], count: int, metric: str = "psnr") -> list[int]:
    """Frames of the first evaluation with the worst values, worst first; identical frames come last."""
    evaluation = compared[0].evaluation
    values = evaluation.values.get(metric, ())
    sign = 1.0 if metric_of(metric).higher_is_better else -1.0
    known = [
        (sign * value, frame) for value, frame in zip(values, evaluation.frames, strict=False) if value is not None
    ]
    return [frame for _, frame in sorted(known)[:count]]
