"""The perceptual loss against a network built from torch.nn, its variants, and where crops fall."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from ggavatar.errors import InputError
from ggavatar.losses.crop_sampler import CropSampler
from ggavatar.losses.vgg import PerceptualLoss, perceptual_loss, random_weights
from ggavatar.pretrained.weights import load_weights


@pytest.fixture
def without_models(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """No weights anywhere; returns a folder to put some into."""
    monkeypatch.delenv("GGAVATAR_MODELS", raising=False)
    monkeypatch.setenv("GGAVATAR_CACHE", str(tmp_path / "cache"))
    return tmp_path


def image_pair(side: int = 40) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(1)
    return torch.rand(side, side, 3, generator=generator), torch.rand(side, side, 3, generator=generator)


def network(state: dict[str, Tensor]) -> list[nn.Sequential]:
    """VGG16's blocks as torchvision orders them, cut after relu1_2, relu2_2, relu3_3 and relu4_3."""
    layers: list[nn.Module] = []
    inputs = 3
    for width in (64, 64, 0, 128, 128, 0, 256, 256, 256, 0, 512, 512, 512):
        if width:
            layers += [nn.Conv2d(inputs, width, 3, padding=1), nn.ReLU()]
            inputs = width
        else:
            layers.append(nn.MaxPool2d(2))
    whole = nn.Sequential(*layers)
    whole.load_state_dict({key.removeprefix("features."): value for key, value in state.items()})
    return [whole[:4], whole[4:9], whole[9:16], whole[16:]]


def expected_loss(state: dict[str, Tensor], image: Tensor, target: Tensor) -> Tensor:
    """Johnson et al.'s features by torch's own layers, their mean absolute differences added up."""
    mean, deviation = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    ours, theirs = (((x - mean) / deviation).permute(2, 0, 1)[None] for x in (image, target))
    total = torch.zeros(())
    for block in network(state):
        ours, theirs = block(ours), block(theirs)
        total = total + (ours - theirs).abs().mean()
    return total


def test_equals_a_network_of_torch_layers() -> None:
    image, target = image_pair()
    loss = perceptual_loss("random", seed=3)
    assert loss.name == "random"
    assert loss(image, target).item() == pytest.approx(expected_loss(random_weights(3), image, target).item(), rel=1e-4)


@pytest.mark.weights
def test_trained_weights_are_those_of_the_file_in_all_four_blocks(pretrained: Callable[[str], Path]) -> None:
    """The reference reads torchvision's keys itself; a kernel transposed in any block must be noticed."""
    state = {key: tensor for key, tensor in load_weights(pretrained("vgg16")).items() if int(key.split(".")[1]) < 23}
    image, target = image_pair()
    loss = perceptual_loss()
    found = loss(image, target).item()
    assert loss.name == "vgg16" and [maps.shape[1] for maps in loss.features(image)] == [64, 128, 256, 512]
    assert found == pytest.approx(expected_loss(state, image, target).item(), rel=1e-4)
    for last in (2, 7, 14, 21):
        key = f"features.{last}.weight"
        transposed = state | {key: state[key].transpose(2, 3)}
        assert found != pytest.approx(expected_loss(transposed, image, target).item(), rel=1e-3)


def test_gradient_reaches_the_image_only_and_kept_features_are_as_good() -> None:
    image, target = image_pair()
    loss = perceptual_loss("random")
    image.requires_grad_()
    target.requires_grad_()
    value = loss(image, target)
    value.backward()
    assert image.grad is not None and image.grad.abs().max() > 0 and target.grad is None
    with torch.no_grad():
        kept = loss.features(target)
    assert loss(image, kept).item() == value.item()
    assert loss(target.detach(), target).item() == 0


def test_weights_are_seeded_and_in_no_checkpoint() -> None:
    loss = perceptual_loss("random")
    assert not loss.state_dict() and not list(loss.parameters())
    one, other, third = (random_weights(seed)["features.0.weight"] for seed in (1, 1, 2))
    assert torch.equal(one, other) and not torch.equal(one, third)


def test_the_best_features_without_weights_are_random_and_say_so(
    without_models: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert perceptual_loss().name == "random"
    warning = capsys.readouterr().err
    assert warning.startswith("warning: the perceptual loss compares random features") and warning.count("\n") == 1
    assert "(offline)" in warning and "ggavatar-models --fetch vgg16" in warning
    assert perceptual_loss("random").name == "random" and capsys.readouterr().err == ""


def test_required_weights_are_asked_for_and_damaged_ones_are_never_replaced(without_models: Path) -> None:
    with pytest.raises(InputError, match=r"vgg16_features\.safetensors .*ggavatar-models --fetch vgg16"):
        perceptual_loss("vgg16")
    (without_models / "vgg16-397923af.pth").write_bytes(b"half a download")
    for features in ("best", "vgg16"):
        with pytest.raises(InputError, match="refused"):
            perceptual_loss(features, without_models)


def test_random_weights_keep_the_scale_through_the_blocks() -> None:
    maps = PerceptualLoss("random", random_weights(0)).features(image_pair(64)[0])
    sizes = [float(block.square().mean()) for block in maps]
    assert all(0.1 < size / sizes[0] < 10 for size in sizes[1:])


def test_crops_stay_inside_and_come_as_often_as_asked() -> None:
    generator, sampler = torch.Generator().manual_seed(2), CropSampler(side=16, probability=0.25)
    drawn = [sampler.draw(40, 60, generator) for _ in range(2000)]
    windows = [window for window in drawn if window is not None]
    assert 400 < len(windows) < 600
    for rows, columns in windows:
        assert rows.stop - rows.start == columns.stop - columns.start == 16
        assert rows.start >= 0 and rows.stop <= 40 and columns.start >= 0 and columns.stop <= 60
    assert {rows.start for rows, _ in windows} == set(range(25))
    assert {columns.start for _, columns in windows} == set(range(45))


def test_focused_crops_are_centred_on_boxes_and_small_images_are_taken_whole() -> None:
    generator, always = torch.Generator().manual_seed(3), CropSampler(side=16, probability=1.0, focused=1.0)
    starts = set()
    for _ in range(50):
        window = always.draw(100, 100, generator, boxes=[(40.0, 50.0, 60.0, 58.0), (0.0, 0.0, 4.0, 4.0)])
        assert window is not None
        starts.add((window[0].start, window[1].start))
    assert starts == {(46, 42), (0, 0)}
    assert always.draw(8, 12, generator) == (slice(0, 8), slice(0, 12))


def test_the_same_numbers_are_drawn_whatever_comes_out() -> None:
    states = []
    for probability in (0.0, 1.0):
        generator = torch.Generator().manual_seed(4)
        CropSampler(probability=probability).draw(200, 200, generator)
        states.append(generator.get_state())
    assert torch.equal(*states)


def test_half_of_the_crops_are_centered_on_boxes() -> None:
    """The sampler's default, which all methods use."""
    generator, sampler = torch.Generator().manual_seed(5), CropSampler(side=16, probability=1.0)
    windows = [sampler.draw(100, 100, generator, boxes=[(40.0, 50.0, 60.0, 58.0)]) for _ in range(400)]
    centered = sum(window == (slice(46, 62), slice(42, 58)) for window in windows)
    assert 160 < centered < 240
