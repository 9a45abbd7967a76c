"""The export of a page: what is in the file, what is refused, and that nothing is written by halves.

Also covers `formats/web/clips.py`, `formats/web/container.py`, `formats/web/controls.py`, `formats/web/description.py`,
`formats/web/options.py`, `formats/web/tensors.py`, `ggavatar/formats/licensed_heads.py` and `formats/performances.py`.
"""

from __future__ import annotations

import dataclasses
import gzip
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.numpy import load

from evaluate.rendering.performances import transferred_performance
from ggavatar.core import Drive
from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.formats import performances
from ggavatar.formats.driving_options import DrivingOptions
from ggavatar.formats.performances import carried_over
from ggavatar.formats.web import export as exporting
from ggavatar.formats.web.clips import Clip, capture_clip, clip_arrays, clip_rate
from ggavatar.formats.web.container import pack
from ggavatar.formats.web.controls import limits, sliders, view_range
from ggavatar.formats.web.export import export_web
from ggavatar.formats.web.options import WebOptions, check_web_options
from ggavatar.formats.web.tensors import avatar_tensors, chosen_rows, rounded
from ggavatar.gaussians.bound_parts import posed
from ggavatar.geometry.transforms import axis_angle_to_matrix, rigid
from ggavatar.head.head_pose import HeadPoses
from ggavatar.training.run_folder import Run
from tests.support.page_modules import carried_bytes, run_modules
from tests.support.untrained_avatars import random_drives, run_of, untrained, with_everything


@pytest.fixture(scope="module")
def run(toy_capture: Capture) -> Run:
    avatar, reader = untrained("ggavatar_plus", toy_capture, 100)
    return run_of(avatar, reader, toy_capture)


@pytest.fixture(scope="module")
def page(run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("web") / "avatar.html"
    written = export_web(run, WebOptions(), path, overwrite=False)
    assert written.bytes == path.stat().st_size and 0 < written.gaussians <= written.before
    assert written.psnr is not None and written.psnr > 38
    assert written.notes == ("ARKit's curves have no map to the head egg-1",)
    return path


def content(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    blob = gzip.decompress(carried_bytes(path))
    header = json.loads(blob[8 : 8 + int.from_bytes(blob[:8], "little")])
    return load(blob), json.loads(header["__metadata__"]["avatar"])


def test_the_file_holds_the_avatar_and_says_what_it_is(run: Run, page: Path) -> None:
    tensors, description = content(page)
    assert (description["schema"], description["version"]) == ("ggavatar-web", 1)
    assert description["title"] == "egg · any" and description["embed"] is None
    assert description["created_by"] == {
        "ggavatar": description["created_by"]["ggavatar"],
        "step": 1,
        "run_sha256": "00",
    }
    assert description["clips"] == [{"name": "test frames", "fps": 4.0, "frames": list(run.split.test)}]
    assert description["gaussians"] == len(tensors["face"]) and (np.diff(tensors["face"].astype(int)) >= 0).all()
    assert description["adjuster"]["rank"] == tensors["adjuster.hidden"].shape[1] == 16
    assert description["head"]["joint_names"] == list(run.avatar.avatar.head.joint_names)
    text = page.read_text()
    assert str(run.folder) not in text and "noindex" in text, "nothing of this machine is in it"


def test_the_page_refuses_damaged_files_in_words(page: Path, tmp_path: Path) -> None:
    """Structured faults and a thousand random bytes: every refusal is a sentence, none a failure of the code."""
    (tmp_path / "avatar.bin").write_bytes(gzip.decompress(carried_bytes(page)))
    script = """
    const whole = new Uint8Array(fs.readFileSync(values.path));
    const size = Number(new DataView(whole.buffer).getBigUint64(0, true));
    const text = new TextDecoder().decode(whole.subarray(8, 8 + size));
    const refusal = (bytes) => {
      try { unpack(bytes.buffer); } catch (e) { return e instanceof Damaged ? e.message : `FAILURE ${e.stack}`; }
      return null;
    };
    const withHeader = (change) => {
      const header = JSON.parse(text);
      const description = JSON.parse(header.__metadata__.avatar);
      change(header, description);
      if (header.__metadata__) header.__metadata__.avatar = JSON.stringify(description);
      const encoded = new TextEncoder().encode(JSON.stringify(header));
      const bytes = new Uint8Array(8 + encoded.length + whole.length - 8 - size);
      new DataView(bytes.buffer).setBigUint64(0, BigInt(encoded.length), true);
      bytes.set(encoded, 8);
      bytes.set(whole.subarray(8 + size), 8 + encoded.length);
      return refusal(bytes);
    };
    const faults = [
      (h) => delete h.means, (h) => delete h["means.low"], (h) => { delete h["means.low"]; delete h["means.step"]; },
      (h) => delete h.__metadata__, (h, d) => { d.schema = "x"; },
      (h, d) => { d.version = 2; }, (h) => { h.means.dtype = "F64"; }, (h) => { h.means.data_offsets = [0, 1e9]; },
      (h) => { h.means.data_offsets = [5, 1]; }, (h) => { h.means.shape = [3]; }, (h) => { h.means.shape = "x"; },
      (h, d) => { d.gaussians = 1e9; }, (h, d) => { d.gaussians = "5"; }, (h, d) => { d.head.triangles = 5; },
      (h, d) => { d.adjuster.rank = 3; }, (h, d) => { d.adjuster.layers = 2; }, (h, d) => { d.clips[0].frames.pop(); },
      (h, d) => { d.head.joint_names.pop(); }, (h, d) => { d.sh_degree = 2; },
      (h) => { h["means.step"].shape = [3, 1]; }, (h, d) => { delete d.head; }, (h, d) => { d.clips = null; },
      (h) => { h.face = { ...h.faces, shape: h.face.shape }; },
    ];
    const random = [];
    for (let i = 0, seed = 1; i < 1000; i++) {
      seed = (seed * 48271) % 2147483647;
      const bytes = whole.slice(0, i % 5 ? whole.length : seed % whole.length);
      if (i % 5) bytes[i % 2 ? seed % (8 + size) : seed % bytes.length] ^= 1 << (i % 8);
      const found = refusal(bytes);
      if (found) random.push(found);
    }
    return { untouched: refusal(whole), same: withHeader(() => {}), faults: faults.map(withHeader), random };
    """
    values = {"path": str(tmp_path / "avatar.bin")}
    found = run_modules(script, "container", folder=tmp_path, values=values)
    assert found["untouched"] is None and found["same"] is None
    assert all(isinstance(text, str) and text.startswith("Th") for text in found["faults"]), found["faults"]
    assert len(found["random"]) > 400 and all(text.startswith("Th") for text in found["random"])


def test_equal_exports_are_equal_bytes(run: Run, page: Path, tmp_path: Path) -> None:
    export_web(run, WebOptions(), tmp_path / "again.html", overwrite=False)
    assert (tmp_path / "again.html").read_bytes() == page.read_bytes()


def test_arrays_that_are_not_contiguous_come_back_as_they_were() -> None:
    """safetensors writes them in the order of memory, which is another one."""
    array = np.arange(24, dtype=np.float32).reshape(4, 6)
    views = {"turned": array.T, "strided": array[:, ::2], "swapped": array.reshape(2, 3, 4).transpose(2, 0, 1)}
    assert not any(view.flags.c_contiguous for view in views.values())
    again = load(gzip.decompress(pack(views, {})))
    for name, view in views.items():
        np.testing.assert_array_equal(again[name], view)
    with pytest.raises(ValueError, match="float64"):
        pack({"double": array.astype(np.float64)}, {})
    with pytest.raises(ValueError, match="JSON"):
        pack({}, {"value": float("nan")})


def test_rounding_changes_little_on_a_head_with_everything(run: Run) -> None:
    parts = run.avatar.bound_parts()
    head = with_everything(parts.head)
    drives = random_drives(head, 2, root_still=True)
    parts = dataclasses.replace(parts, head=head, poses=HeadPoses.of(head, drives), adjuster=None)
    for exact, most in ((True, 1e-6), (False, 6e-4)):
        small = rounded(parts, avatar_tensors(parts, exact))
        for drive in drives:
            change = posed(small, drive).means - posed(parts, drive).means
            assert 0 <= float(change.abs().max()) < most
    some = torch.arange(len(parts.face)) % 3 == 0
    kept = chosen_rows(run.avatar.bound_parts(), some)
    assert len(kept.face) == int(some.sum()) and bool((kept.face.diff() >= 0).all())
    assert kept.adjuster is not None and len(kept.adjuster.hidden) == len(kept.face)


def test_what_cannot_be_shown_is_refused(run: Run, toy_capture: Capture, tmp_path: Path) -> None:
    path = tmp_path / "avatar.html"
    other, reader = untrained("flash_avatar", toy_capture, 1)
    with pytest.raises(InputError, match=r"cannot be shown by a web page.*ggavatar-render"):
        export_web(run_of(other, reader, toy_capture), WebOptions(), path, overwrite=False)
    parts = run.avatar.bound_parts()
    flame = dataclasses.replace(parts, head=dataclasses.replace(parts.head, version="flame2023"))
    licensed = dataclasses.replace(run, avatar=SimpleNamespace(bound_parts=lambda: flame))
    with pytest.raises(InputError, match=r"license.*--include-head-model"):
        export_web(licensed, WebOptions(), path, overwrite=False)
    exporting.check_license(licensed.folder, flame.head, "page", True)
    path.write_text("mine")
    with pytest.raises(InputError, match="--overwrite"):
        export_web(run, WebOptions(), path, overwrite=False)
    assert path.read_text() == "mine" and len(list(tmp_path.iterdir())) == 1


def test_an_avatar_that_is_too_large_is_refused(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exporting, "MAX_UNPACKED_BYTES", 1000)
    with pytest.raises(InputError, match="--prune"):
        export_web(run, WebOptions(prune=0.0), tmp_path / "a.html", overwrite=False)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "options",
    [
        {"prune": -0.1}, {"prune": 0.5}, {"prune": float("nan")}, {"rank": 0}, {"clip": "tests"},
        {"embed": "https://example.org/path"}, {"embed": "*"}, {"embed": "https://a.org' onload="}, {"embed": ""},
        {"embed": "example.org"},
    ],
)  # fmt: skip
def test_options_that_cannot_be_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="expected --"):
        check_web_options(WebOptions(**options))


@pytest.mark.parametrize("origin", ["https://example.org", "http://localhost:8000", "https://[::1]:80", "null", None])
def test_origins(origin: str | None) -> None:
    check_web_options(WebOptions(embed=origin))


def test_clips_of_the_capture(run: Run) -> None:
    assert capture_clip(run, "none") is None
    whole, train = capture_clip(run, "all"), capture_clip(run, "train")
    assert whole is not None and train is not None
    assert whole.frames == run.capture.frames and whole.fps == run.capture.fps
    assert train.frames == run.split.train
    arrays = clip_arrays(whole, torch.eye(4))
    assert arrays["head_to_camera"].shape == (len(whole.frames), 12) and arrays["intrinsics"].shape[1] == 4
    np.testing.assert_array_equal(arrays["torso_to_camera"][0], np.eye(3, 4).ravel())
    assert (clip_rate([3, 4, 5], 25.0), clip_rate([3, 23], 25.0), clip_rate([3, 23], 2.0), clip_rate([3], 25.0)) == (
        25,
        4,
        2,
        4,
    )
    long = Clip("long", 25.0, tuple(range(10_001)), whole.drives, whole.cameras)
    with pytest.raises(InputError, match="at most 10000"):
        clip_arrays(long, torch.eye(4))


def test_ranges_are_those_of_the_training(run: Run) -> None:
    head = run.avatar.avatar.head
    drives = [run.reader.drive(number) for number in run.split.train]
    values = torch.stack([drive.expression for drive in drives]).double().numpy()
    low, high, zone = limits(drives)["expression"]
    np.testing.assert_allclose([low, high], [values.min(0), values.max(0)], atol=1e-6)
    width = np.ptp(values, axis=0)
    np.testing.assert_allclose(zone, 0.15 * np.maximum(width, np.median(width)), atol=1e-6)
    still = limits(drives)["joint_rotations"]
    assert min(still[2]) > 0 and still[0][0] == still[1][0] == 0, "what never moves has a zone all the same"
    named = {slider.label: slider for slider in sliders(head, drives)}
    assert [target.place for target in named["gaze sideways"].targets] == [10, 13]
    assert "left lid" not in named, "the egg has no lids"
    assert named["expression 1"].high >= np.quantile(values[:, 0], 0.99) - 1e-3


def test_the_view_is_limited_to_turns_in_training() -> None:
    """Turns by known angles in the camera's axes, as `orbit_camera` makes them."""
    angles = np.radians([(-20, 0), (30, 0), (0, 8), (0, -4), (0, 0)])
    drives = []
    for yaw, pitch in angles:
        turn = axis_angle_to_matrix(torch.tensor([pitch, 0, 0])) @ axis_angle_to_matrix(torch.tensor([0, yaw, 0]))
        drives.append(
            Drive(
                torch.zeros(1), torch.zeros(1, 3), torch.zeros(2), torch.zeros(3), rigid(turn.float(), torch.zeros(3))
            )
        )
    poses = HeadPoses(torch.eye(4), torch.zeros(9), torch.zeros(9), True)
    found = view_range(poses, drives)
    np.testing.assert_allclose(np.degrees(found["yaw"]), [-35, 45], atol=1.5)
    np.testing.assert_allclose(np.degrees(found["pitch"]), [-19, 23], atol=0.7)


def test_another_performance_becomes_a_clip(run: Run, toy_capture: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    point = SimpleNamespace(name="transfer", load=lambda: transferred_performance)
    monkeypatch.setattr(performances, "entry_points", lambda group: [point])
    clip = carried_over(run, toy_capture.folder, DrivingOptions())
    assert clip.frames == toy_capture.frames and clip.fps == toy_capture.fps
    assert {(camera.width, camera.height) for camera in clip.cameras} == {(toy_capture.width, toy_capture.height)}
    own = torch.stack([run.reader.drive(number).expression for number in toy_capture.frames])
    moved = torch.stack([drive.expression for drive in clip.drives])
    assert np.corrcoef(moved.numpy().ravel(), own.numpy().ravel())[0, 1] > 0.5, "its own performance, carried over"
    monkeypatch.setattr(performances, "entry_points", lambda group: [])
    with pytest.raises(InputError, match="pip install"):
        carried_over(run, toy_capture.folder, DrivingOptions())


def test_the_transfer_is_registered() -> None:
    text = (Path(__file__).parents[4] / "pyproject.toml").read_text()
    assert 'transfer = "evaluate.rendering.performances:transferred_performance"' in text
    assert f'entry-points."{performances.ENTRY_POINT_GROUP}"' in text and '"formats/web/page/*"' in text
