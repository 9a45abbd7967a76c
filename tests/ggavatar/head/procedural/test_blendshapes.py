"""The table of blendshapes against ARKit's 52 names and the head's own axes."""

from __future__ import annotations

from ggavatar.head.procedural.blendshapes import BLENDSHAPES
from ggavatar.head.procedural.expression import expression_names
from ggavatar.landmarks.blendshapes import NAMES


def test_every_blendshape_has_its_axes_or_belongs_to_a_joint_or_a_lid() -> None:
    left_out = {name for name in NAMES if name not in BLENDSHAPES}
    gaze_and_lids = {
        f"eye{action}{side}"
        for action in ("Blink", "LookDown", "LookIn", "LookOut", "LookUp")
        for side in ("Left", "Right")
    }
    assert set(BLENDSHAPES) <= {*NAMES, "tongueOut"}
    assert left_out - {"neutral"} == gaze_and_lids | {"jawForward", "jawLeft", "jawOpen", "jawRight", "mouthClose"}


def test_axes_exist_and_keep_their_side() -> None:
    axes = set(expression_names())
    for name, mixture in BLENDSHAPES.items():
        for axis, amount in mixture:
            assert axis in axes and 0 < amount <= 1, (name, axis)
            if axis.endswith(("_left", "_right")) and name.endswith(("Left", "Right")):
                assert axis.endswith("_left") == name.endswith("Left"), (name, axis)
