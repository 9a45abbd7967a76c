"""LPIPS (Zhang et al. 2018, v0.1) in plain torch.

The lpips package would need torchvision, which we do not depend on; it is the oracle in the tests.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn
from torch.nn.functional import conv2d

from evaluate.metrics.network_files import UNIT_RANGE, LpipsFiles, find_lpips, network_of
from ggavatar.errors import InputError
from ggavatar.io.digests import sha256_of
from ggavatar.pretrained.resolve import ModelFinder
from ggavatar.pretrained.weights import load_weights

SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
"""Published constants that normalize RGB in [-1, 1] to the statistics of ImageNet."""


class Fire(nn.Module):
    """SqueezeNet's Fire module: 1×1 squeeze, then parallel 1×1 and 3×3 expansions (Iandola et al. 2016, Sec. 3.2)."""

    def __init__(self, channels: int, squeezed: int, expanded: int) -> None:
        super().__init__()
        self.squeeze = nn.Conv2d(channels, squeezed, 1)
        self.expand1x1 = nn.Conv2d(squeezed, expanded, 1)
        self.expand3x3 = nn.Conv2d(squeezed, expanded, 3, padding=1)

    def forward(self, x: Float[Tensor, "B C H W"]) -> Float[Tensor, "B D H W"]:
        """Both expansions, concatenated."""
        squeezed = self.squeeze(x).relu()
        return torch.cat((self.expand1x1(squeezed).relu(), self.expand3x3(squeezed).relu()), dim=1)


def _alexnet() -> tuple[nn.Sequential, tuple[int, ...]]:
    layers: list[nn.Module] = [nn.Conv2d(3, 64, 11, 4, 2), nn.ReLU(), nn.MaxPool2d(3, 2)]
    layers += [nn.Conv2d(64, 192, 5, padding=2), nn.ReLU(), nn.MaxPool2d(3, 2)]
    for before, after in ((192, 384), (384, 256), (256, 256)):
        layers += [nn.Conv2d(before, after, 3, padding=1), nn.ReLU()]
    return nn.Sequential(*layers), (1, 4, 7, 9, 11)


def _vgg16() -> tuple[nn.Sequential, tuple[int, ...]]:
    layers: list[nn.Module] = []
    taps = []
    channels = 3
    for width, repeats in ((64, 2), (128, 2), (256, 3), (512, 3), (512, 3)):
        layers += [nn.MaxPool2d(2, 2)] if layers else []
        for _ in range(repeats):
            layers += [nn.Conv2d(channels, width, 3, padding=1), nn.ReLU()]
            channels = width
        taps.append(len(layers) - 1)
    return nn.Sequential(*layers), tuple(taps)


def _squeezenet() -> tuple[nn.Sequential, tuple[int, ...]]:
    def pool() -> nn.Module:
        return nn.MaxPool2d(3, 2, ceil_mode=True)

    layers: list[nn.Module] = [nn.Conv2d(3, 64, 3, 2), nn.ReLU(), pool(), Fire(64, 16, 64), Fire(128, 16, 64), pool()]
    layers += [Fire(128, 32, 128), Fire(256, 32, 128), pool()]
    layers += [Fire(256, 48, 192), Fire(384, 48, 192), Fire(384, 64, 256), Fire(512, 64, 256)]
    return nn.Sequential(*layers), (1, 4, 7, 9, 10, 11, 12)


NETWORKS = {"alex": _alexnet, "vgg": _vgg16, "squeeze": _squeezenet}


class Lpips(nn.Module):
    """Distance of deep features: sum over layers of the spatial mean of w · (difference of unit features)².

    Args:
        net: `alex`, `vgg` or `squeeze`.
    """

    shift: Tensor
    scale: Tensor

    def __init__(self, net: str) -> None:
        super().__init__()
        self.features, self.taps = NETWORKS[net]()
        for layer in self.features:
            if isinstance(layer, nn.ReLU):
                layer.inplace = False
        self.heads: list[Tensor] = []
        self.register_buffer("shift", torch.tensor(SHIFT)[:, None, None])
        self.register_buffer("scale", torch.tensor(SCALE)[:, None, None])

    def forward(self, first: Float[Tensor, "B 3 H W"], second: Float[Tensor, "B 3 H W"]) -> Float[Tensor, " B"]:
        """LPIPS of image pairs.

        Args:
            first: RGB in [-1, 1]. Code derived from 3DGS feeds [0, 1] instead; such values carry another name.
            second: Likewise.
        """
        # Channels last: on CPUs pooling takes a tenth of the time, the whole network three quarters.
        x = torch.cat((first, second)).contiguous(memory_format=torch.channels_last)
        x = (x - self.shift).div_(self.scale)
        total = x.new_zeros(len(first))
        heads = iter(self.heads)
        for index, layer in enumerate(self.features):
            x = layer(x)
            if index in self.taps:
                one, other = (x / (x.square().sum(1, keepdim=True).sqrt() + 1e-10)).chunk(2)
                total = total + conv2d((one - other).square(), next(heads)).mean(dim=(1, 2, 3))
        return total


def load_lpips(net: str, files: LpipsFiles) -> Lpips:
    """LPIPS with weights from files; nothing in them can run code.

    Raises:
        InputError: A file is damaged, or lacks layers of the network.
    """
    model = Lpips(net)
    backbone = load_weights(files.backbone)
    features = {key.removeprefix("features."): value for key, value in backbone.items() if key.startswith("features.")}
    wanted = model.features.state_dict()
    missing = [key for key, value in wanted.items() if key not in features or features[key].shape != value.shape]
    if missing:
        raise InputError(
            f"{files.backbone}: expected the layers of {net}, found none or another shape for features.{missing[0]}; "
            "use torchvision's file"
        )
    model.features.load_state_dict({key: features[key] for key in wanted})
    heads = load_weights(files.head)
    names = [f"lin{k}.model.1.weight" for k in range(len(model.taps))]
    if absent := [name for name in names if name not in heads]:
        raise InputError(f"{files.head}: expected {absent[0]}, found {sorted(heads)[:3]}; use the heads of LPIPS v0.1")
    model.heads = [heads[name].float() for name in names]
    return model.eval().requires_grad_(False)


def to_signed(image: UInt8[np.ndarray, "H W 3"]) -> Float[Tensor, "1 3 H W"]:
    """8-bit RGB as a float tensor in [-1, 1]."""
    return torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1)))[None].float() / 127.5 - 1


class PerceptualMetrics:
    """The learned metrics of a protocol: loaded once, usable from any thread.

    Attributes:
        missing: Metrics that cannot be measured, with the reason.
        hashes: SHA-256 of the weight files by name.
    """

    def __init__(self, names: Sequence[str], models: ModelFinder) -> None:
        """Load the networks of the metrics `names` that can be found or fetched."""
        found = find_lpips(names, models)
        files = {net: value for net, value in found.items() if isinstance(value, LpipsFiles)}
        self.missing = {name: str(found[network_of(name)]) for name in names if network_of(name) not in files}
        self.hashes = {
            f"{net}/{path.name}": sha256_of(path) for net, pair in files.items() for path in (pair.backbone, pair.head)
        }
        self._names = [name for name in names if name not in self.missing]
        self._models = {net: load_lpips(net, pair) for net, pair in files.items()}
        self._lock = threading.Lock()

    @torch.inference_mode()
    def measure(self, prediction: UInt8[np.ndarray, "H W 3"], truth: UInt8[np.ndarray, "H W 3"]) -> Mapping[str, float]:
        """Values by metric name of one pair of images."""
        signed = to_signed(prediction), to_signed(truth)
        # torch parallelizes over one pair; several pairs at once would only compete for the same cores.
        with self._lock:
            return {name: self._distance(name, *signed) for name in self._names}

    def _distance(self, name: str, first: Tensor, second: Tensor) -> float:
        if name.endswith(UNIT_RANGE):
            first, second = (first + 1) / 2, (second + 1) / 2
        return float(self._models[network_of(name)](first, second))
