"""The values that all of GGAvatar exchanges, and the protocols of a rasterizer and of a method. No disk, no device.

Units and axes (docs/conventions.md): meters, radians, pixels with centers at +0.5, OpenCV cameras, quaternions wxyz,
sRGB in [0, 1].
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor


@dataclass(frozen=True)
class Camera:
    """A pinhole camera in OpenCV axes (x right, y down, z forward).

    Attributes:
        intrinsics: Focal lengths and principal point, px; the third row is 0, 0, 1 and there is no skew.
        world_to_camera: Rigid transform from world meters to camera meters.
        width: Image width, px.
        height: Image height, px.
    """

    intrinsics: Float[Tensor, "3 3"]
    world_to_camera: Float[Tensor, "4 4"]
    width: int
    height: int

    def __repr__(self) -> str:
        """Size and focal length."""
        return f"Camera({self.width}×{self.height} px, focal length {float(self.intrinsics[0, 0]):.1f} px)"

    def resized(self, width: int, height: int) -> Camera:
        """The same camera for an image resampled to `width` × `height` px, edges aligned."""
        if (width, height) == (self.width, self.height):
            return self
        across, down, last = self.intrinsics.unbind(0)
        intrinsics = torch.stack((across * (width / self.width), down * (height / self.height), last))
        return Camera(intrinsics, self.world_to_camera, width, height)


@dataclass(frozen=True)
class Drive:
    """Everything that animates a head in one frame.

    Attributes:
        expression: Expression coefficients of the head model, unit of its basis.
        joint_rotations: Axis-angle of every joint in the head's order (FLAME: root, neck, jaw, left eye, right eye),
            rad.
        eyelids: Closing of the left and the right lid; 0 is as open as in the template, 1 is closed.
        translation: Translation of the whole head after posing, m.
        head_to_camera: Rigid pose of the head in camera space. With a tracker that stores the head pose in the camera
            it equals `world_to_camera`; methods that need the pose as a condition read it here.
        frame: Source frame number, or None for a drive that belongs to no frame of the capture.
        torso_to_camera: Rigid pose of the torso in camera space, equal to that of the head when both are at rest; None
            if the torso was not tracked.
    """

    expression: Float[Tensor, " E"]
    joint_rotations: Float[Tensor, "J 3"]
    eyelids: Float[Tensor, "2"]
    translation: Float[Tensor, "3"]
    head_to_camera: Float[Tensor, "4 4"]
    frame: int | None = None
    torso_to_camera: Float[Tensor, "4 4"] | None = None

    def __repr__(self) -> str:
        """Frame and numbers of parameters."""
        of = "no frame" if self.frame is None else f"frame {self.frame}"
        return f"Drive({of}, {len(self.expression)} expression axes, {len(self.joint_rotations)} joints)"

    @property
    def requires_grad(self) -> bool:
        """Whether gradients are wanted with respect to one of its values, as when a tracking is refined."""
        values = (getattr(self, item.name) for item in fields(self))
        return any(isinstance(value, Tensor) and value.requires_grad for value in values)


@dataclass(frozen=True)
class Frame:
    """One training or test frame, already composited on the background.

    Attributes:
        drive: What animates the head.
        camera: The camera that took the frame.
        image: sRGB in [0, 1].
        alpha: Foreground coverage in [0, 1].
    """

    drive: Drive
    camera: Camera
    image: Float[Tensor, "H W 3"]
    alpha: Float[Tensor, "H W 1"]


@dataclass(frozen=True)
class Gaussians:
    """3D Gaussians in world space, activated (no logits, no logarithms).

    Attributes:
        means: Centers, m.
        quats: Rotations as quaternions wxyz, which need not be normalized.
        scales: Standard deviations along the local axes, m, positive.
        opacities: In [0, 1].
        colors: Either RGB [N, 3], or spherical harmonics [N, K, 3] with K = 1, 4, 9 or 16, where color = max(0,
            SH(direction) + 0.5).
        sh_degree: Highest degree to evaluate (0 to 3); None means all that `colors` holds. Ignored for RGB.
    """

    means: Float[Tensor, "N 3"]
    quats: Float[Tensor, "N 4"]
    scales: Float[Tensor, "N 3"]
    opacities: Float[Tensor, " N"]
    colors: Float[Tensor, "N 3"] | Float[Tensor, "N K 3"]
    sh_degree: int | None = None

    def __repr__(self) -> str:
        """Their number and kind of color."""
        colors = "RGB" if self.colors.ndim == 2 else f"{self.colors.shape[1]} harmonics"
        return f"{type(self).__name__}({len(self.means)}, {colors}, on {self.means.device})"


@dataclass(frozen=True)
class Rendering:
    """What a rasterizer returns for a drive's Gaussians and a camera.

    Attributes:
        image: Composited on the background; may exceed 1 where colors do.
        alpha: 1 − final transmittance.
        depth: Alpha-weighted sum of camera z, m (divide by alpha for the expected depth).
        means2d: Projected centers, px. After `backward()` its `.grad` holds ∂loss/∂means2d in 1/px (zero for culled
            Gaussians).
        radii: Half of the larger side of the box in which alpha ≥ 1/255, px; 0 for culled Gaussians.
    """

    image: Float[Tensor, "H W 3"]
    alpha: Float[Tensor, "H W 1"]
    depth: Float[Tensor, "H W 1"]
    means2d: Float[Tensor, "N 2"]
    radii: Float[Tensor, " N"] | Int[Tensor, " N"]


@runtime_checkable
class Rasterizer(Protocol):
    """A differentiable renderer of Gaussians; `ggavatar.render.backends` returns one."""

    def __call__(self, gaussians: Gaussians, camera: Camera, background: Float[Tensor, "3"]) -> Rendering:
        """Render `gaussians` as seen by `camera` on a constant background color."""
        ...


@runtime_checkable
class Avatar(Protocol):
    """What a method must offer; the trainer and the evaluator use nothing else. Implementations are `torch.nn.Module`s.

    Everything that decides how the avatar looks (weights, rows, the stage of its schedule) is in its `state_dict`.
    """

    def gaussians(self, drive: Drive) -> Gaussians:
        """The avatar posed by `drive`, in world space."""
        ...

    def losses(self, frame: Frame, rendering: Rendering, step: int) -> Mapping[str, Tensor]:
        """Weighted terms of the objective by name; their sum is minimized, and each is logged."""
        ...

    def optimizers(self) -> list[torch.optim.Optimizer]:
        """The optimizers to step, with the learning rates of the current step."""
        ...

    def after_backward(self, rendering: Rendering, step: int) -> None:
        """Density control, and the learning rates and schedules of step + 1; called after the optimizers' step."""
        ...
