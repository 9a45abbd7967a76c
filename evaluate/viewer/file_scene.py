"""A file of Gaussians on show: as it is, from every side."""

from __future__ import annotations

from collections.abc import Hashable

import numpy as np
import torch
from jaxtyping import UInt8

from evaluate.rendering.standalone_file import StandaloneGaussians
from evaluate.viewer.orbit import Place, added_view, filling, moved_camera
from evaluate.viewer.server import Windows, by_user
from evaluate.viewer.texts import lines
from ggavatar.pictures.quantization import to_8_bit


class FileScene:
    """The scene of a file; only the browsers' cameras move."""

    def __init__(self, file: StandaloneGaussians, background: torch.Tensor) -> None:
        self._file, self._background = file, background
        drive, self._camera, center = file.front_view()
        with torch.no_grad():
            self._gaussians = file.avatar.gaussians(drive)
        view = self._camera.world_to_camera
        self.pivot = (view[:3, :3] @ center + view[:3, 3]).detach().cpu().numpy().astype(np.float64)

    def moment(self, now: float) -> Hashable:
        """Nothing changes by itself."""
        return 0

    def plays(self) -> bool:
        """Nothing plays."""
        return False

    def picture(self, place: Place, size: tuple[int, int], now: float) -> UInt8[np.ndarray, "H W 3"]:
        """The picture for a browser's camera, which may go anywhere."""
        camera = filling(moved_camera(self._camera, added_view(place, self.pivot)), *size)
        image = self._file.rasterize(self._gaussians, camera, self._background).image
        return to_8_bit(image.float().cpu().numpy())

    def build(self, server: Windows) -> None:
        """Add the panel."""
        gui = server.viser.gui
        count, degree = len(self._gaussians.means), self._gaussians.sh_degree
        gui.add_html(lines(self._file.method, f"{count:,} Gaussians", "" if degree is None else f"SH {degree}"))
        gui.add_button("view from the front").on_click(by_user(lambda event: server.look_ahead(event.client)))
