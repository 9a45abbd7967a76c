"""What ARKit's names move: the direction of every joint and lid, sides, and heads of each family.

Also covers `head/axis_names.py`.
"""

from __future__ import annotations

import dataclasses

import pytest
import torch

from ggavatar.core import Drive
from ggavatar.formats.arkit_recording import ARKIT_NAMES
from ggavatar.head.arkit_map import Target, arkit_map
from ggavatar.head.axis_names import axis_names
from ggavatar.head.expression_axes import TRACKED_AXES
from ggavatar.head.ict import EXPRESSIONS
from ggavatar.head.model import HeadModel
from ggavatar.head.procedural.model import procedural_head


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return procedural_head()


def with_axes(head: HeadModel, version: str, count: int) -> HeadModel:
    return dataclasses.replace(
        head, version=version, expression_names=(), expression_basis=torch.zeros(len(head.template), 3, count)
    )


def moved(head: HeadModel, name: str) -> torch.Tensor:
    """Displacement of all vertices at a score of 1, m."""
    neutral = head.neutral_drive()
    values = {part: getattr(neutral, part).clone() for part in ("expression", "joint_rotations", "eyelids")}
    for part, place, factor in arkit_map(head)[name]:
        values[part].view(-1)[place] += factor
    drive: Drive = dataclasses.replace(neutral, **values)
    return head.vertices(drive) - head.template


def test_names_of_axes() -> None:
    head = procedural_head()
    assert axis_names(head)[:2] == ("smile_left", "smile_right") and len(axis_names(head)) == 44
    tracked = axis_names(with_axes(head, "tracked-2", 40))
    assert tracked[:37] == TRACKED_AXES and tracked[37:] == ("own1", "own2", "neckLength")
    assert axis_names(with_axes(head, "ict-facekit-1", 53)) == EXPRESSIONS
    assert axis_names(with_axes(head, "flame2020", 3)) == ("expression_1", "expression_2", "expression_3")
    assert axis_names(with_axes(head, "procedural-1", 3))[0] == "expression_1", "cut to fewer axes, nothing is known"


def test_all_names_but_one_move_the_procedural_head(head: HeadModel) -> None:
    known = arkit_map(head)
    assert set(ARKIT_NAMES) - set(known) == {"jawForward"} and set(known) <= set(ARKIT_NAMES)
    assert all(float(moved(head, name).norm(dim=1).max()) > 5e-4 for name in known)


def test_other_families(head: HeadModel) -> None:
    tracked = arkit_map(with_axes(head, "tracked-2", 40))
    assert set(ARKIT_NAMES) - set(tracked) == {"jawForward", "tongueOut"}
    assert tracked["mouthClose"] == (Target("expression", TRACKED_AXES.index("mouthClose"), 1.0),)
    ict = arkit_map(with_axes(head, "ict-facekit-1", 53))
    assert set(ARKIT_NAMES) - set(ict) == {"tongueOut"}
    assert [EXPRESSIONS[target.place] for target in ict["browInnerUp"]] == ["browInnerUp_L", "browInnerUp_R"]
    assert [EXPRESSIONS[target.place] for target in ict["mouthLeft"]] == ["mouthLeft"]
    assert arkit_map(with_axes(head, "flame2020", 50)) == {}


def test_directions(head: HeadModel) -> None:
    chin, lips = head.template[:, 1] < -0.06, head.regions["lips"]
    assert moved(head, "jawOpen")[lips, 1].min() < -0.01, "the lower lip goes down"
    assert moved(head, "jawLeft")[chin & (head.template[:, 2] > 0.03), 0].mean() > 0, "to the subject's left, +x"
    assert moved(head, "mouthSmileLeft")[head.template[:, 0] > 0.01].norm(dim=1).max() > 5e-3
    assert moved(head, "mouthSmileLeft")[head.template[:, 0] < -0.01].norm(dim=1).max() < 1e-3
    for side, sign in (("left", 1.0), ("right", -1.0)):
        eye = head.regions[f"{side}_eyeball"]
        front = eye[head.template[eye, 2].argmax()]
        suffix = side.capitalize()
        assert sign * float(moved(head, f"eyeLookOut{suffix}")[front, 0]) > 3e-3
        assert sign * float(moved(head, f"eyeLookIn{suffix}")[front, 0]) < -3e-3
        assert float(moved(head, f"eyeLookDown{suffix}")[front, 1]) < -3e-3
        assert float(moved(head, f"eyeLookUp{suffix}")[front, 1]) > 3e-3
        lid = head.regions[f"{side}_lid_margin"]
        other = head.regions[f"{'right' if side == 'left' else 'left'}_lid_margin"]
        blink = moved(head, f"eyeBlink{suffix}")
        assert blink[lid].norm(dim=1).max() > 3e-3 and blink[other].norm(dim=1).max() < 1e-6
