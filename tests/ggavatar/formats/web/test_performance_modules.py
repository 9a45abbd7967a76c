"""The page's clips, recordings and messages in node, against our own readers and transfer.

Also covers `formats/web/page/` (drives, curves, player, embed, quality, orbit).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from evaluate.motion.orbit import orbit_camera
from evaluate.motion.transfer import soft_clip
from ggavatar.core import Camera
from ggavatar.formats.arkit_recording import ARKIT_NAMES, read_arkit_recording
from ggavatar.geometry.transforms import axis_angle_to_matrix, rigid
from tests.support.page_modules import run_modules

READ = "return values.map((text) => { try { return readCurves(text, NAMES); } catch (e) { return e.message; } });"


def read_in_page(folder: Path, *texts: str) -> list[Any]:
    script = f"const NAMES = {json.dumps(ARKIT_NAMES)};\n{READ}"
    return run_modules(script, "curves", folder=folder, values=list(texts))


def test_recordings_are_read_as_by_our_reader(tmp_path: Path) -> None:
    random = np.random.default_rng(4)
    scores = random.uniform(size=(20, 52)).round(4)
    shuffled = list(random.permutation(ARKIT_NAMES))
    columns = [ARKIT_NAMES.index(name) for name in shuffled]
    header = ",".join(["Timecode", "BlendshapeCount", *(name[0].upper() + name[1:] for name in shuffled), "HeadYaw"])
    lines = [
        ",".join([f"01:02:03:{2 * row:02d}.000", "61", *map(str, scores[row][columns]), "0.1"]) for row in range(20)
    ]
    csv = "\n".join([header, *lines])
    frames = [{"time": row / 30, "weights": scores[row][columns].tolist()} for row in range(20)]
    text = json.dumps(
        {"names": [f"{name[:-4]}_L" if name.endswith("Left") else name for name in shuffled], "frames": frames}
    )
    (tmp_path / "take.csv").write_text(csv)
    recording = read_arkit_recording(tmp_path / "take.csv")
    for found in read_in_page(tmp_path, csv, text):
        assert found["known"] == 52 and found["fps"] == 30 and len(found["frames"]) == 20
        values = np.array([[frame[name] for name in ARKIT_NAMES] for frame in found["frames"]])
        np.testing.assert_allclose(values, recording.resampled(30.0).scores[:20], atol=1e-6)


def test_the_real_recording_is_read(data_folder: Path, tmp_path: Path) -> None:
    path = data_folder / "tracking" / "arkit_expression_973.json"
    [found] = read_in_page(tmp_path, path.read_text())
    recording = read_arkit_recording(path).resampled(float(found["fps"]))
    values = np.array([[frame.get(name, 0) for name in ARKIT_NAMES] for frame in found["frames"]])
    assert abs(len(values) - len(recording.scores)) <= 1 and len(values) > 900
    count = min(len(values), len(recording.scores))
    np.testing.assert_allclose(np.clip(values, 0, 1)[:count], recording.scores[:count], atol=2e-3)


def test_other_files_are_refused_with_a_reason(tmp_path: Path) -> None:
    names = json.dumps(list(ARKIT_NAMES))
    texts = {
        "": "lines of scores", "{": "no valid JSON", "[]": "names and frames", '{"names": 3}': "names and frames",
        "a,b\n1,2": "found 0 of them",
        f'{{"names": {names}, "frames": [{{"weights": [1]}}]}}': "rows of numbers",
        f'{{"names": {names}, "frames": []}}': "names and frames",
        f'{{"names": {names}, "frames": [null, {{"weights": {json.dumps(["x"] * 52)}}}]}}': "rows of numbers",
    }  # fmt: skip
    for found, reason in zip(read_in_page(tmp_path, *texts), texts.values(), strict=True):
        assert isinstance(found, str) and reason in found


def test_scores_become_drives_within_the_training_range(tmp_path: Path) -> None:
    low, high, zone = [-0.5, 0.0], [0.5, 0.2], [0.15, 0.05]
    limits = {"expression": [low, high, zone]}
    arkit = {"jawOpen": [["expression", 0, 2.0]], "mouthClose": [["expression", 0, -1.0], ["expression", 1, 0.5]]}
    description = {
        "head": {"expressions": 2, "joint_names": ["root"]}, "camera": {"intrinsics": [1, 1, 0, 0]},
        "rest": {"view": list(range(12))}, "controls": {"arkit": arkit, "limits": limits},
    }  # fmt: skip
    cases = [{"jawOpen": 0.1}, {"jawOpen": 7, "mouthClose": 0.5}, {"mouthClose": -3, "nose": 1}, {}]
    script = """
    if (softClip(3, 0, 1, 0) !== 1 || softClip(0, 0, 0, 0) !== 0) throw new Error("a zone of zero is no division");
    return values.cases.map((scores) => arkitDrive(values.description, scores).expression);
    """
    values = {"cases": cases, "description": description}
    found = run_modules(script, "drives", folder=tmp_path, values=values)
    raw = np.array([[0.2, 0], [2 - 0.5, 0.25], [0, 0], [0, 0]])
    # soft_clip takes the range from samples and the zone as a share of it: 0.15 of 1, and 0.25 of 0.2.
    first = soft_clip(raw[:, :1], np.array([[-0.5], [0.5]]), 0.15)
    second = soft_clip(raw[:, 1:], np.array([[0.0], [0.2]]), 0.25)
    expected = np.concatenate((first, second), axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-7)


def test_clips_are_filled_in_evenly_and_stay_rigid(tmp_path: Path) -> None:
    poses = []
    for angle in (0.0, 0.8):
        turn = axis_angle_to_matrix(torch.tensor([0.0, angle, 0.0]))
        poses.append(rigid(turn, torch.tensor([angle, 0.0, 1.0]))[:3].flatten().tolist())
    plain = {"expression": [[0.0], [1.0]], "joint_rotations": [[0.0] * 3] * 2, "eyelids": [[0.0, 0.0]] * 2}
    plain |= {"translation": [[0.0] * 3] * 2, "intrinsics": [[1.0] * 4] * 2}
    plain |= dict.fromkeys(("head_to_camera", "torso_to_camera", "world_to_camera"), poses)
    script = """
    const arrays = Object.fromEntries(Object.entries(values).map(([name, rows]) =>
      [name, { shape: [2, rows[0].length], data: Float32Array.from(rows.flat()) }]));
    return [0, 0.5, 1, 9, -1].map((position) => clipDrive({ frames: [10, 20], arrays }, position));
    """
    start, middle, end, beyond, before = run_modules(script, "drives", folder=tmp_path, values=plain)
    assert middle["expression"] == [0.5] and beyond == end and before == start
    pose = np.reshape(middle["head_to_camera"], (3, 4))
    np.testing.assert_allclose(pose[:, :3], axis_angle_to_matrix(torch.tensor([0.0, 0.4, 0.0])).numpy(), atol=1e-6)
    np.testing.assert_allclose(pose[:, 3], [0.4, 0, 1], atol=1e-6)


def test_the_view_turns_like_our_orbit(tmp_path: Path) -> None:
    view = rigid(axis_angle_to_matrix(torch.tensor([3.0, 0.1, 0.2])), torch.tensor([0.1, 0.05, 0.9]))
    center = torch.tensor([0.01, 0.08, -0.02])
    camera = Camera(torch.eye(3), view, 10, 10)
    flat = view[:3].flatten().tolist()
    script = """
    const orbit = new Orbit({ yaw: [-0.5, 0.5], pitch: [-0.3, 0.3] }, values.center);
    const drive = { world_to_camera: values.view, head_to_camera: values.view };
    const out = [];
    orbit.turn(0.4, -0.2); out.push(orbit.view(drive)); orbit.turn(0.4, 0); out.push(orbit.view(drive));
    orbit.setFree(true); orbit.turn(0.4, 0); out.push(orbit.view(drive)); orbit.reset(); out.push(orbit.view(drive));
    return out;
    """
    found = run_modules(script, "orbit", folder=tmp_path, values={"view": flat, "center": center.tolist()})
    wanted = [(0.4, -0.2), (0.5, -0.2), (0.9, -0.2), (0.0, 0.0)]
    for numbers, (yaw, pitch) in zip(found, wanted, strict=True):
        expected = orbit_camera(camera, center, yaw, pitch).world_to_camera[:3].flatten()
        np.testing.assert_allclose(numbers, expected.numpy(), atol=1e-6)


def test_a_turned_head_leaves_a_jointed_torso_where_it_was(tmp_path: Path) -> None:
    script = """
    const description = { head: { joint_names: ["root", "neck", "cervical"] }, moves_camera: true };
    const one = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0];
    const drive = { joint_rotations: [0, 0, 0, 0, 0, 0, 0.1, 0.2, 0], head_to_camera: one, world_to_camera: one };
    const neck = [0, -0.1, 0];
    const turned = turnedHead(drive, { yaw: 0.3, pitch: 0.1, roll: -0.2 }, description, neck);
    const joint = (d) => rigid(rotation(...d.joint_rotations.slice(6, 9)), 0, 0, 0);
    const about = (m) => turnAbout([m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]], neck);
    return [compose(turned.world_to_camera, about(joint(turned))), compose(one, about(joint(drive))),
            turnedHead(drive, { yaw: 0, pitch: 0, roll: 0 }, description, neck) === drive];
    """
    after, before, same = run_modules(script, "drives", "algebra", folder=tmp_path)
    np.testing.assert_allclose(after, before, atol=1e-9)
    assert same


@pytest.mark.parametrize(
    ("message", "answer"),
    [
        ({"ggavatar": "drive", "arkit": {"jawOpen": 0.5}, "head": {"yaw": 0.1}}, None),
        ({"ggavatar": "drive", "arkit": {"jawOpen": "x"}}, "drive: expected finite numbers in arkit and head"),
        ({"ggavatar": "drive", "arkit": 5}, "drive: expected finite numbers in arkit and head"),
        ({"ggavatar": "play", "performance": "no"}, "play: there is no such performance"),
        ({"ggavatar": "view", "yaw": None}, "view: expected finite numbers yaw, pitch and distance"),
        ({"ggavatar": "dance"}, "expected drive, rest, play, pause or view, found dance"),
        ({"other": 1}, None), ("text", None), (None, None), ([1], None),
    ],
)  # fmt: skip
def test_messages_are_obeyed_or_answered(message: Any, answer: str | None, tmp_path: Path) -> None:
    script = """
    const done = [];
    const note = (name) => (...given) => { done.push([name, ...given]); return given[0] !== "no"; };
    const actions = Object.fromEntries(["drive", "rest", "play", "pause", "view"].map((name) => [name, note(name)]));
    return { answer: obeyed(values, actions), done };
    """
    found = run_modules(script, "embed", folder=tmp_path, values=message)
    assert found["answer"] == answer
    if answer is None and isinstance(message, dict) and "ggavatar" in message:
        assert found["done"] == [["drive", {"jawOpen": 0.5}, {"yaw": 0.1, "pitch": 0, "roll": 0}]]


def test_play_back_loops_or_stops_and_pictures_shrink_while_slow(tmp_path: Path) -> None:
    script = """
    const positions = [true, false].map((loops) => {
      const player = new Player({ loops });
      player.choose({ fps: 10, length: 5, drive: (p) => p });
      player.playing = true;
      const seen = [0.1, 0.2, 0.25].map((dt) => { player.advance(dt); return player.drive(); });
      return [...seen, player.playing];
    });
    const quality = new Quality({ width: 256, height: 128 });
    const sizes = [quality.size(1000, true)];
    for (const ms of [500, 500, 500, 10, 50]) { quality.note(ms); sizes.push(quality.size(1000, false)); }
    return { positions, sizes, rest: quality.size(300, true) };
    """
    found = run_modules(script, "player", "quality", folder=tmp_path)
    np.testing.assert_allclose(found["positions"][0], [1, 3, 1.5, True])
    np.testing.assert_allclose(found["positions"][1], [1, 3, 4, False])
    assert found["sizes"] == [[512, 256], [256, 128], [128, 64], [128, 64], [256, 128], [256, 128]]
    assert found["rest"] == [300, 150]
