"""A strip of pictures: ground truth above, predictions below, frame by frame. Reference: the pictures' own pixels."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ggavatar.io.images import write_png
from website.method_picture import strip


def test_truth_is_above_and_frames_are_side_by_side(tmp_path: Path) -> None:
    pictures = {}
    for place, folder in enumerate(("ground_truth", "predictions")):
        (tmp_path / folder).mkdir()
        for frame in (3, 20):
            pictures[folder, frame] = np.full((4, 5, 3), 10 * frame + place, np.uint8)
            write_png(tmp_path / folder / f"{frame:06d}.png", pictures[folder, frame])
    shown = strip(tmp_path, (3, 20))
    assert shown.shape == (8, 10, 3)
    assert (shown[:4, 5:] == pictures["ground_truth", 20]).all()
    assert (shown[4:, :5] == pictures["predictions", 3]).all()
