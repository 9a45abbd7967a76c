"""LPIPS against published values, against the lpips package, and against the published formula written out."""

from __future__ import annotations

import sys
import types
import warnings
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from torch import nn

from evaluate.metrics.lpips import SCALE, SHIFT, Lpips, PerceptualMetrics, load_lpips, to_signed
from ggavatar.errors import InputError
from ggavatar.pretrained.folders import model_folders
from ggavatar.pretrained.lpips import LpipsFiles, find_lpips

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


@pytest.mark.weights
@pytest.mark.parametrize(("sample", "expected"), [("ex_p0", 0.7219), ("ex_p1", 0.1376)])
def test_alex_gives_the_published_values(models_folder: Path, data_folder: Path, sample: str, expected: float) -> None:
    def read(name: str) -> np.ndarray:
        image = cv2.imread(str(data_folder / "lpips_samples" / f"{name}.png"))
        assert image is not None
        return np.ascontiguousarray(image[..., ::-1])

    metrics = PerceptualMetrics(["lpips_alex", "lpips_squeeze", "lpips_alex_unit_range"], [models_folder])
    found = metrics.measure(read(sample), read("ex_ref"))
    assert found["lpips_alex"] == pytest.approx(expected, abs=1e-3)
    assert found["lpips_squeeze"] > 0.1
    assert abs(found["lpips_alex_unit_range"] - found["lpips_alex"]) > 1e-3
    assert metrics.missing == {}
    assert len(metrics.hashes) == 4
    assert all(len(value) == 64 for value in metrics.hashes.values())


def test_absent_weights_give_a_reason_that_names_the_file(tmp_path: Path) -> None:
    metrics = PerceptualMetrics(["lpips_vgg"], [tmp_path])
    assert "vgg16_features.pth" in metrics.missing["lpips_vgg"]
    assert metrics.measure(np.zeros((64, 64, 3), np.uint8), np.zeros((64, 64, 3), np.uint8)) == {}


def test_weights_are_found_under_torchvisions_names_and_the_unit_range_is_half_the_signed_one(tmp_path: Path) -> None:
    files = random_files(tmp_path, "vgg")
    (tmp_path / "models" / "lpips_heads_v0.1").mkdir(parents=True)
    files.backbone.rename(tmp_path / "models" / "vgg16-397923af.pth")
    files.head.rename(tmp_path / "models" / "lpips_heads_v0.1" / "vgg.pth")
    metrics = PerceptualMetrics(["lpips_vgg", "lpips_vgg_unit_range"], [tmp_path / "models"])
    random = np.random.default_rng(0)
    first, second = (random.integers(0, 256, (64, 64, 3), dtype=np.uint8) for _ in range(2))
    found = metrics.measure(first, second)
    model = load_lpips(
        "vgg", LpipsFiles(*(tmp_path / "models").rglob("*vgg16*"), *(tmp_path / "models").rglob("vgg.pth"))
    )
    unit = [(to_signed(image) + 1) / 2 for image in (first, second)]
    assert found["lpips_vgg_unit_range"] == pytest.approx(float(model(*unit)), rel=1e-6)
    assert found["lpips_vgg_unit_range"] != pytest.approx(found["lpips_vgg"], rel=1e-3)


def test_a_file_that_runs_code_or_lacks_layers_is_refused(tmp_path: Path) -> None:
    files = random_files(tmp_path, "alex")
    torch.save(Path("not tensors"), files.head)
    with pytest.raises(InputError, match="plain tensors"):
        load_lpips("alex", files)
    files = random_files(tmp_path, "alex")
    torch.save({"features.0.weight": torch.zeros(64, 3, 11, 11)}, files.backbone)
    with pytest.raises(InputError, match=r"features\.0\.bias"):
        load_lpips("alex", files)


def test_model_folders_follow_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("GGAVATAR_MODELS", str(tmp_path / "a"))
    monkeypatch.setenv("GGAVATAR_CACHE", str(tmp_path / "b"))
    assert model_folders(tmp_path / "c") == [tmp_path / "c", tmp_path / "a", tmp_path / "b" / "ggavatar" / "models"]
    assert isinstance(find_lpips("alex", model_folders()), str)


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
