"""A picture for a method's page: test frames of a generated subject above, an avatar's below.

    python -m website.method_picture RUN/eval/PROTOCOL -o docs/images/methods/METHOD.jpg

The folder is the evaluation of a run of subject 1, 600 frames at 256² (`make table` makes such runs). The pictures of
the documentation show generated subjects only.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from ggavatar.io.images import read_rgb, write_jpeg

FRAMES = (100, 240, 400, 540)
"""Different poses and expressions; the last is a grimace."""


def strip(evaluation: Path, frames: tuple[int, ...] = FRAMES) -> UInt8[np.ndarray, "H W 3"]:
    """Ground truth of some frames side by side, and the predictions below."""
    rows = [
        np.concatenate([read_rgb(evaluation / folder / f"{frame:06d}.png") for frame in frames], axis=1)
        for folder in ("ground_truth", "predictions")
    ]
    return np.concatenate(rows)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("evaluation", type=Path)
    parser.add_argument("-o", dest="output", type=Path, required=True)
    given = parser.parse_args()
    write_jpeg(given.output, strip(given.evaluation), quality=85)
