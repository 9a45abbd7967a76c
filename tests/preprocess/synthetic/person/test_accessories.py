"""Glasses and hat against geometry: closed tubes of their radius, mirror symmetry, and clearance from the skull.

Reference: trimesh for topology, areas and volumes; the generic head's own surface.
"""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from ggavatar.head.procedural.model import procedural_head
from ggavatar.head.procedural.parts import Part
from ggavatar.head.procedural.surface import EYE_CENTER
from preprocess.synthetic.person.accessories import beanie, glasses_frame, lenses, merged, tube


def test_closed_tube_is_a_torus_of_its_radius() -> None:
    angle = np.arange(200) * 2 * np.pi / 200
    path = np.stack((np.cos(angle), np.sin(angle), np.zeros_like(angle)), axis=1)
    part = tube(path, 0.1, closed=True, sides=40)
    away = np.hypot(np.hypot(part.vertices[:, 0], part.vertices[:, 1]) - 1, part.vertices[:, 2])
    assert np.allclose(away, 0.1, rtol=1e-3)
    mesh = trimesh.Trimesh(part.vertices, part.faces).process(validate=True)
    assert mesh.area == pytest.approx(4 * np.pi**2 * 0.1, rel=5e-3)


def test_merged_parts_keep_their_triangles() -> None:
    one, other = glasses_frame(), lenses()
    both = merged([one, other])
    assert np.array_equal(both.vertices[both.faces[: len(one.faces)]], one.vertices[one.faces])
    assert np.array_equal(both.vertices[both.faces[len(one.faces) :]], other.vertices[other.faces])


@pytest.mark.parametrize("part", [glasses_frame(), lenses()], ids=["frame", "lenses"])
def test_glasses_are_symmetric_and_sit_before_the_eyes(part: Part) -> None:
    vertices = part.vertices
    assert vertices[:, 0].min() == pytest.approx(-vertices[:, 0].max(), abs=2e-3)
    rims = vertices[vertices[:, 2] > EYE_CENTER[2]]
    assert rims[:, 0].min() < -EYE_CENTER[0] < EYE_CENTER[0] < rims[:, 0].max()
    assert rims[:, 1].min() < EYE_CENTER[1] < rims[:, 1].max()


def test_lenses_face_away_from_the_head() -> None:
    part = lenses()
    corners = part.vertices[part.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[np.linalg.norm(normals, axis=1) > 0][:, 2] > 0).all()


def test_hat_covers_the_skull_and_leaves_the_face_free() -> None:
    part, uv = beanie()
    assert uv.min() >= 0 and uv.max() <= 1 and len(uv) == len(part.vertices)
    head = procedural_head()
    scalp = head.template.numpy()
    top, brow = scalp[:, 1].max(), EYE_CENTER[1] + 0.02
    assert part.vertices[:, 1].max() > top
    front = part.vertices[part.vertices[:, 2] > 0.05]
    assert front[:, 1].min() > brow
