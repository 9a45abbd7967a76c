"""Accumulates per-frame scores into an evaluation: temporal metrics, folder hashes, missing metrics and reasons."""

from __future__ import annotations

import hashlib
import importlib.metadata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8

from evaluate.metrics.catalogue import FACES, METRICS, TEMPORAL, plugged_metrics
from evaluate.metrics.faces import Points
from evaluate.metrics.temporal import flicker, frame_difference_error, landmark_jitter
from evaluate.protocols.protocol import Protocol
from evaluate.protocols.results import Evaluation, Value
from evaluate.protocols.setup import Setup

Image = UInt8[np.ndarray, "H W 3"]

FLAT = "the prediction is one flat color"


@dataclass(frozen=True)
class FrameScores:
    """Scores of one frame, and what the next frame and the hashes need of it.

    Attributes:
        frame: Source frame number.
        values: Per-image metrics.
        images: Prediction and ground truth.
        foreground: Non-zero inside the person; None without masks.
        hashes: SHA-256 of the files by kind.
        notes: Deviations of the files from 8-bit RGB.
        landmark_error: Prediction minus ground truth, in units of the eye distance; None if no face was found or
            face metrics are off.
        flat: Whether the prediction is one color, as of a renderer that drew nothing.
    """

    frame: int
    values: Mapping[str, Value]
    images: tuple[Image, Image]
    foreground: UInt8[np.ndarray, "H W"] | None
    hashes: Mapping[str, str]
    notes: tuple[str, ...] = ()
    landmark_error: Points | None = None
    flat: bool = False


@dataclass(frozen=True)
class Labels:
    """Names of the scored images in tables, and what is known of their origin.

    Attributes:
        subject: Row of the table.
        method: Column of the table.
        seed: Seed of the training run.
        efficiency: What rendering and training cost.
        provenance: Run, checkpoint, step.
        notes: Remarks for the reader, as sentences.
        setup: How the images came about.
    """

    subject: str
    method: str
    seed: int | None = None
    efficiency: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    setup: Setup = field(default_factory=Setup)


class Accumulator:
    """Collects frames in ascending order; keeps the values of all and the images of only the last."""

    def __init__(self, protocol: Protocol) -> None:
        self._protocol = protocol
        self._temporal = tuple(name for name in protocol.metrics if name in TEMPORAL)
        self._frames: list[int] = []
        self._rows: list[dict[str, Value]] = []
        self._files: dict[str, list[str]] = {}
        self._notes: dict[str, int] = {}
        self._flat: list[int] = []
        self._previous: FrameScores | None = None
        self._errors: dict[int, Points | None] = {}

    def add(self, scored: FrameScores) -> None:
        """Add the next frame."""
        self._frames.append(scored.frame)
        self._rows.append({**scored.values, **self._temporal_values(scored), **self._landmark_jitter(scored)})
        for kind, sha256 in scored.hashes.items():
            self._files.setdefault(kind, []).append(f"{scored.frame} {sha256}\n")
        for note in scored.notes:
            self._notes[note] = self._notes.get(note, 0) + 1
        if scored.flat:
            self._flat.append(scored.frame)
        self._previous = scored

    def _temporal_values(self, now: FrameScores) -> dict[str, Value]:
        """Temporal metrics of this frame, if the previous source frame was scored too."""
        before = self._previous
        if not self._temporal or before is None or now.frame != before.frame + 1:
            return dict.fromkeys(self._temporal)
        mask = None
        if now.foreground is not None and before.foreground is not None:
            mask = cv2.bitwise_and(now.foreground, before.foreground)
        found: dict[str, Value] = {}
        if "frame_difference" in self._temporal:
            found["frame_difference"] = frame_difference_error(before.images, now.images)
        if "flicker" in self._temporal:
            found["flicker"] = flicker(before.images, now.images, mask)
        return found

    def _landmark_jitter(self, now: FrameScores) -> dict[str, Value]:
        """Landmark jitter over this frame and the two before it, if all three were scored."""
        if "landmark_jitter" not in self._protocol.metrics:
            return {}
        self._errors[now.frame] = now.landmark_error
        last = [self._errors.get(now.frame - back) for back in (2, 1, 0)]
        self._errors.pop(now.frame - 2, None)
        return {"landmark_jitter": landmark_jitter(last)}

    def evaluation(self, labels: Labels, unavailable: Mapping[str, str], weights: Mapping[str, str]) -> Evaluation:
        """The evaluation of all frames added.

        Args:
            labels: Names for the table.
            unavailable: Reasons by metric that could not be measured.
            weights: SHA-256 of the files of learned metrics.
        """
        names = ("mse", *(name for name in self._protocol.columns if name not in unavailable))
        values = {name: tuple(row.get(name) for row in self._rows) for name in names}
        empty = {
            name: _missing_reason(name) for name, column in values.items() if all(value is None for value in column)
        }
        counted = (f"{note}: {count} of {2 * len(self._frames)} files at most" for note, count in self._notes.items())
        return Evaluation(
            subject=labels.subject,
            method=labels.method,
            protocol=self._protocol,
            frames=tuple(self._frames),
            values={name: column for name, column in values.items() if name not in empty},
            seed=labels.seed,
            missing={**unavailable, **empty},
            hashes={kind: hashlib.sha256("".join(lines).encode()).hexdigest() for kind, lines in self._files.items()},
            weights=weights,
            efficiency=labels.efficiency,
            provenance={**labels.provenance, "versions": versions(self._protocol)},
            notes=(*labels.notes, *_flat_note(self._flat), *counted),
            setup=labels.setup,
        )


def _flat_note(frames: Sequence[int]) -> tuple[str, ...]:
    """A note that names the frames whose prediction is one color; none if there are none."""
    if not frames:
        return ()
    listed = ", ".join(map(str, frames[:10])) + (", …" if len(frames) > 10 else "")
    return (f"{FLAT} in {len(frames)} frame{'s' * (len(frames) > 1)} ({listed})",)


def flat_notes(evaluation: Evaluation) -> list[str]:
    """The notes of an evaluation on predictions of one color."""
    return [note for note in evaluation.notes if note.startswith(FLAT)]


def _missing_reason(name: str) -> str:
    """Why a metric has no value in any frame."""
    base, _, region = name.partition("@")
    if region:
        return f"no mask shows the region {region}"
    if base in TEMPORAL:
        return "no two scored frames are consecutive, or nothing stands still"
    if base in FACES:
        return "no face was found, or in too few consecutive frames"
    if base not in METRICS and base != "mse":
        return "it gave no number for any frame"
    return "the images are too small"


def versions(protocol: Protocol) -> dict[str, str]:
    """Versions of the packages that determine the scores."""
    own = {name: _version(name) for name in ("ggavatar", "numpy", "opencv-contrib-python-headless")}
    return {**own, **plugged_metrics(protocol.metrics).versions}


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "unknown"
