"""ARKit recordings: Live Link Face's columns and time codes, LAM's JSON, npz, and what goes wrong in them.

Reference: the column list, time codes and value ranges of a real Live Link Face take, MediaPipe's own list of names,
and LAM_WebRender's sample of 973 frames.
"""

from __future__ import annotations

import json
import random

import numpy as np
import pytest

from ggavatar.errors import InputError
from ggavatar.formats.arkit_recording import ARKIT_NAMES, is_arkit_recording, read_arkit_recording
from ggavatar.io.npz import write_npz
from ggavatar.landmarks.blendshapes import NAMES
from tests.support.damaged_files import check_value_mutations, refused_mutants
from tests.support.measured import costs

EYES = ("Blink", "LookDown", "LookIn", "LookOut", "LookUp", "Squint", "Wide")
COLUMNS = """
JawForward JawRight JawLeft JawOpen MouthClose MouthFunnel MouthPucker MouthRight MouthLeft MouthSmileLeft
MouthSmileRight MouthFrownLeft MouthFrownRight MouthDimpleLeft MouthDimpleRight MouthStretchLeft MouthStretchRight
MouthRollLower MouthRollUpper MouthShrugLower MouthShrugUpper MouthPressLeft MouthPressRight MouthLowerDownLeft
MouthLowerDownRight MouthUpperUpLeft MouthUpperUpRight BrowDownLeft BrowDownRight BrowInnerUp BrowOuterUpLeft
BrowOuterUpRight CheekPuff CheekSquintLeft CheekSquintRight NoseSneerLeft NoseSneerRight TongueOut
"""
LIVE_LINK = [*(f"Eye{name}{side}" for side in ("Left", "Right") for name in EYES), *COLUMNS.split()]
ANGLES = [f"{part}{name}" for part in ("Head", "LeftEye", "RightEye") for name in ("Yaw", "Pitch", "Roll")]
SCORES = np.random.default_rng(0).uniform(0, 1, (5, 52))


def live_link(path, codes, scores=SCORES, angles=None):
    lines = [",".join(["Timecode", "BlendShapeCount", *LIVE_LINK, *ANGLES])]
    angles = np.zeros((len(codes), 9)) if angles is None else angles
    for code, row, turned in zip(codes, scores, angles, strict=True):
        lines.append(",".join([code, "61", *(f"{value:.10f}" for value in (*row, *turned))]))
    path.write_text("\r\n".join(lines) + "\r\n", encoding="ascii")
    return path


CODES = ["15:04:59:58.500", "15:04:59:59.501", "15:05:00:00.502", "15:05:00:02.504", "15:05:00:02.504"]


def test_names_are_arkits():
    assert len(ARKIT_NAMES) == 52 == len(set(ARKIT_NAMES)) and len(LIVE_LINK) == 52
    assert set(ARKIT_NAMES) - {"tongueOut"} == set(NAMES) - {"neutral"}
    assert {name[0].lower() + name[1:] for name in LIVE_LINK} == set(ARKIT_NAMES)


def test_live_link_face(tmp_path):
    """59.94 frames per second counted to 60; the minute changes, one frame is missing, one repeated."""
    found = read_arkit_recording(live_link(tmp_path / "take.csv", CODES))
    np.testing.assert_allclose(found.times, [0, 1.001 / 60, 2.002 / 60, 4.004 / 60], atol=1e-9)
    order = [LIVE_LINK.index(name[0].upper() + name[1:]) for name in ARKIT_NAMES]
    np.testing.assert_allclose(found.scores, SCORES[:4][:, order], atol=1e-9)
    assert found.head_angles is None and "1 of 5 rows repeat an earlier time" in found.notes[0]
    assert is_arkit_recording(tmp_path / "take.csv")


def test_thirty_frames_and_midnight(tmp_path):
    codes = ["23:59:59:28", "23:59:59:29", "00:00:00:00", "00:00:00:01", "00:00:01:00"]
    angles = np.zeros((5, 9))
    angles[:, 1] = 0.25
    found = read_arkit_recording(live_link(tmp_path / "take.csv", codes, angles=angles))
    np.testing.assert_allclose(found.times, [0, 1 / 30, 2 / 30, 3 / 30, 32 / 30], atol=1e-9)
    np.testing.assert_allclose(found.head_angles, np.tile([0, 0.25, 0], (5, 1)))


def test_scores_at_other_times(tmp_path):
    found = read_arkit_recording(live_link(tmp_path / "take.csv", CODES))
    middle = found.at(np.array([3.003 / 60]))[0]
    np.testing.assert_allclose(middle, (found.scores[2] + found.scores[3]) / 2, atol=1e-9)
    even = found.resampled(30.0)
    np.testing.assert_allclose(even.times, [0, 1 / 30, 2 / 30])
    np.testing.assert_allclose(even.scores[0], found.scores[0])


@pytest.mark.parametrize("change", ["shuffled", "pascal", "sided", "mediapipe"])
def test_order_and_spelling_do_not_matter(tmp_path, change):
    order = np.random.default_rng(1).permutation(52)
    names = [ARKIT_NAMES[index] for index in order]
    if change == "pascal":
        names = [name[0].upper() + name[1:] for name in names]
    elif change == "sided":
        names = [name.replace("Left", "_L").replace("Right", "_R") if len(name) > 9 else name for name in names]
    scores = SCORES[:, order]
    if change == "mediapipe":  # 52 names as well, but _neutral instead of tongueOut
        scores[:, names.index("tongueOut")] = 0.9
        names = ["_neutral" if name == "tongueOut" else name for name in names]
    write_npz(tmp_path / "x.npz", {"names": np.array(names), "scores": scores, "fps": np.array(25.0)})
    frames = [{"weights": row.tolist(), "time": index / 25, "rotation": []} for index, row in enumerate(scores)]
    (tmp_path / "x.json").write_text(json.dumps({"names": names, "frames": frames}))
    lines = [",".join(["frame", "timestamp_ms", *names])]
    lines += [",".join(map(str, [index, 40 * index, *row])) for index, row in enumerate(scores.tolist())]
    (tmp_path / "x.csv").write_text("\n".join(lines))
    expected = SCORES.copy()
    if change == "mediapipe":
        expected[:, ARKIT_NAMES.index("tongueOut")] = 0
    for suffix in ("npz", "json", "csv"):
        found = read_arkit_recording(tmp_path / f"x.{suffix}")
        np.testing.assert_allclose(found.scores, expected, atol=1e-9)
        np.testing.assert_allclose(found.times, np.arange(5) / 25, atol=1e-9)
        assert any("tongueOut" in note for note in found.notes) == (change == "mediapipe")


def test_a_real_performance(data_folder):
    found = read_arkit_recording(data_folder / "tracking" / "arkit_expression_973.json")
    assert len(found.times) == 973 and found.scores.max() == pytest.approx(0.937, abs=0.001)
    np.testing.assert_allclose(np.diff(found.times), 1 / 30, atol=1e-3)


def test_damaged_rows_and_loud_scores(tmp_path):
    scores = SCORES.copy()
    scores[1, 0], scores[2, 3] = 1.5, np.nan
    codes = ["01:00:00:00", "01:00:00:01", "01:00:00:02", "", "01:00:00:04"]
    found = read_arkit_recording(live_link(tmp_path / "take.csv", codes, scores))
    assert len(found.times) == 3 and found.scores.max() <= 1
    assert "2 of 5 rows hold no numbers" in found.notes[0] and "limited to 0 to 1" in found.notes[1]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a,b\n1,2\n", "52 names"),
        ("", "found 0 lines"),
        ('{"frames": [{"weights": [0.1]}]}', "differ in their order"),
        ('{"names": ["jawOpen"], "frames": [{"weights": [0.1], "time": 0}]}', "52 names"),
        (",".join(ARKIT_NAMES) + ",jawOpen\n" + ",".join(["0"] * 53), "twice"),
        ("Timecode," + ",".join(ARKIT_NAMES) + "\nnoon," + ",".join(["0"] * 52), "time codes such as"),
        ("Timecode," + ",".join(ARKIT_NAMES) + "\n1:0:0:99," + ",".join(["0"] * 52), "below 60"),
        (",".join(ARKIT_NAMES) + "\n" + ",".join(["x"] * 52), "ascending times"),
    ],
)
def test_messages(tmp_path, text, said):
    (tmp_path / "x.txt").write_text(text)
    with pytest.raises(InputError, match=said) as caught:
        read_arkit_recording(tmp_path / "x.txt")
    assert "x.txt" in str(caught.value)


def test_nameless_arrays_are_ambiguous(tmp_path):
    write_npz(tmp_path / "x.npz", {"scores": SCORES})
    with pytest.raises(InputError, match="differ in their order"):
        read_arkit_recording(tmp_path / "x.npz")
    assert not is_arkit_recording(tmp_path / "x.npz") and not is_arkit_recording(tmp_path / "absent")
    assert not is_arkit_recording(tmp_path)


@pytest.mark.parametrize("suffix", ["csv", "json", "npz"])
def test_seeded_mutations(tmp_path, suffix):
    path = tmp_path / f"mutant.{suffix}"
    names = list(ARKIT_NAMES)
    if suffix == "csv":
        live_link(path, CODES)
    elif suffix == "json":
        frames = [{"weights": row.tolist(), "time": index / 25} for index, row in enumerate(SCORES)]
        path.write_text(json.dumps({"names": names, "frames": frames, "metadata": {"fps": 25}}))
    else:
        write_npz(path, {"names": np.array(names), "scores": SCORES, "times": np.arange(5) / 25})
    original = path.read_bytes()
    refused_mutants(path, original, lambda: read_arkit_recording(path), random.Random(suffix).random())
    if suffix == "json":
        check_value_mutations(path, original, lambda: read_arkit_recording(path), 0)


def test_recordings_that_would_fill_the_memory(tmp_path):
    """Lines without end, columns and rows without number, frames with no scores: refused in bounded memory."""
    names = ",".join(f"c{number}" for number in range(900))
    files = {
        "line.csv": b"," * 40_000_000,
        "quotes.csv": b"time,jawOpen\n" + b'"\n",' * 5_000_000,
        "columns.csv": b",".join(b"x" for _ in range(30_000)) + b"\n1\n",
        "rows.csv": names.encode() + b"\n" + b"1\n" * 60_000,
        "frames.json": b'{"names": [' + b'"a",' * 999 + b'"b"], "frames": [' + b"0," * 900_000 + b"0]}",
    }
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    found = costs("ggavatar.formats.arkit_recording", "read_arkit_recording", [tmp_path / name for name in files])
    for name, cost in zip(files, found, strict=True):
        assert cost.message and name in cost.message and cost.seconds < 10 and cost.peak < 1000, (name, cost)
