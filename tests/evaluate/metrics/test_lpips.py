"""LPIPS against published values, against the lpips package, and against the published formula written out.

Also covers `evaluate/metrics/network_files.py`.
"""

from __future__ import annotations

import sys
import types
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from torch import nn

from evaluate.metrics import lpips as module
from evaluate.metrics.lpips import SCALE, SHIFT, Lpips, PerceptualMetrics, load_lpips, to_signed
from evaluate.metrics.network_files import LpipsFiles, find_lpips
from ggavatar.errors import InputError
from ggavatar.pretrained.resolve import ModelFinder

WIDTHS = {
    "alex": (64, 192, 384, 256, 256),
    "vgg": (64, 128, 256, 512, 512),
    "squeeze": (64, 128, 256, 384, 384, 512, 512),
}


def random_files(folder: Path, net: str, seed: int = 0) -> LpipsFiles:
    """Backbone and heads with random weights, in the layouts of torchvision and of LPIPS v0.1."""
    torch.manual_seed(seed)
    backbone = {f"features.{name}": value for name, value in Lpips(net).features.state_dict().items()}
    heads = {f"lin{k}.model.1.weight": torch.rand(1, width, 1, 1) for k, width in enumerate(WIDTHS[net])}
    files = LpipsFiles(folder / f"{net}_features.pth", folder / f"{net}_heads.pth")
    torch.save(backbone | {"classifier.1.weight": torch.zeros(1)}, files.backbone)
    torch.save(heads, files.head)
    return files


def images(height: int = 64, width: int = 80) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    return tuple(torch.rand(2, 3, height, width, generator=generator) * 2 - 1 for _ in range(2))  # type: ignore[return-value]


def published_formula(model: Lpips, layers: nn.Sequential, first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """Zhang et al. 2018, Eq. 1, one image and one pixel sum at a time, in float64."""
    published = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
    shift, scale = (torch.tensor(values, dtype=torch.float64)[:, None, None] for values in published)
    totals = []
    for one, other in zip(first.double(), second.double(), strict=True):
        features = [((image - shift) / scale)[None] for image in (one, other)]
        total, tap = torch.zeros((), dtype=torch.float64), 0
        for index, layer in enumerate(layers):
            features = [layer(value) for value in features]
            if index in model.taps:
                unit = [value / (value.pow(2).sum(1, keepdim=True).sqrt() + 1e-10) for value in features]
                weighted = model.heads[tap].double()[0, :, 0, 0][:, None, None] * (unit[0] - unit[1])[0].pow(2)
                total = total + weighted.sum() / (weighted.shape[1] * weighted.shape[2])
                tap += 1
        totals.append(total)
    return torch.stack(totals)


@pytest.mark.parametrize("net", ["alex", "vgg", "squeeze"])
def test_arithmetic_equals_the_published_formula_on_random_weights(tmp_path: Path, net: str) -> None:
    model = load_lpips(net, random_files(tmp_path, net))
    first, second = images()
    found = model(first, second).double()
    expected = published_formula(model, load_lpips(net, random_files(tmp_path, net)).features.double(), first, second)
    torch.testing.assert_close(found, expected, rtol=2e-5, atol=1e-7)
    assert (found > 1e-4).all()
    assert model(first, first).abs().max() == 0


@pytest.fixture(scope="module")
def lpips_package() -> Iterator[types.ModuleType]:
    """The lpips package, with just enough of torchvision for it to import."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        yield import_lpips(monkeypatch)
        for name in [name for name in sys.modules if name.partition(".")[0] == "lpips"]:
            monkeypatch.delitem(sys.modules, name)


def import_lpips(monkeypatch: pytest.MonkeyPatch) -> types.ModuleType:
    for name in ("torchvision", "torchvision.models", "torchvision.transforms", "tqdm", "IPython"):
        if name not in sys.modules:
            monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    models = sys.modules["torchvision.models"]
    for name, net in (("alexnet", "alex"), ("vgg16", "vgg"), ("squeezenet1_1", "squeeze")):
        monkeypatch.setattr(
            models, name, lambda net=net, **_: types.SimpleNamespace(features=Lpips(net).features), raising=False
        )
    monkeypatch.setattr(sys.modules["torchvision"], "models", models, raising=False)
    monkeypatch.setattr(sys.modules["tqdm"], "tqdm", iter, raising=False)
    monkeypatch.setattr(sys.modules["IPython"], "embed", None, raising=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return pytest.importorskip("lpips", reason="the lpips package is not installed", exc_type=ImportError)


@pytest.mark.parametrize("net", ["alex", "vgg", "squeeze"])
def test_arithmetic_equals_the_lpips_package(lpips_package: types.ModuleType, tmp_path: Path, net: str) -> None:
    theirs = lpips_package.LPIPS(net=net, pnet_rand=True, verbose=False).eval()
    files = random_files(tmp_path, net)
    ours = load_lpips(net, files)
    source = iter(ours.features.state_dict().values())
    with torch.no_grad():
        for parameter in theirs.net.parameters():
            parameter.copy_(next(source))
    ours.heads = [value for name, value in theirs.state_dict().items() if name.startswith("lin") and "model.1" in name]
    ours.heads = ours.heads[: len(ours.taps)]
    first, second = images()
    with torch.no_grad():
        torch.testing.assert_close(ours(first, second), theirs(first, second).flatten(), rtol=1e-6, atol=1e-8)
        halved = ours((first + 1) / 2, (second + 1) / 2)
        torch.testing.assert_close(halved, theirs((first + 1) / 2, (second + 1) / 2).flatten(), rtol=1e-6, atol=1e-8)


def sample(folder: Path, name: str) -> np.ndarray:
    """One of the LPIPS authors' example images."""
    image = cv2.imread(str(folder / "lpips_samples" / f"{name}.png"))
    assert image is not None
    return np.ascontiguousarray(image[..., ::-1])


@pytest.mark.weights
@pytest.mark.parametrize(("name", "expected"), [("ex_p0", 0.7219), ("ex_p1", 0.1376)])
def test_alex_gives_the_published_values(
    pretrained: Callable[[str], Path], data_folder: Path, name: str, expected: float
) -> None:
    pretrained("alexnet"), pretrained("lpips_alex")
    metrics = PerceptualMetrics(["lpips_alex", "lpips_alex_unit_range"], ModelFinder())
    found = metrics.measure(sample(data_folder, name), sample(data_folder, "ex_ref"))
    assert found["lpips_alex"] == pytest.approx(expected, abs=1e-3)
    assert abs(found["lpips_alex_unit_range"] - found["lpips_alex"]) > 1e-3
    assert metrics.missing == {}
    assert len(metrics.hashes) == 2 and all(len(value) == 64 for value in metrics.hashes.values())


@pytest.mark.weights
def test_squeeze_is_measured_where_its_weights_are(pretrained: Callable[[str], Path], data_folder: Path) -> None:
    pretrained("squeezenet"), pretrained("lpips_squeeze")
    metrics = PerceptualMetrics(["lpips_squeeze"], ModelFinder())
    reference = sample(data_folder, "ex_ref")
    far, near = (metrics.measure(sample(data_folder, name), reference)["lpips_squeeze"] for name in ("ex_p0", "ex_p1"))
    assert far > near > 0.1


VGG_DISTANCES = (0.3497, 0.3494, 0.3473, 0.3558, 0.3437, 0.3366, 0.3716, 0.3516, 0.3472, 0.3413)
"""Printed by lpips 0.1.4, `LPIPS(net="vgg")` with torchvision's VGG16, normalize=True, for `numpy_pairs()`.

They were published in a user's notes on torchmetrics, which prints the same mean, 0.3494; here they are the second
source for all thirteen layers of VGG16.
"""


def numpy_pairs() -> tuple[torch.Tensor, torch.Tensor]:
    """np.random.seed(123), then two arrays of np.random.rand(10, 3, 100, 100), brought from [0, 1] to [-1, 1]."""
    random = np.random.RandomState(123)
    first, second = (torch.tensor(random.rand(10, 3, 100, 100), dtype=torch.float32) for _ in range(2))
    return 2 * first - 1, 2 * second - 1


@pytest.fixture
def vgg(pretrained: Callable[[str], Path]) -> Lpips:
    return load_lpips("vgg", LpipsFiles(pretrained("vgg16"), pretrained("lpips_vgg")))


@pytest.mark.slow
@pytest.mark.weights
def test_vgg_gives_published_values_and_every_kernels_orientation_matters(vgg: Lpips) -> None:
    """Planted in each of the thirteen layers: a transposed kernel, channels shifted by one."""
    first, second = numpy_pairs()
    expected = torch.tensor(VGG_DISTANCES)
    torch.testing.assert_close(vgg(first, second), expected, rtol=0, atol=6e-5)
    convolutions = [layer for layer in vgg.features if isinstance(layer, nn.Conv2d)]
    assert len(convolutions) == 13
    for layer in convolutions:
        right = layer.weight.data
        for wrong in (right.transpose(2, 3), right.roll(1, 0), right.roll(1, 1)):
            layer.weight.data = wrong.contiguous()
            assert (vgg(first[:1], second[:1]) - expected[:1]).abs() > 5e-4
        layer.weight.data = right


@pytest.mark.weights
@pytest.mark.parametrize("name", ["ex_p0", "ex_p1"])
def test_vgg_equals_the_published_formula_with_the_real_weights(vgg: Lpips, data_folder: Path, name: str) -> None:
    first, second = (to_signed(sample(data_folder, image)) for image in (name, "ex_ref"))
    found = vgg(first, second).double()
    layers = vgg.features.double()
    torch.testing.assert_close(found, published_formula(vgg, layers, first, second), rtol=1e-5, atol=1e-7)
    assert found > 0.3


@pytest.fixture
def without_models(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("GGAVATAR_MODELS", raising=False)
    monkeypatch.setenv("GGAVATAR_CACHE", str(tmp_path / "cache"))


@pytest.mark.usefixtures("without_models")
def test_absent_weights_give_a_reason_that_names_the_file() -> None:
    metrics = PerceptualMetrics(["lpips_vgg", "lpips_alex_unit_range"], ModelFinder())
    assert metrics.missing["lpips_vgg"].startswith("no weights: model file vgg16_features.safetensors")
    assert metrics.missing["lpips_alex_unit_range"].startswith("no weights: model file alexnet_features.safetensors")
    assert metrics.measure(np.zeros((64, 64, 3), np.uint8), np.zeros((64, 64, 3), np.uint8)) == {}
    assert set(find_lpips(["lpips_vgg", "lpips_vgg_unit_range"], ModelFinder())) == {"vgg"}


def test_the_unit_range_is_half_the_signed_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = random_files(tmp_path, "vgg")
    monkeypatch.setattr(module, "find_lpips", lambda names, models: {"vgg": files})
    metrics = PerceptualMetrics(["lpips_vgg", "lpips_vgg_unit_range"], ModelFinder())
    random = np.random.default_rng(0)
    first, second = (random.integers(0, 256, (64, 64, 3), dtype=np.uint8) for _ in range(2))
    found = metrics.measure(first, second)
    unit = [(to_signed(image) + 1) / 2 for image in (first, second)]
    assert found["lpips_vgg_unit_range"] == pytest.approx(float(load_lpips("vgg", files)(*unit)), rel=1e-6)
    assert found["lpips_vgg_unit_range"] != pytest.approx(found["lpips_vgg"], rel=1e-3)


def test_a_file_that_runs_code_or_lacks_layers_is_refused(tmp_path: Path) -> None:
    files = random_files(tmp_path, "alex")
    torch.save(Path("not tensors"), files.head)
    with pytest.raises(InputError, match="tensors by name"):
        load_lpips("alex", files)
    files = random_files(tmp_path, "alex")
    torch.save({"features.0.weight": torch.zeros(64, 3, 11, 11)}, files.backbone)
    with pytest.raises(InputError, match=r"features\.0\.bias"):
        load_lpips("alex", files)


def test_normalization_is_as_published() -> None:
    """Zhang et al. 2018, the scaling layer of their code; it belongs to values in [-1, 1]."""
    assert SHIFT == (-0.030, -0.088, -0.188)
    assert SCALE == (0.458, 0.448, 0.450)


def test_bytes_become_numbers_from_minus_one_to_one() -> None:
    image = np.zeros((1, 3, 3), np.uint8)
    image[0, 1], image[0, 2] = 255, (51, 102, 204)
    found = to_signed(image)
    assert found.shape == (1, 3, 1, 3)
    torch.testing.assert_close(found[0, :, 0].T, torch.tensor([[-1.0] * 3, [1.0] * 3, [-0.6, -0.2, 0.6]]))
