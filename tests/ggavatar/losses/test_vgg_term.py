"""The perceptual term: weight on images, expected weight on crops, and what it says about itself."""

from __future__ import annotations

import pytest
import torch

from ggavatar.losses.crop_sampler import CropSampler
from ggavatar.losses.vgg_term import PerceptualTerm


class Pixels(torch.nn.Module):
    """Compares pixels, in place of VGG16's features."""

    name = "random"

    def forward(self, image: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
        return (image - target).abs().mean()


@pytest.fixture
def network(monkeypatch: pytest.MonkeyPatch) -> Pixels:
    """What the term loads, whatever weights are at hand."""
    monkeypatch.setattr("ggavatar.losses.vgg_term.perceptual_loss", lambda features: Pixels())
    return Pixels()


def test_whole_images_weigh_as_stated(network: Pixels) -> None:
    image, target = torch.rand(2, 16, 20, 3, generator=torch.Generator().manual_seed(0)).unbind(0)
    term = PerceptualTerm(0.02)
    assert term.notes() == {}
    assert torch.equal(term(image, target, 1)["perceptual"], 0.02 * network(image, target))
    assert term.notes() == {"perceptual_loss": "random"}


def test_crops_have_the_same_expected_weight_and_repeat_themselves(network: Pixels) -> None:
    """With crops as large as the image every look is the whole loss at 1/chance of its weight."""
    image, target = torch.rand(2, 16, 16, 3, generator=torch.Generator().manual_seed(1)).unbind(0)
    term = PerceptualTerm(0.02, CropSampler(side=16, probability=0.25), seed=5)
    looks = [term(image, target, step) for step in range(200)]
    seen = [look["perceptual"] for look in looks if look]
    assert 30 < len(seen) < 70
    assert torch.allclose(torch.stack(seen), 4 * 0.02 * network(image, target))
    again = PerceptualTerm(0.02, CropSampler(side=16, probability=0.25), seed=5)
    assert [bool(again(image, target, step)) for step in range(200)] == [bool(look) for look in looks]


def test_the_chosen_features_are_loaded_on_first_use_and_once(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def load(features: str) -> Pixels:
        asked.append(features)
        return Pixels()

    monkeypatch.setattr("ggavatar.losses.vgg_term.perceptual_loss", load)
    image = torch.zeros(16, 16, 3)
    never = PerceptualTerm(0.02, CropSampler(side=16, probability=0.0), features="vgg16")
    assert never(image, image, 1) == {} and never.notes() == {} and asked == []
    term = PerceptualTerm(0.02, features="vgg16")
    assert asked == []
    for step in range(2):
        term(image, image, step)
    assert asked == ["vgg16"] and term.notes() == {"perceptual_loss": "random"}
    PerceptualTerm(0.02)(image, image, 1)
    assert asked == ["vgg16", "best"]
