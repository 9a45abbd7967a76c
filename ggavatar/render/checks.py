"""Input checks that all backends share; messages name the invalid tensor."""

from __future__ import annotations

import torch
from torch import Tensor

from ggavatar.core import Camera, Gaussians
from ggavatar.errors import InputError

VIEW_NAMES = ("camera.intrinsics", "camera.world_to_camera", "background")
FIELDS = ("means", "quats", "scales", "opacities", "colors")


def check_shapes(gaussians: Gaussians, camera: Camera, background: Tensor) -> None:
    """Refuse tensors whose shapes do not match.

    Raises:
        InputError: With the tensor's name, the expected and the found shape.
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
        InputError: With the tensor's name and the first invalid rows.
    """
    for name, tensor in named.items():
        finite = torch.isfinite(tensor.detach())
        if not bool(finite.all()):
            rows = torch.unique(torch.nonzero(~finite)[:, 0])
            listed = ", ".join(str(int(row)) for row in rows[:5])
            raise InputError(
                f"{name}: expected finite numbers, found NaN or infinity "
                f"in {len(rows)} of {len(tensor)} rows (first: {listed}); "
                "the training diverged or the capture is damaged: lower the learning rates or check the capture"
            )


def gaussian_tensors(gaussians: Gaussians) -> dict[str, Tensor]:
    """The tensors of `gaussians`, by their names in messages."""
    return {f"gaussians.{name}": getattr(gaussians, name) for name in FIELDS}


def camera_tensors(camera: Camera, background: Tensor) -> dict[str, Tensor]:
    """The tensors of camera and background, by their names in messages."""
    return dict(zip(VIEW_NAMES, (camera.intrinsics, camera.world_to_camera, background), strict=True))
