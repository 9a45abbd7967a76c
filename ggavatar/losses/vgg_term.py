"""The perceptual loss as a weighted term of an objective: on the whole image, or on crops in some of the steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from jaxtyping import Float
from torch import Tensor

from ggavatar.losses.crop_sampler import CropSampler
from ggavatar.losses.vgg import PerceptualLoss, perceptual_loss
from ggavatar.optim.seeding import seeded

Box = tuple[float, float, float, float]


@dataclass
class PerceptualTerm:
    """λ · L_VGG; the network is loaded when it is first needed and is no part of any state.

    Attributes:
        weight: λ, whatever the mode: a crop seen with some chance weighs 1/chance as much.
        crops: Where the cheap mode looks; None compares whole images.
        seed: Of the crops.
        stream: Keeps the draws apart from others of the same seed.
    """

    weight: float
    crops: CropSampler | None = None
    seed: int = 42
    stream: int = 3
    _network: list[PerceptualLoss] = field(default_factory=list, repr=False)

    def __call__(
        self, image: Float[Tensor, "H W 3"], target: Float[Tensor, "H W 3"], step: int, boxes: Sequence[Box] = ()
    ) -> dict[str, Tensor]:
        """The term by name, or nothing in a step without a crop.

        Args:
            image: The rendering, sRGB.
            target: The frame, sRGB.
            step: Decides the crop.
            boxes: Left, top, right and bottom of what crops are often centered on, px.
        """
        weight, window = self.weight, (slice(None), slice(None))
        if self.crops is not None:
            height, width = target.shape[:2]
            drawn = self.crops.draw(height, width, seeded(self.seed, self.stream, step), boxes)
            if drawn is None:
                return {}
            window, weight = drawn, weight / self.crops.probability
        if not self._network:
            self._network.append(perceptual_loss().to(target.device))
        return {"perceptual": weight * self._network[0](image[window], target[window])}

    def notes(self) -> dict[str, str]:
        """Which features were compared, once they were."""
        return {"perceptual_loss": self._network[0].name} if self._network else {}
