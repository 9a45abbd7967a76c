"""Pieces of the subject's renderer against closed forms: coverage, depth, planes, springs, shadows, lines.

Also covers `preprocess/synthetic/rendering/shading.py`.
"""

from __future__ import annotations

import numpy as np
import pytest

from ggavatar.head.procedural.model import procedural_head
from preprocess.synthetic.animation.hair_motion import lagging_poses, swing_hair
from preprocess.synthetic.animation.performance import FPS
from preprocess.synthetic.person.description import PEOPLE
from preprocess.synthetic.person.subdivision import subdivide
from preprocess.synthetic.person.texture_space import to_linear, to_srgb
from preprocess.synthetic.person.wrinkles import BULGES, FOLDS, strength
from preprocess.synthetic.rendering.backdrop import backdrop
from preprocess.synthetic.rendering.lights import room_lights, shadow_map, sky_visibility
from preprocess.synthetic.rendering.mesh import rasterize, vertex_normals
from preprocess.synthetic.rendering.strands import Strands, rasterize_strands

SQUARE = np.array([(8.0, 8, 1), (24, 8, 1), (24, 24, 1), (8, 24, 1)])
TWO = np.array([(0, 1, 2), (0, 2, 3)])


def test_a_square_covers_exactly_its_pixel_centres_once():
    seen = rasterize(SQUARE.astype(np.float32), TWO, 32, 32)
    inside = np.zeros((32, 32), bool)
    inside[8:24, 8:24] = True
    assert np.array_equal(seen.face >= 0, inside)
    assert np.allclose(seen.depth[inside], 1) and np.isinf(seen.depth[~inside]).all()


def test_the_nearer_triangle_wins_and_depth_is_perspective_correct():
    near = SQUARE * (1, 1, 0.5)
    slanted = np.array([(0.0, 0, 1), (32, 0, 3), (0, 32, 1)])
    points = np.concatenate((near, slanted)).astype(np.float32)
    seen = rasterize(points, np.concatenate((TWO, [[4, 5, 6]])), 32, 32)
    assert (seen.face[8:24, 8:24] < 2).all() and seen.face[2, 2] == 2
    share = 4.5 / 32
    assert np.isclose(seen.depth[2, 4], 1 / ((1 - share) / 1 + share / 3), rtol=1e-5)


def test_normals_of_a_sphere_point_outwards():
    head = procedural_head()
    rows = head.regions["left_eyeball"].numpy()
    points = head.template.numpy().astype(np.float64)
    normals = vertex_normals(points, head.faces.numpy())[rows]
    outwards = points[rows] - (points[rows].max(0) + points[rows].min(0)) / 2
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    assert (normals * outwards).sum(1).min() > 0.9


def test_subdivision_reproduces_planes_and_splits_every_triangle():
    x, y = np.meshgrid(np.arange(5.0), np.arange(5.0))
    points = np.stack((x.ravel(), y.ravel(), 2 * x.ravel() - y.ravel()), axis=1)
    cell = np.arange(25).reshape(5, 5)
    a, b, c, d = cell[:-1, :-1].ravel(), cell[:-1, 1:].ravel(), cell[1:, :-1].ravel(), cell[1:, 1:].ravel()
    faces = np.concatenate((np.stack((a, b, c), 1), np.stack((b, d, c), 1)))
    fine = subdivide(faces, 25)
    assert np.allclose(fine.weights.sum(axis=1), 1)
    moved = fine.weights @ points
    assert np.allclose(moved[:, 2], 2 * moved[:, 0] - moved[:, 1])
    assert len(fine.faces) == 4 * len(faces) and len(np.unique(fine.faces)) == fine.weights.shape[0]
    uv = fine.corners(points[faces][..., :2])
    assert np.allclose(uv.mean(axis=1).reshape(-1, 4, 2).mean(axis=1), points[faces][..., :2].mean(axis=1))


def line(nodes: np.ndarray, width: float) -> Strands:
    return Strands(nodes, np.ones((1, 2, 3)), np.full((1, 2), width))


def test_a_line_covers_its_length_times_its_width():
    color, alpha = np.zeros((40, 40, 3), np.float32), np.zeros((40, 40), np.float32)
    nodes = np.array([[(5.5, 20.0, 1.0), (25.5, 20.0, 1.0)]])
    rasterize_strands([line(nodes, 2.0)], np.full((40, 40), np.inf, np.float32), color, alpha)
    assert np.isclose(alpha.sum(), 20 * 2.0, rtol=0.05)
    assert np.allclose(color[..., 0], alpha, atol=1e-6)


@pytest.mark.parametrize("angle", [0.0, 0.4, 0.8, 1.2, 1.57])
def test_thin_lines_weigh_the_same_in_every_direction(angle):
    color, alpha = np.zeros((64, 64, 3), np.float32), np.zeros((64, 64), np.float32)
    step = 20 * np.array([np.cos(angle), np.sin(angle)])
    nodes = np.array([[(*(32.2 - step), 1.0), (*(32.2 + step), 1.0)]])
    rasterize_strands([line(nodes, 0.5)], np.full((64, 64), np.inf, np.float32), color, alpha)
    assert np.isclose(alpha.sum(), 40 * 0.5, rtol=0.12)


def test_strands_hide_behind_surfaces():
    color, alpha = np.zeros((40, 40, 3), np.float32), np.zeros((40, 40), np.float32)
    depth = np.full((40, 40), 0.9, np.float32)
    nodes = np.array([[(5.5, 20.0, 1.0), (25.5, 20.0, 1.0)]])
    rasterize_strands([line(nodes, 2.0)], depth, color, alpha)
    assert alpha.max() == 0


def test_hair_follows_a_still_head_and_lags_a_turning_one():
    still = np.tile(np.eye(4), (50, 1, 1))
    assert np.allclose(lagging_poses(still, 0.0), np.eye(4))
    moving = still.copy()
    moving[10:, 0, 3] = 0.05
    lag = lagging_poses(moving, 0.0)[:, :, 0, 3]
    assert (lag[:, 11] < 0.049).all() and (lag.max(axis=1) > 0.05).all(), "a spring starts late and overshoots"
    assert np.allclose(lag[:, -1], 0.05, atol=0.006)
    assert FPS == 25


def test_roots_stay_on_the_head_while_tips_lag():
    nodes = np.linspace((0.0, 0.1, 0.0), (0.0, 0.0, 0.0), 14)[None].repeat(3, axis=0)
    shifted = np.eye(4)
    shifted[0, 3] = 0.05
    swinging = swing_hair(nodes, shifted, np.tile(np.eye(4), (3, 1, 1)), 1.0)
    assert np.allclose(swinging[:, 0], nodes[:, 0] + (0.05, 0, 0))
    assert np.allclose(swinging[:, -1], nodes[:, -1])


def test_shadow_falls_behind_a_plate_and_open_sky_is_one():
    lights = room_lights()
    towards = lights.directions[0].astype(np.float64)
    side = np.cross((0, 1.0, 0), towards)
    side /= np.linalg.norm(side)
    up = np.cross(towards, side)
    corners = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    plate = np.array([0.05 * (a * side + b * up) for a, b in corners]) + np.array([0.0, -0.03, -0.02])
    shadow = shadow_map(plate, TWO, lights)
    assert np.isfinite(shadow.depth).sum() > 1000
    normals = np.tile(towards, (4, 1))
    assert np.allclose(sky_visibility(plate, normals, TWO), 1, atol=0.02)


def test_folds_are_off_at_rest_and_grow_faster_than_linearly():
    at_rest = {name: 0.0 for item in (*FOLDS, *BULGES) for name, _ in item.drivers}
    at_rest |= {f"{name}_{side}": 0.0 for name in list(at_rest) for side in ("left", "right")}
    assert all(strength(item.drivers, "left", at_rest) == 0 for item in (*FOLDS, *BULGES))
    half, full = (strength((("x", 1.0),), "left", {"x": value}) for value in (0.5, 1.0))
    assert full > 2.5 * half > 0


def test_srgb_round_trip():
    values = np.linspace(0, 1, 256)[:, None].repeat(3, axis=1)
    assert np.allclose(to_srgb(to_linear(values)), values, atol=1e-5)


def test_five_people_and_different_walls():
    assert sorted(PEOPLE) == [1, 2, 3, 4, 5]
    assert sum(person.glasses is not None for person in PEOPLE.values()) >= 1
    assert sum(person.hat is not None for person in PEOPLE.values()) >= 1
    plain, busy = (backdrop(kind, 48, (0.6, 0.6, 0.6), 1) for kind in ("plain", "busy"))
    assert busy.std() > 3 * plain.std() and plain.shape == (48, 48, 3)
