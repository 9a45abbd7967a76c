"""The performance: speech, gestures, blinks, gaze and head motion as curves over time, generated from a seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

FPS = 25
"""Frames per second."""
NECK_PIVOT = np.array([0.0, -0.1100, -0.0450])
"""Point about which the head turns, head space, m."""
_BLINK = (0.25, 0.85, 1.0, 0.90, 0.55, 0.25, 0.08)
"""Closing of the lids in the frames of a blink."""


@dataclass(frozen=True)
class Performance:
    """What the person does in T frames.

    Attributes:
        expression: Coefficients in the order of the head's expression basis.
        jaw: Axis-angle rotation of the jaw, rad.
        eyes: Axis-angle rotations of the left and the right eye, rad.
        eyelids: Closing of the left and the right lid.
        head_to_room: Rigid pose of the head; the identity at rest.
        torso_to_room: Rigid pose of the torso, which sways slightly.
    """

    expression: Float[ndarray, "T E"]
    jaw: Float[ndarray, "T 3"]
    eyes: Float[ndarray, "T 2 3"]
    eyelids: Float[ndarray, "T 2"]
    head_to_room: Float[ndarray, "T 4 4"]
    torso_to_room: Float[ndarray, "T 4 4"]


@dataclass(frozen=True)
class Viseme:
    """A mouth shape of speech.

    Attributes:
        jaw: Opening angle of the jaw, rad.
        shapes: Expression names and coefficients.
    """

    jaw: float
    shapes: tuple[tuple[str, float], ...]


VISEMES = (
    Viseme(0.24, (("lips_part", 0.5),)),
    Viseme(0.16, (("stretch_left", 0.25), ("stretch_right", 0.25), ("lips_part", 0.6))),
    Viseme(0.07, (("stretch_left", 0.5), ("stretch_right", 0.5), ("lips_part", 0.9))),
    Viseme(0.13, (("funnel", 0.8), ("pucker", 0.35))),
    Viseme(0.05, (("pucker", 0.8), ("funnel", 0.3))),
    Viseme(0.0, (("lips_press", 0.9),)),
    Viseme(0.015, (("lower_roll_in", 0.9), ("upper_lip_raise_left", 0.25), ("upper_lip_raise_right", 0.25))),
    Viseme(0.08, (("tongue_up", 0.8), ("lips_part", 0.6))),
    Viseme(0.05, (("funnel", 0.55), ("lips_part", 0.7))),
    Viseme(0.11, (("tongue_out", 0.45), ("lips_part", 0.5))),
)
_VISEME_ODDS = (0.18, 0.15, 0.12, 0.10, 0.08, 0.13, 0.06, 0.09, 0.05, 0.04)


@dataclass(frozen=True)
class Gesture:
    """A facial gesture.

    Attributes:
        shapes: Expression names and coefficients at the peak.
        seconds: Typical duration, s.
        silent: Whether speech pauses during the gesture.
    """

    shapes: tuple[tuple[str, float], ...]
    seconds: float
    silent: bool = False


def _both(name: str, value: float) -> tuple[tuple[str, float], ...]:
    return ((f"{name}_left", value), (f"{name}_right", value))


GESTURES = (
    Gesture(
        (*_both("smile", 1.1), *_both("cheek_squint", 0.7), *_both("upper_lip_raise", 0.35), ("lips_part", 0.7)), 2.4
    ),
    Gesture((("brow_inner_up", 1.0), *_both("brow_outer_up", 1.0), *_both("eye_wide", 0.8)), 1.6),
    Gesture((*_both("brow_down", 1.0), *_both("eye_squint", 0.6), *_both("frown", 0.4)), 1.8),
    Gesture((*_both("smile", 0.6), *_both("dimple", 0.6)), 2.0),
    Gesture((("smile_left", 0.9), ("dimple_left", 0.8), ("cheek_squint_left", 0.5), ("brow_outer_up_left", 0.6)), 1.6),
    Gesture(
        (
            *_both("nose_wrinkle", 1.0),
            *_both("upper_lip_raise", 0.6),
            *_both("eye_squint", 0.7),
            ("brow_down_left", 0.5),
            ("brow_down_right", 0.5),
        ),
        1.4,
    ),
    Gesture((*_both("cheek_puff", 1.0), ("lips_press", 0.6), ("pucker", 0.2)), 1.6, True),
    Gesture((("pucker", 1.0), ("cheek_suck", 0.5)), 1.2, True),
    Gesture((("brow_outer_up_right", 1.0), ("eye_squint_left", 0.5), ("mouth_shift_right", 0.5)), 1.4),
    Gesture((*_both("frown", 1.0), ("chin_raise", 0.9), ("brow_inner_up", 0.6)), 1.6, True),
    Gesture((("mouth_shift_left", 0.8), ("smile_left", 0.3)), 1.2, True),
    Gesture((("smile_right", 1.0), ("dimple_right", 0.6), ("cheek_squint_right", 0.6)), 1.5),
    Gesture((*_both("lower_lip_depress", 0.8), *_both("stretch", 0.9), ("lips_part", 0.6)), 1.1, True),
    Gesture((("nostril_flare", 1.0), ("upper_roll_in", 0.6), ("lower_roll_in", 0.6), ("swallow", 1.0)), 1.2, True),
    Gesture((("upper_lip_forward", 0.7), ("lower_lip_forward", 0.9), ("lips_tighten", 0.6)), 1.2, True),
)


def perform(names: tuple[str, ...], frames: int, seed: int) -> Performance:
    """A performance of `frames` frames at 25 fps for a head with the given expression names; decided by the seed.

    Long clips contain every gesture at least once, smiles to their extreme, and head yaw up to ±35°.
    """
    generator = np.random.default_rng(seed)
    index = {name: column for column, name in enumerate(names)}
    gestures, quiet = _gestures(index, frames, generator)
    speech, jaw_angle = _speech(index, frames, generator)
    voice = 1 - gaussian_filter1d(quiet, 4)
    expression = np.clip(gestures + speech * voice[:, None], -0.2, 1.25)
    jaw = np.zeros((frames, 3))
    jaw[:, 0] = jaw_angle * voice + 0.16 * _laugh(gestures, index) + 0.004
    jaw[:, 1] = 0.007 * _drift(frames, 10, generator) * jaw_angle / 0.2
    yaw, pitch, roll, shift = _head(frames, generator)
    eyes = _gaze(frames, yaw, pitch, generator)
    eyelids = _eyelids(frames, eyes, yaw, generator)
    return Performance(expression, jaw, eyes, eyelids, _pose(yaw, pitch, roll, shift), _sway(frames, yaw, generator))


def _drift(frames: int, width: int, generator: np.random.Generator) -> ndarray:
    """Smooth noise with a root mean square of 1; `width` is the Gaussian's standard deviation in frames."""
    padding = int(4 * width)
    noise = gaussian_filter1d(generator.standard_normal(frames + 2 * padding), width)[padding : padding + frames]
    return noise * np.sqrt(2 * width * np.sqrt(np.pi))


def _envelope(frames: int, center: float, length: float) -> ndarray:
    """A curve 0 → 1 → 0 around `center` with quick attack, hold and slow release; times in frames."""
    time = np.arange(frames) - center
    attack = np.clip((time + 0.5 * length) / (0.24 * length), 0, 1)
    release = np.clip((0.5 * length - time) / (0.34 * length), 0, 1)
    return (attack**2 * (3 - 2 * attack)) * (release**2 * (3 - 2 * release))


def _gestures(index: dict[str, int], frames: int, generator: np.random.Generator) -> tuple[ndarray, ndarray]:
    """Coefficients of gestures in shuffled order with varying strength, and by how much they silence speech."""
    expression, quiet = np.zeros((frames, len(index))), np.zeros(frames)
    time = 0.35 * FPS
    order: list[int] = []
    while time < frames:
        order = order or list(generator.permutation(len(GESTURES)))
        gesture = GESTURES[order.pop()]
        length = gesture.seconds * FPS * generator.uniform(0.85, 1.2)
        curve = _envelope(frames, time + length / 2, length)
        for name, value in gesture.shapes:
            expression[:, index[name]] += value * curve * generator.uniform(0.85, 1.12)
        quiet = np.maximum(quiet, curve * gesture.silent)
        time += length * 0.80 + FPS * generator.uniform(0.0, 0.25)
    return expression, quiet


def _speech(index: dict[str, int], frames: int, generator: np.random.Generator) -> tuple[ndarray, ndarray]:
    """Expression coefficients and jaw angle (rad) of speech: phrases of syllables at about 4.5 Hz."""
    expression, jaw = np.zeros((frames, len(index))), np.zeros(frames)
    time, phrase_end = 0.2 * FPS, FPS * generator.uniform(1.5, 3.0)
    clock = np.arange(frames)
    while time < frames:
        viseme = VISEMES[generator.choice(len(VISEMES), p=_VISEME_ODDS)]
        width = FPS * generator.uniform(0.050, 0.085)
        curve = np.exp(-0.5 * ((clock - time) / width) ** 2) * generator.uniform(0.65, 1.2)
        jaw += viseme.jaw * curve
        for name, value in viseme.shapes:
            expression[:, index[name]] += value * curve
        time += FPS * generator.uniform(0.14, 0.27)
        if time > phrase_end:
            time += FPS * generator.uniform(0.3, 0.9)
            phrase_end = time + FPS * generator.uniform(1.5, 3.5)
    return expression, np.minimum(jaw, 0.34)


def _laugh(gestures: ndarray, index: dict[str, int]) -> ndarray:
    """Jaw opening of the broadest smiles, in [0, 1]."""
    both = np.minimum(gestures[:, index["smile_left"]], gestures[:, index["smile_right"]])
    return np.clip((both - 0.75) / 0.35, 0, 1)


def _head(frames: int, generator: np.random.Generator) -> tuple[ndarray, ndarray, ndarray, ndarray]:
    """Yaw, pitch and roll of the head in rad and its shift in m; yaw reaches 35° to both sides in long clips."""
    time = np.arange(frames) / FPS
    yaw = 0.62 * np.sin(2 * np.pi * time / 9.5 + generator.uniform(0, 6.28)) + 0.30 * _drift(frames, 14, generator)
    high, low = max(yaw.max(), 0.2), max(-yaw.min(), 0.2)
    yaw = np.deg2rad(35) * np.where(yaw > 0, yaw / high, yaw / low)
    pitch = np.deg2rad(6.5) * _drift(frames, 12, generator)
    roll = np.deg2rad(4.5) * _drift(frames, 16, generator) - 0.10 * yaw
    shift = np.stack([size * _drift(frames, 18, generator) for size in (0.007, 0.004, 0.008)], axis=1)
    return yaw, np.clip(pitch, -0.35, 0.35), np.clip(roll, -0.25, 0.25), shift


def _gaze(frames: int, yaw: ndarray, pitch: ndarray, generator: np.random.Generator) -> ndarray:
    """Eye rotations: saccades between fixations, with half of the head's rotation compensated to face the camera."""
    target = np.zeros((frames, 2))
    start = 0
    while start < frames:
        stop = start + int(FPS * generator.uniform(0.4, 1.8))
        target[start:stop] = generator.normal(0, (0.05, 0.11))
        start = stop
    moved = gaussian_filter1d(target, 0.7, axis=0)
    horizontal = np.clip(moved[:, 1] - 0.55 * yaw, -0.52, 0.52)
    vertical = np.clip(moved[:, 0] - 0.5 * pitch, -0.30, 0.30)
    vergence = 0.025
    left = np.stack((vertical, horizontal - vergence, np.zeros(frames)), axis=1)
    right = np.stack((vertical, horizontal + vergence, np.zeros(frames)), axis=1)
    return np.stack((left, right), axis=1)


def _eyelids(frames: int, eyes: ndarray, yaw: ndarray, generator: np.random.Generator) -> ndarray:
    """Lid closing: blinks every two to five seconds, more often when the head turns; lids follow the gaze down."""
    closing = np.zeros(frames)
    turning = np.abs(np.gradient(yaw)) * FPS
    time = FPS * generator.uniform(0.5, 1.6)
    while time < frames - 1:
        for step, value in enumerate(_BLINK):
            at = int(time) + step
            if at < frames:
                closing[at] = max(closing[at], value)
        hurry = 1.0 + min(1.0, turning[int(time)])
        time += FPS * generator.uniform(1.6, 4.8) / hurry
    follow = np.clip(0.9 * eyes[:, :, 0], -0.12, 0.30)
    return np.clip(np.maximum(closing[:, None], follow + 0.05), -0.1, 1.0)


def _pose(yaw: ndarray, pitch: ndarray, roll: ndarray, shift: ndarray) -> ndarray:
    """Rigid transforms that rotate about the neck and then shift."""
    turn = Rotation.from_euler("YXZ", np.stack((yaw, pitch, roll), axis=1)).as_matrix()
    pose = np.tile(np.eye(4), (len(yaw), 1, 1))
    pose[:, :3, :3] = turn
    pose[:, :3, 3] = NECK_PIVOT - turn @ NECK_PIVOT + shift
    return pose


def _sway(frames: int, yaw: ndarray, generator: np.random.Generator) -> ndarray:
    """Torso poses: breathing and a sway of millimeters, and a delayed rotation by 8 % of the head's yaw."""
    late = gaussian_filter1d(np.concatenate((np.full(8, yaw[0]), yaw)), 6)[:frames]
    breath = 0.0012 * np.sin(2 * np.pi * np.arange(frames) / FPS / 3.6)
    shift = np.stack((0.003 * _drift(frames, 25, generator), breath, 0.002 * _drift(frames, 25, generator)), axis=1)
    return _pose(0.08 * late, np.zeros(frames), 0.02 * _drift(frames, 25, generator), shift)
