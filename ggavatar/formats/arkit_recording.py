"""Recordings of ARKit's 52 blendshape scores: Live Link Face CSV, LAM's or MediaPipe's JSON, npz.

Columns are matched by name. Order is never trusted: lists of 52 names differ between ARKit, Live Link Face and
MediaPipe. Times are those of the recording, since rows may be missing or repeated.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ggavatar.errors import InputError
from ggavatar.formats.named_scores import scores_by_name
from ggavatar.io.json_files import MAX_JSON_BYTES, parse_value, read_json
from ggavatar.io.npz import read_npz
from ggavatar.io.regular_files import open_regular, read_file, regular_size

_SIDED = """
eyeBlink eyeLookDown eyeLookIn eyeLookOut eyeLookUp eyeSquint eyeWide mouthSmile mouthFrown mouthDimple mouthStretch
mouthPress mouthLowerDown mouthUpperUp browDown browOuterUp cheekSquint noseSneer
"""
_SINGLE = """
jawForward jawLeft jawRight jawOpen mouthClose mouthFunnel mouthPucker mouthLeft mouthRight mouthRollLower
mouthRollUpper mouthShrugLower mouthShrugUpper browInnerUp cheekPuff tongueOut
"""
ARKIT_NAMES = tuple(
    sorted([*_SINGLE.split(), *(f"{name}{side}" for name in _SIDED.split() for side in ("Left", "Right"))])
)
"""ARKit's 52 blendshapes, in alphabetical order; left and right are the subject's."""

HEAD_ANGLES = ("headYaw", "headPitch", "headRoll")
DEFAULT_FPS = 30.0
MAX_ROWS, MAX_COLUMNS, MAX_NUMBERS = 1_000_000, 1000, 14_000_000
"""An hour at 60 frames per second has 216,000 rows and 13 million numbers."""
MAX_CSV_BYTES, MAX_LINE = 1 << 28, 1 << 16
MINIMUM_NAMES = 20
"""Fewest of the 52 names that make a recording; fewer are something else with a jawOpen in it."""

_TIMECODE = re.compile(r"^(\d{1,2}):(\d{1,2}):(\d{1,2})[:;](\d{1,3}(?:\.\d+)?)$")
_DAY = 86400.0
_TIME_COLUMNS = {"time": 1.0, "times": 1.0, "timestamp": 1.0, "timestampms": 1e-3, "timems": 1e-3}


@dataclass(frozen=True)
class ArkitRecording:
    """Scores of T moments.

    Attributes:
        scores: In [0, 1], in the order of `ARKIT_NAMES`; zero for names that the recording lacks.
        times: Seconds since the first row, ascending.
        head_angles: Yaw, pitch and roll as stored, if any is not zero; their signs and unit differ between apps and
            are not known for certain (Live Link Face: presumably rad).
        notes: What was missing, left out or assumed.
    """

    scores: Float[np.ndarray, "T 52"]
    times: Float[np.ndarray, " T"]
    head_angles: Float[np.ndarray, "T 3"] | None = None
    notes: tuple[str, ...] = ()

    def at(self, times: Float[np.ndarray, " N"]) -> Float[np.ndarray, "N 52"]:
        """Scores at other times, linearly interpolated; beyond the ends, those of the first or last row."""
        return np.stack([np.interp(times, self.times, column) for column in self.scores.T], axis=1)

    def resampled(self, fps: float) -> ArkitRecording:
        """The recording at a constant frame rate."""
        times = np.arange(int(np.floor(self.times[-1] * fps + 1e-6)) + 1) / fps
        angles = self.head_angles
        if angles is not None:
            angles = np.stack([np.interp(times, self.times, column) for column in angles.T], axis=1)
        return ArkitRecording(self.at(times), times, angles, self.notes)


def is_arkit_recording(path: Path) -> bool:
    """Whether a file is such a recording, judging by its content; never raises."""
    try:
        _table(path)
    except (InputError, OSError):
        return False
    return True


def read_arkit_recording(path: Path) -> ArkitRecording:
    """Read a recording; rows that are damaged or not later than the one before are left out.

    Raises:
        InputError: Another kind of file, names that are not ARKit's, or no usable rows.
    """
    table = _table(path)
    columns = _columns(path, table.names)
    notes = list(table.notes)
    missing = [name for name in ARKIT_NAMES if name not in columns]
    if missing:
        notes.append(f"not in the recording and taken as 0: {', '.join(missing)}")
    scores = np.zeros((len(table.values), len(ARKIT_NAMES)))
    for index, name in enumerate(ARKIT_NAMES):
        if name in columns:
            scores[:, index] = table.values[:, columns[name]]
    angles = [columns[name] for name in HEAD_ANGLES if name in columns]
    head = table.values[:, angles] if len(angles) == 3 else None
    keep = _usable(table.times, scores, head, notes)
    if keep.sum() < 1:
        raise InputError(f"{path}: expected rows of numbers with ascending times, found none; record the take again")
    if head is not None:
        head = None if not head[keep].any() else head[keep]
    times, scores = table.times[keep], scores[keep]
    if scores.min() < 0 or scores.max() > 1:
        notes.append(f"scores from {scores.min():.2f} to {scores.max():.2f} are limited to 0 to 1")
    return ArkitRecording(np.clip(scores, 0, 1), times - times[0], head, tuple(notes))


@dataclass(frozen=True)
class _Table:
    """Columns by name, and the time of every row, s."""

    names: tuple[str, ...]
    values: Float[np.ndarray, "T C"]
    times: Float[np.ndarray, " T"]
    notes: tuple[str, ...] = ()


def _table(path: Path) -> _Table:
    """The rows of a file of any of the three kinds, told apart by its first bytes."""
    with open_regular(path, "a file with ARKit scores") as stream:
        head = stream.read(64).lstrip(b"\xef\xbb\xbf \r\n\t")
    if head[:2] == b"PK":
        table = _npz_table(path)
    elif head[:1] in (b"{", b"["):
        table = _json_table(path)
    else:
        table = _csv_table(path)
    if len(_columns(path, table.names).keys() & set(ARKIT_NAMES)) < MINIMUM_NAMES:
        raise InputError(f"{path}: expected at least {MINIMUM_NAMES} of ARKit's 52 names, such as jawOpen")
    return table


def _columns(path: Path, names: Sequence[str]) -> dict[str, int]:
    """Columns by ARKit's own names; `InputError` if two columns have the same."""
    known = {name.lower(): name for name in (*ARKIT_NAMES, *HEAD_ANGLES)}
    columns: dict[str, int] = {}
    for index, name in enumerate(names):
        key = re.sub(r"_l$", "left", re.sub(r"_r$", "right", name.strip().lower())).replace("_", "")
        own = known.get(key)
        if own in columns:
            raise InputError(f"{path}: expected every name once, found {name!r:.40} twice; export the take again")
        if own is not None:
            columns[own] = index
    return columns


def _usable(times: np.ndarray, scores: np.ndarray, head: np.ndarray | None, notes: list[str]) -> np.ndarray:
    """Rows with finite numbers whose time is later than that of every row before."""
    finite = np.isfinite(times) & np.isfinite(scores).all(axis=1)
    if head is not None:
        finite &= np.isfinite(head).all(axis=1)
    if not finite.all():
        notes.append(f"{(~finite).sum()} of {len(finite)} rows hold no numbers and are left out")
    latest = np.maximum.accumulate(np.where(finite, times, -np.inf))
    before = np.concatenate(([-np.inf], latest[:-1]))
    late = finite & ~(times > before)
    if late.any():
        notes.append(f"{late.sum()} of {len(finite)} rows repeat an earlier time and are left out")
    return finite & ~late


def _csv_table(path: Path) -> _Table:
    """Live Link Face's CSV, or one with a time or frame column and ARKit's names."""
    regular_size(path, "a take", MAX_CSV_BYTES)
    try:
        with open_regular(path) as stream, io.TextIOWrapper(stream, "utf-8-sig", newline="") as text:
            names, codes, values = _csv_columns(text)
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: expected a CSV, JSON or npz file with ARKit scores ({error})") from error
    if not len(values):
        raise InputError(
            f"{path}: expected a line of names and lines of scores, found {int(bool(names))} lines; export it again"
        )
    keys = _keys(names)
    if "timecode" in keys:
        return _Table(names, values, *_timecodes(path, codes))
    for name, unit in _TIME_COLUMNS.items():
        if name in keys:
            return _Table(names, values, values[:, keys[name]] * unit)
    return _Table(names, values, np.arange(len(values)) / DEFAULT_FPS, (_rate_note(),))


def _keys(names: Sequence[str]) -> dict[str, int]:
    """Columns by their names' letters; the first of several."""
    return {re.sub(r"[^a-z]", "", name.lower()): index for index, name in reversed(list(enumerate(names)))}


def _csv_rows(text: io.TextIOWrapper) -> Iterator[list[str]]:
    """Rows of one line each, of bounded length."""
    while line := text.readline(MAX_LINE):
        if len(line) == MAX_LINE:
            raise csv.Error(f"a line of {MAX_LINE} characters")
        yield next(csv.reader([line]), [])


def _csv_columns(text: io.TextIOWrapper) -> tuple[tuple[str, ...], list[str], Float[np.ndarray, "T C"]]:
    """Names, the text of the time code of every row, and the numbers, which take eight bytes each and no more.

    Raises:
        csv.Error: More columns, rows or numbers than a take has, or what is no CSV.
    """
    rows = _csv_rows(text)
    names = tuple(next(rows, ()))
    if len(names) > MAX_COLUMNS:
        raise csv.Error(f"more than {MAX_COLUMNS} columns")
    code = _keys(names).get("timecode", len(names))
    codes: list[str] = []
    numbers: list[np.ndarray] = []
    for row in rows:
        if any(row):
            codes.append(row[code] if code < len(row) else "")
            values = np.full(len(names), np.nan)
            for index, cell in enumerate(row[: len(names)]):
                values[index] = _number(cell)
            numbers.append(values)
        if len(numbers) > min(MAX_ROWS, MAX_NUMBERS // max(len(names), 1)):
            raise csv.Error("more rows than a take has")
    return names, codes, np.array(numbers, np.float64).reshape(len(numbers), len(names))


def _number(text: str) -> float:
    try:
        return float(text) if text else np.nan
    except ValueError:
        return np.nan


def _rate_note() -> str:
    return f"the recording has no times: {DEFAULT_FPS:g} frames per second are assumed"


def _timecodes(path: Path, texts: Sequence[str]) -> tuple[np.ndarray, tuple[str, ...]]:
    """Times of HH:MM:SS:FF.fff, s: FF counts frames of a rate that the largest FF shows; midnight wraps."""
    found = [_TIMECODE.match(text.strip()) for text in texts]
    if not any(found):
        raise InputError(
            f"{path}: expected time codes such as 12:34:56:07.500, found {texts[0]!r:.40}; export it again"
        )
    parts = np.array([[float(part) for part in match.groups()] if match else [np.nan] * 4 for match in found])
    largest = float(np.nanmax(parts[:, 3]))
    rate = 60.0 if largest >= 30 else 30.0
    if largest >= 61:
        raise InputError(
            f"{path}: expected frame numbers below 60 in the time codes, found {largest:g}; export it again"
        )
    times = parts @ np.array([3600.0, 60.0, 1.0, 1 / rate])
    steps = np.diff(times, prepend=times[0])
    return times + _DAY * np.cumsum(np.nan_to_num(steps) < -_DAY / 2), ()


def _json_table(path: Path) -> _Table:
    """LAM's JSON: names, and frames with weights and a time; or MediaPipe's results, which name their scores."""
    data = _json_object(path)
    frames, metadata = data.get("frames"), data.get("metadata")
    named = metadata if isinstance(metadata, Mapping) else {}
    names = data.get("names", named.get("blendshape_names"))
    if names is None and isinstance(frames, list) and 1 <= len(frames) <= MAX_ROWS:
        found = scores_by_name(frames)
        if found is not None:
            return _named_table(*found)
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names) or len(names) > 1000:
        raise InputError(
            f"{path}: expected the names of the scores under 'names': lists of 52 differ in their order; add them"
        )
    if not isinstance(frames, list) or not 1 <= len(frames) <= min(MAX_ROWS, MAX_NUMBERS // max(len(names), 1)):
        raise InputError(
            f"{path}: expected frames with 'weights' under 'frames', found none or too many; export the take again"
        )
    values = np.array([_weights(frame, len(names)) for frame in frames])
    times = np.array([_time(frame) for frame in frames])
    if np.isfinite(times).any():
        return _Table(tuple(names), values, times)
    fps = named.get("fps")
    good = isinstance(fps, int | float) and not isinstance(fps, bool) and 1 <= fps <= 1000
    rate = float(fps) if good and isinstance(fps, int | float) else DEFAULT_FPS
    return _Table(tuple(names), values, np.arange(len(frames)) / rate, () if good else (_rate_note(),))


def _json_object(path: Path) -> dict[str, Any]:
    """The object of a file; a list at the top is one of frames."""
    text = read_file(path, MAX_JSON_BYTES, "a JSON file")
    if not text.lstrip(b"\xef\xbb\xbf \r\n\t").startswith(b"["):
        return read_json(path)
    try:
        return {"frames": parse_value(text)}
    except ValueError as error:
        raise InputError(f"{path}: not valid JSON ({str(error)[:200]}); create or copy the file again") from error


def _named_table(names: tuple[str, ...], values: np.ndarray, times: np.ndarray) -> _Table:
    """Frames that name their scores (MediaPipe); those without a face are left out."""
    if np.isfinite(times).any():
        return _Table(names, values, times)
    return _Table(names, values, np.arange(len(values)) / DEFAULT_FPS, (_rate_note(),))


def _weights(frame: Any, count: int) -> np.ndarray:
    weights = frame.get("weights") if isinstance(frame, Mapping) else None
    if not isinstance(weights, list) or len(weights) != count:
        return np.full(count, np.nan)
    if not all(isinstance(value, int | float) and abs(value) < 1e9 for value in weights):
        return np.full(count, np.nan)
    return np.array(weights, dtype=np.float64)


def _time(frame: Any) -> float:
    value = frame.get("time") if isinstance(frame, Mapping) else None
    return float(value) if isinstance(value, int | float) and abs(value) < 1e9 else np.nan


def _npz_table(path: Path) -> _Table:
    """An npz with `names`, `scores` (or `weights`) of shape [T, names], and `times` or `fps`."""
    arrays = read_npz(path, ["names", "scores", "weights", "times", "time", "fps"])
    names, values = arrays.get("names"), arrays.get("scores", arrays.get("weights"))
    if names is None or names.dtype.kind != "U" or names.ndim != 1:
        raise InputError(
            f"{path}: expected the names of the scores under 'names': lists of 52 differ in their order; add them"
        )
    if values is None or values.dtype.kind not in "fiu" or values.ndim != 2 or values.shape[1] != len(names):
        found = "none" if values is None else str(values.shape)
        raise InputError(f"{path}: expected 'scores' of shape (frames, {len(names)}), found {found}; save it again")
    texts, scores = tuple(str(name) for name in names), values.astype(np.float64)
    times = arrays.get("times", arrays.get("time"))
    if times is not None:
        if times.shape != (len(scores),) or times.dtype.kind not in "fiu":
            raise InputError(f"{path}: expected {len(scores)} numbers in 'times', found {times.shape}; save it again")
        return _Table(texts, scores, times.astype(np.float64))
    fps = arrays.get("fps")
    if fps is not None and fps.size == 1 and fps.dtype.kind in "fiu" and 1 <= float(fps.reshape(())) <= 1000:
        return _Table(texts, scores, np.arange(len(scores)) / float(fps.reshape(())))
    return _Table(texts, scores, np.arange(len(scores)) / DEFAULT_FPS, (_rate_note(),))
