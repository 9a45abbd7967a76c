"""What every backend refuses, with the name of the tensor at fault."""

from __future__ import annotations

import torch
from torch import Tensor

from ggavatar.core import Camera, Gaussians
from ggavatar.errors import InputError

VIEW_NAMES = ("camera.intrinsics", "camera.world_to_camera", "background")
FIELDS = ("means", "quats", "scales", "opacities", "colors")


def check_shapes(gaussians: Gaussians, camera: Camera, background: Tensor) -> None:
    """Refuse tensors whose shapes do not fit together.

    Raises:
        InputError: Names the tensor, the expected and the found shape.
    """
    count = gaussians.means.shape[0]
    expected = {"means": (count, 3), "quats": (count, 4), "scales": (count, 3), "opacities": (count,)}
    for name, shape in expected.items():
        _expect(f"gaussians.{name}", getattr(gaussians, name), shape)
    colors = gaussians.colors
    if colors.ndim not in (2, 3) or colors.shape[0] != count or colors.shape[-1] != 3:
        raise InputError(
            f"gaussians.colors: expected RGB ({count}, 3) or harmonics ({count}, K, 3), found {tuple(colors.shape)}"
        )
    _expect("camera.intrinsics", camera.intrinsics, (3, 3))
    _expect("camera.world_to_camera", camera.world_to_camera, (4, 4))
    _expect("background", background, (3,))
    if camera.width < 1 or camera.height < 1:
        raise InputError(f"camera: expected a size of at least 1 × 1 px, found {camera.width} × {camera.height}")


def _expect(name: str, tensor: Tensor, shape: tuple[int, ...]) -> None:
    if tuple(tensor.shape) != shape:
        raise InputError(f"{name}: expected shape {shape}, found {tuple(tensor.shape)}")


def check_finite(named: dict[str, Tensor]) -> None:
    """Refuse NaN and infinity.

    Raises:
        InputError: Names the tensor and the first rows at fault.
    """
    for name, tensor in named.items():
        good = torch.isfinite(tensor.detach())
        if not bool(good.all()):
            rows = torch.unique(torch.nonzero(~good)[:, 0])
            listed = ", ".join(str(int(row)) for row in rows[:5])
            raise InputError(
                f"{name}: expected finite numbers, found NaN or infinity "
                f"in {len(rows)} of {len(tensor)} rows (first: {listed}); "
                "the training diverged or the capture is damaged: lower the learning rate or check the input"
            )


def gaussian_tensors(gaussians: Gaussians) -> dict[str, Tensor]:
    """The tensors of `gaussians` by the name used in messages."""
    return {f"gaussians.{name}": getattr(gaussians, name) for name in FIELDS}


def camera_tensors(camera: Camera, background: Tensor) -> dict[str, Tensor]:
    """The tensors of the view by the name used in messages."""
    return dict(zip(VIEW_NAMES, (camera.intrinsics, camera.world_to_camera, background), strict=True))
