"""What belongs to a live performance, put together: pictures, landmark network, the way to the avatar, a panel."""

from __future__ import annotations

import dataclasses

import numpy as np

from evaluate.motion.driving_sequence import driving_sequence_of
from evaluate.motion.live import LiveTransfer
from evaluate.viewer.live_panel import LivePanel
from evaluate.viewer.moving_pictures import pictures_of
from evaluate.viewer.performer import Performer
from evaluate.viewer.run_scene import RunScene
from evaluate.viewer.server import Windows
from ggavatar.data.expression_scores import measured_scores
from ggavatar.data.frames import evenly_spaced
from ggavatar.landmarks.tracker import LandmarkTracker
from ggavatar.pretrained.resolve import ModelFinder

LEARNED_FRAMES = 120
"""Training frames from which a performance learns what the avatar's codes show."""


def performer_of(source: str, server: Windows, scene: RunScene) -> Performer:
    """A performer before a camera or in a video, for the avatar of a scene.

    Raises:
        InputError: There is no such camera or video, or the landmark network cannot be had.
    """
    finder = ModelFinder()
    tracker = LandmarkTracker(finder.find("face_landmarker"))
    play = pictures_of(source)
    panel = LivePanel(server, scene)

    def learn() -> LiveTransfer:
        run = scene.run
        whole = driving_sequence_of(run.capture)
        seen = whole.rows(np.array([whole.row(number) for number in evenly_spaced(run.split.train, LEARNED_FRAMES)]))
        scores = measured_scores(run.capture, seen.frames, finder)
        return LiveTransfer(dataclasses.replace(seen, scores=scores), scene.controls.head)

    performer = panel.performer = Performer(play, tracker, learn, panel)
    return performer
