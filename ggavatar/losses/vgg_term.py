"""The perceptual loss as a weighted term of an objective: on whole images, or on crops in some of the steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from jaxtyping import Float
from torch import Tensor

from ggavatar.losses.crop_sampler import Box, CropSampler
from ggavatar.losses.vgg import FeatureChoice, PerceptualLoss, perceptual_loss
from ggavatar.optim.seeding import seeded


@dataclass
class PerceptualTerm:
    """λ · L_VGG; the network is loaded on first use and is not part of any `state_dict`.

    Attributes:
        weight: λ in expectation; a crop's loss is divided by the probability that the step has one.
        crops: Sampler of the crops; None compares whole images.
        seed: Seed of the crops.
        stream: Stream of the seed, so that the draws are independent of others.
        features: What is compared: "best", "vgg16" or "random", as in `perceptual_loss`.
    """

    weight: float
    crops: CropSampler | None = None
    seed: int = 42
    stream: int = 3
    features: FeatureChoice = "best"
    _network: list[PerceptualLoss] = field(default_factory=list, repr=False)

    def __call__(
        self, image: Float[Tensor, "H W 3"], target: Float[Tensor, "H W 3"], step: int, boxes: Sequence[Box] = ()
    ) -> dict[str, Tensor]:
        """The term by name; empty in a step without a crop.

        Args:
            image: The rendered image, sRGB.
            target: The ground truth, sRGB.
            step: The current step, which determines the crop.
            boxes: Regions that crops are often centered on.
        """
        weight, window = self.weight, (slice(None), slice(None))
        if self.crops is not None:
            height, width = target.shape[:2]
            drawn = self.crops.draw(height, width, seeded(self.seed, self.stream, step), boxes)
            if drawn is None:
                return {}
            window, weight = drawn, weight / self.crops.probability
        if not self._network:
            self._network.append(perceptual_loss(self.features).to(target.device))
        return {"perceptual": weight * self._network[0](image[window], target[window])}

    def notes(self) -> dict[str, str]:
        """The features that were compared; empty before the first call."""
        return {"perceptual_loss": self._network[0].name} if self._network else {}
