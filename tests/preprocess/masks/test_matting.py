"""Masks. References: a chroma key, connected components of scipy, and made-up networks whose answer is known.

Also covers `preprocess/masks/grabcut.py`, `preprocess/masks/networks.py`.
"""

from __future__ import annotations

import sys
import types
import warnings
from dataclasses import dataclass

import numpy as np
import pytest
from scipy import ndimage

from ggavatar.errors import InputError
from ggavatar.io.ordered_map import MAX_QUEUED_RESULTS, available_cores
from preprocess.masks.cleanup import coverage_to_mask, keep_largest_component
from preprocess.masks.matting import SelfieMatting, open_matting


@dataclass
class Known:
    """A network that always gives the brightness of the image's red channel, noisy from call to call."""

    noise: float = 0.0
    calls: int = 0

    def coverage(self, image):
        self.calls += 1
        generator = np.random.default_rng(self.calls)
        clean = image[..., 0].astype(np.float32) / 255
        return np.clip(clean + generator.normal(0, self.noise, clean.shape), 0, 1).astype(np.float32)


def disc(x, size=64):
    rows, columns = np.mgrid[:size, :size]
    image = np.zeros((size, size, 3), np.uint8)
    image[(rows - 32) ** 2 + (columns - x) ** 2 < 18**2] = 255
    return image


def overlap(mask, truth):
    return np.count_nonzero((mask > 127) & truth) / np.count_nonzero((mask > 127) | truth)


def test_order_size_and_mirroring():
    images = [disc(20 + 3 * step) for step in range(7)]
    masks = list(SelfieMatting(Known()).masks(images))
    assert len(masks) == 7
    for image, mask in zip(images, masks, strict=True):
        assert mask.shape == (64, 64) and mask.dtype == np.uint8
        assert overlap(mask, image[..., 0] > 127) > 0.95


@pytest.mark.parametrize("count", [0, 1, 2])
def test_short_clips(count):
    assert len(list(SelfieMatting(Known()).masks(disc(30) for _ in range(count)))) == count


def test_still_images_get_steadier():
    images = [disc(32)] * 12
    raw = [coverage_to_mask(Known(0.2, calls).coverage(disc(32)), 64, 64) for calls in range(12)]
    steady = list(SelfieMatting(Known(0.2)).masks(images))
    inside = np.s_[24:40, 24:40]
    flicker = [np.abs(np.diff(np.array(masks, float)[:, *inside], axis=0)).mean() for masks in (raw, steady)]
    assert flicker[1] < 0.7 * flicker[0]


def test_only_a_few_images_are_held():
    """One ahead, and what threads work on."""
    held = []

    def images():
        for step in range(1000):
            held.append(step)
            yield disc(30)

    masks = SelfieMatting(Known()).masks(images())
    next(masks)
    assert 2 <= len(held) <= 1 + available_cores() + MAX_QUEUED_RESULTS


def test_only_the_largest_part_stays():
    """Reference: scipy's labeling."""
    generator = np.random.default_rng(0)
    mask = np.zeros((120, 120), np.uint8)
    mask[20:100, 30:90] = 255
    mask[50, 50] = 0
    mask[5:12, 5:12], mask[110:115, 100:110] = 200, 255
    mask[generator.integers(0, 15, 20), generator.integers(95, 119, 20)] = 255
    labels, _ = ndimage.label(mask > 16, structure=np.ones((3, 3)))
    sizes = np.bincount(labels.ravel())[1:]
    found = keep_largest_component(mask)
    expected = labels == 1 + np.argmax(sizes)
    assert np.array_equal(found > 16, expected | (np.indices(mask.shape) == 50).all(axis=0))
    assert not keep_largest_component(np.zeros((9, 9), np.uint8)).any()


def test_unknown_masks():
    with pytest.raises(InputError, match="no such file or folder"):
        open_matting("rvm.onnx", None, True)


def test_files_that_are_no_networks(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", FakeRuntime())
    for name in ("x.torchscript", "x.pt", "x.pth", "x.onnx", "x"):
        (tmp_path / name).write_bytes(b"nothing")
        with pytest.raises(InputError, match=name) as caught:
            open_matting(str(tmp_path / name), None, True)
        assert "ggavatar-models --fetch rvm" in str(caught.value)


def test_torchscript_does_not_run(tmp_path):
    """A scripted network that overwrites a file when it is called; nothing is loaded, and the file stays."""
    import torch

    victim = tmp_path / "victim"
    victim.write_bytes(b"mine")

    class Writes(torch.nn.Module):
        def __init__(self, name: str) -> None:
            super().__init__()
            self.name = name

        def forward(self, x: torch.Tensor) -> torch.Tensor:
            torch.from_file(self.name, shared=True, size=1024, dtype=torch.uint8).fill_(65)
            return x

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torch says that TorchScript is old
        torch.jit.script(Writes(str(victim))).save(str(tmp_path / "rvm.torchscript"))
    for name in ("rvm.torchscript", "rvm.pt", "rvm.onnx"):
        (tmp_path / name).write_bytes((tmp_path / "rvm.torchscript").read_bytes())
        with pytest.raises(InputError, match=name):
            list(open_matting(str(tmp_path / name), None, True).masks([disc(30)]))
    assert victim.read_bytes() == b"mine"


class FakeRuntime(types.ModuleType):
    """onnxruntime with RVM's signature, whose alpha is the number of images it has seen, in tenths."""

    def __init__(self, outputs=6, names=("src", "r1i", "r2i", "r3i", "r4i", "downsample_ratio")):
        super().__init__("onnxruntime")
        self.outputs, self.names = outputs, names

    def SessionOptions(self):
        return types.SimpleNamespace()

    def InferenceSession(self, content, options, **_):
        assert options.log_severity_level == 4
        if content != b"network":
            raise RuntimeError("INVALID_PROTOBUF\nmore")
        return self

    def get_inputs(self):
        return [types.SimpleNamespace(name=name) for name in self.names]

    def run(self, _, inputs):
        count = inputs["r1i"] + 1
        alpha = count / 10 + 0 * inputs["src"][:, :1]
        return [inputs["src"], alpha, count, count, count, count][: self.outputs]


def test_rvm_carries_its_state(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", FakeRuntime())
    (tmp_path / "rvm.onnx").write_bytes(b"network")
    masks = list(open_matting(str(tmp_path / "rvm.onnx"), None, True).masks(disc(30) for _ in range(3)))
    assert [round(mask.mean() / 25.5) for mask in masks] == [1, 2, 3]


@pytest.mark.parametrize("fake", [FakeRuntime(outputs=4), FakeRuntime(names=("x",))])
def test_another_network_than_rvm(fake, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", fake)
    (tmp_path / "other.onnx").write_bytes(b"network")
    with pytest.raises(InputError, match=r"other\.onnx: expected"):
        list(open_matting(str(tmp_path / "other.onnx"), None, True).masks([disc(30)]))


def test_a_network_that_reads_other_files(tmp_path):
    """ONNX's external tensors: `StringStringEntryProto {key: "location", value: …}`, by its specification."""
    entry = b"\x0a\x08location\x12\x0b/etc/passwd"
    (tmp_path / "external.onnx").write_bytes(b"\x08\x07\x3a" + bytes([len(entry)]) + entry)
    with pytest.raises(InputError, match="reads others"):
        open_matting(str(tmp_path / "external.onnx"), None, True)


def test_without_onnxruntime(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    (tmp_path / "rvm.onnx").write_bytes(b"network")
    with pytest.raises(InputError, match="pip install onnxruntime"):
        open_matting(str(tmp_path / "rvm.onnx"), None, True)


def test_rvm_by_name_says_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setenv("GGAVATAR_MODELS", str(tmp_path))
    monkeypatch.setenv("GGAVATAR_CACHE", str(tmp_path / "cache"))
    with pytest.raises(InputError, match="ggavatar-models --fetch rvm"):
        open_matting("rvm", None, True)


def key(image):
    """Coverage by chroma key of a green screen."""
    levels = image.astype(np.float32)
    corner = np.median(levels[:40, :40].reshape(-1, 3), axis=0)
    excess = levels[..., 1] - np.maximum(levels[..., 0], levels[..., 2])
    return 1 - np.clip((excess - 20) / (corner[1] - max(corner[0], corner[2]) - 40), 0, 1)


@pytest.mark.weights
def test_green_screen(data_folder, models_folder):
    """Goal of the project: IoU ≥ 0.985 against the chroma key, and a background that does not flicker."""
    from preprocess.video.decoding import Video

    frames = [frame.image for frame in Video(data_folder / "clips" / "greenscreen_512.mp4").frames()][:24]
    masks = np.array(list(open_matting("selfie", models_folder, True).masks(frames)))
    truth = np.array([key(frame) for frame in frames])
    assert np.mean([overlap(mask, alpha > 0.5) for mask, alpha in zip(masks, truth, strict=True)]) >= 0.985
    outside = np.array([ndimage.binary_dilation(alpha > 0.01, iterations=20) for alpha in truth]).any(axis=0)
    assert masks[:, ~outside].max() == 0


@pytest.mark.weights
def test_grabcut_says_it_is_a_fallback(data_folder):
    from preprocess.video.decoding import Video

    frames = [frame.image for frame in Video(data_folder / "clips" / "greenscreen_512.mp4").frames()][:6]
    matting = open_matting("grabcut", None, True)
    assert "fallback" in matting.warnings[0]
    for frame, mask in zip(frames, matting.masks(frames), strict=True):
        assert overlap(mask, key(frame) > 0.5) > 0.93
    with pytest.raises(InputError, match="no face"):
        next(matting.masks([np.zeros((64, 64, 3), np.uint8)]))
