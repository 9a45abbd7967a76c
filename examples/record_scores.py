"""Record MediaPipe's 52 expression scores of a video or a camera as CSV, which drives avatars (docs/driving.md).

python examples/record_scores.py webcam.mp4 -o take.csv
python examples/record_scores.py 0 -o take.csv            # the first camera, until Ctrl-C
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from ggavatar.landmarks.blendshapes import NAMES
from ggavatar.landmarks.tracker import LandmarkTracker
from ggavatar.pretrained.resolve import ModelFinder


def frames(source: str) -> Iterator[tuple[float, np.ndarray]]:
    """Time in seconds and RGB picture of every frame of a file or a camera."""
    is_camera = source.isdigit()
    stream = cv2.VideoCapture(int(source) if is_camera else source)
    if not stream.isOpened():
        raise SystemExit(f"{source}: expected a video or the number of a camera, found none that opens")
    fps, began, number = stream.get(cv2.CAP_PROP_FPS) or 30.0, time.monotonic(), 0
    while True:
        read, picture = stream.read()
        if not read:
            return
        yield time.monotonic() - began if is_camera else number / fps, cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
        number += 1


def main() -> None:
    """Write a row for every frame that shows a face."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("source", help="video file, or number of a camera")
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    tracker = LandmarkTracker(ModelFinder().find("face_landmarker"))
    with options.output.open("w", newline="") as stream, contextlib.suppress(KeyboardInterrupt):
        writer, count = csv.writer(stream), 0
        writer.writerow(["time", *NAMES])
        for seconds, picture in frames(options.source):
            face = tracker.landmarks(picture)
            if face is not None:
                writer.writerow([f"{seconds:.4f}", *(f"{score:.5f}" for score in face.blendshapes)])
                count += 1
    print(f"wrote {options.output} ({count} frames); next: ggavatar-render RUN --drive {options.output}")


if __name__ == "__main__":
    main()
