"""Gaussians embedded on a mesh: Eq. 1 to 10 of SplattingAvatar in float64, invariances, walks and splits.

References: the formulas by hand with scipy's rotations, finite differences, rigid and similar motions of the mesh, and
numpy's solver.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from ggavatar.gaussians.binding import WorldGeometry
from ggavatar.gaussians.density_control import DensityControl, grow, statistics
from ggavatar.gaussians.embedding import (
    EmbeddedSplit,
    Places,
    RestMesh,
    absorb_slides,
    embed,
    scaled_by_area,
    scaling_regularizer,
    slide_shift,
    solve_on_triangle,
)
from ggavatar.geometry.transforms import axis_angle_to_matrix, quaternion_to_matrix
from ggavatar.geometry.triangle_walk import neighbors
from ggavatar.geometry.vertex_frames import vertex_normals, vertex_turns
from ggavatar.head.model import HeadModel
from ggavatar.optim.parameters import Column, Rows

RULES = ("area", "length", "log", "none")
COUNT = 60


@pytest.fixture
def rest(toy_head: HeadModel) -> RestMesh:
    return RestMesh.of(toy_head.neutral().double(), toy_head.faces)


def made_rows(rest: RestMesh, count: int = COUNT, seed: int = 0) -> Rows:
    """Random Gaussians of a few mm on a mesh."""
    generator = torch.Generator().manual_seed(seed)
    weights = torch.rand(count, 3, dtype=torch.float64, generator=generator)
    like = weights.new_tensor

    def drawn(*shape: int) -> Tensor:
        return torch.randn(*shape, dtype=torch.float64, generator=generator)

    learnable = {
        "distances": Column(0.002 * drawn(count), 1e-3),
        "slides": Column(like(0.0).expand(count, 2), 1e-3),
        "quats": Column(drawn(count, 4), 1e-3),
        "log_scales": Column(math.log(0.003) + 0.3 * drawn(count, 3), 5e-3),
        "opacity_logits": Column(drawn(count), 0.05),
        "sh": Column(drawn(count, 1, 3), 2.5e-3),
    }
    face = torch.randint(len(rest.faces), (count,), generator=generator)
    return Rows(learnable, {"face": face, "weights": weights / weights.sum(1, keepdim=True), **statistics(count)})


def placed(rows: Rows, rest: RestMesh, vertices: Tensor, rule: str = "area", damping: float = 0.0) -> WorldGeometry:
    posed = rest.posed(vertices)
    return embed(Places.of(rows), rows["quats"], rows["log_scales"], rest, posed, rule, damping)  # type: ignore[arg-type]


def bent(vertices: Tensor) -> Tensor:
    """The mesh bent and stretched."""
    angle = 3.0 * vertices[:, 1]
    turn = axis_angle_to_matrix(torch.stack((angle, 0 * angle, 0.5 * angle), dim=1))
    return (turn @ (vertices * vertices.new_tensor([1.2, 1.0, 0.9]))[:, :, None]).squeeze(-1)


def same_rotation(first: Tensor, second: Tensor) -> bool:
    return bool(((first * second).sum(1).abs() - 1).abs().amax() < 1e-9)


def test_eq_1_to_8_row_by_row(rest: RestMesh) -> None:
    """μ = P + d n, r = q r0 with the blended turn on the left, s = (A / A0) s0: each by hand, with slides."""
    rows = made_rows(rest)
    with torch.no_grad():
        rows["slides"].copy_(0.1 * torch.randn(COUNT, 2, generator=torch.Generator().manual_seed(1)))
    vertices = bent(rest.vertices)
    found = placed(rows, rest, vertices)
    normals, turns = vertex_normals(vertices, rest.faces), vertex_turns(rest.frames, vertices, rest.faces)
    with torch.no_grad():
        for row in range(COUNT):
            a, b, c = rest.faces[rows["face"][row]].tolist()
            u, v = (rows["weights"][row, :2] + rows["slides"][row]).tolist()
            normal = u * normals[a] + v * normals[b] + (1 - u - v) * normals[c]
            point = u * vertices[a] + v * vertices[b] + (1 - u - v) * vertices[c]
            assert torch.allclose(found.means[row], point + rows["distances"][row] * normal / normal.norm())
            turn = (u * turns[a] + v * turns[b] + (1 - u - v) * turns[c]).numpy()
            expected = Rotation.from_quat(turn, scalar_first=True) * Rotation.from_quat(
                rows["quats"][row].numpy(), scalar_first=True
            )
            got = Rotation.from_quat(found.quats[row].numpy(), scalar_first=True)
            assert (expected.inv() * got).magnitude() < 1e-6
            areas = [
                np.linalg.norm(np.cross(m[b] - m[a], m[c] - m[a])) / 2
                for m in (vertices.numpy(), rest.vertices.numpy())
            ]
            assert torch.allclose(found.scales[row], areas[0] / areas[1] * rows["log_scales"][row].exp())


@pytest.mark.parametrize("rule", RULES)
def test_at_rest_nothing_is_turned_or_scaled(rest: RestMesh, rule: str) -> None:
    rows = made_rows(rest)
    found = placed(rows, rest, rest.vertices, rule, 6.25e-6)
    assert torch.allclose(found.scales, rows["log_scales"].exp())
    assert same_rotation(found.quats, rows["quats"] / rows["quats"].norm(dim=1, keepdim=True))
    normals = vertex_normals(rest.vertices, rest.faces)[rest.faces[rows["face"]]]
    normal = (rows["weights"][:, :, None] * normals).sum(1)
    distance = (found.means - (rows["weights"][:, :, None] * rest.vertices[rest.faces[rows["face"]]]).sum(1)).norm(
        dim=1
    )
    assert torch.allclose(distance, rows["distances"].abs()) and (normal.norm(dim=1) < 1).any()


@pytest.mark.parametrize("rule", RULES)
def test_a_rigid_motion_of_the_mesh_moves_the_gaussians(rest: RestMesh, rule: str) -> None:
    rows, axis = made_rows(rest), torch.tensor([0.9, -0.5, 0.7], dtype=torch.float64)
    turn, shift = axis_angle_to_matrix(axis), torch.tensor([0.3, -0.1, 0.2], dtype=torch.float64)
    first = placed(rows, rest, rest.vertices, rule)
    second = placed(rows, rest, rest.vertices @ turn.T + shift, rule)
    assert torch.allclose(second.means, first.means @ turn.T + shift, atol=1e-12)
    assert torch.allclose(second.scales, first.scales, rtol=1e-9)
    assert torch.allclose(quaternion_to_matrix(second.quats), turn @ quaternion_to_matrix(first.quats), atol=1e-7)


def test_a_mesh_twice_as_large(rest: RestMesh) -> None:
    """Scales by 4 (area), 2 (length), the fourth power in quarter meters (log); distances to the mesh stay."""
    rows = made_rows(rest)
    first, s = placed(rows, rest, rest.vertices), rows["log_scales"].exp()
    second = placed(rows, rest, 2 * rest.vertices)
    surface = (rows["weights"][:, :, None] * rest.vertices[rest.faces[rows["face"]]]).sum(1)
    assert torch.allclose(second.means - 2 * surface, first.means - surface)
    assert torch.allclose(second.scales, 4 * s)
    assert torch.allclose(placed(rows, rest, 2 * rest.vertices, "length").scales, 2 * s)
    assert torch.allclose(placed(rows, rest, 2 * rest.vertices, "none").scales, s)
    log = placed(rows, rest, 2 * rest.vertices, "log").scales
    assert torch.allclose(4 * log, (4 * s) ** 4) and (log < s).all()  # the code's rule: they shrink


def test_the_codes_rule_in_numbers() -> None:
    """A Gaussian of 3 mm on a triangle 1.2 times as large shrinks to 0.41 of itself."""
    found = scaled_by_area(torch.full((1, 3), 0.003).log(), torch.tensor([1.2]), "log") / 0.003
    assert torch.allclose(found, torch.full((1, 3), 0.012**0.2), rtol=1e-4) and 0.40 < float(found[0, 0]) < 0.42


def test_damping_is_added_to_both_areas(rest: RestMesh) -> None:
    rows, damping = made_rows(rest), 1e-4
    found = placed(rows, rest, 2 * rest.vertices, "area", damping).scales / rows["log_scales"].exp()
    area = rest.frames.areas[rows["face"]]
    assert torch.allclose(found[:, 0], (4 * area + damping) / (area + damping))


def test_gradients_of_slides_are_finite_differences(rest: RestMesh) -> None:
    """Lifted optimization: through the surface, the normal and the turn."""
    rows = made_rows(rest, 8)
    posed = rest.posed(bent(rest.vertices))

    def geometry(slides: Tensor, distances: Tensor) -> tuple[Tensor, ...]:
        places = Places(rows["face"], rows["weights"] + slide_shift(slides), distances)
        return embed(places, rows["quats"].detach(), rows["log_scales"].detach(), rest, posed, "area", 0.0)[:2]

    inputs = rows["slides"].detach().clone().requires_grad_(), rows["distances"].detach().clone().requires_grad_()
    assert torch.autograd.gradcheck(geometry, inputs)
    geometry(*inputs)[0].sum().backward()
    assert inputs[0].grad is not None and inputs[0].grad.abs().amin() > 0


def test_gradients_reach_the_mesh(rest: RestMesh) -> None:
    """When a tracking is refined, the drive has gradients."""
    rows, vertices = made_rows(rest, 8), bent(rest.vertices).requires_grad_()
    placed(rows, rest, vertices).means.sum().backward()
    assert vertices.grad is not None and vertices.grad.abs().sum() > 1


def step_with_adam(rows: Rows) -> None:
    for name in ("slides", "distances"):
        rows[name].grad = torch.randn_like(rows[name])
    rows.optimizer.step()
    rows.optimizer.zero_grad(set_to_none=True)


def test_a_walk_moves_slides_into_the_weights(rest: RestMesh) -> None:
    """Means stay where the triangle stays; slides and their moments are 0; distances and theirs are untouched."""
    rows = made_rows(rest, 200)
    step_with_adam(rows)
    with torch.no_grad():
        rows["slides"].copy_(0.1 * torch.randn(200, 2, generator=torch.Generator().manual_seed(2)))
    before, face = placed(rows, rest, bent(rest.vertices)), rows["face"].clone()
    distances, state = rows["distances"].detach().clone(), rows.optimizer.state[rows["distances"]]
    moments = {name: state[name].clone() for name in ("exp_avg", "exp_avg_sq", "step")}
    absorb_slides(rows, neighbors(rest.faces), 0.9)
    after, stayed = placed(rows, rest, bent(rest.vertices)), rows["face"] == face
    assert 20 < int((~stayed).sum()) < 100
    assert torch.allclose(after.means[stayed], before.means[stayed], atol=1e-12)
    assert torch.allclose(after.quats[stayed], before.quats[stayed], atol=1e-9)
    assert (after.means - before.means)[~stayed].norm(dim=1).amax() < 0.005
    assert not rows["slides"].any() and (rows["weights"] >= 0).all()
    slides = rows.optimizer.state[rows["slides"]]
    assert not slides["exp_avg"].any() and not slides["exp_avg_sq"].any() and float(slides["step"]) == 1
    assert torch.equal(rows["distances"].detach(), distances)
    assert all(torch.equal(state[name], value) for name, value in moments.items())


def split_of(rest: RestMesh, along_normal: bool = False) -> EmbeddedSplit:
    return EmbeddedSplit(rest, neighbors(rest.faces), 0.9, along_normal)


def test_solving_on_a_triangle_is_numpys_solution() -> None:
    generator = torch.Generator().manual_seed(0)
    offset, normal = torch.randn(2, 50, 3, dtype=torch.float64, generator=generator)
    edges = torch.randn(50, 2, 3, dtype=torch.float64, generator=generator)
    normal = normal / normal.norm(dim=1, keepdim=True)
    found = solve_on_triangle(offset, edges, normal)
    columns = torch.cat((edges, normal[:, None]), dim=1).mT.numpy()
    assert np.allclose(found.numpy(), np.linalg.solve(columns, offset.numpy()[:, :, None])[:, :, 0], atol=1e-6)


def test_solving_where_the_normal_lies_in_the_triangle_or_there_is_none() -> None:
    edges = torch.tensor([[[1.0, 0, 0], [0, 2, 0]], [[1.0, 0, 0], [2, 0, 0]], [[0.0, 0, 0], [0, 0, 0]]])
    normal, offset = torch.tensor([[1.0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]]), torch.tensor([[0.5, 1.0, 3.0]]).expand(3, 3)
    found = solve_on_triangle(offset, edges, normal)
    assert torch.allclose(found, torch.tensor([[0.5, 0.5, 3.0], [0, 0, 3.0], [0, 0, 1.0]]))


def test_children_of_a_split_are_smaller_copies_beside_the_parent(rest: RestMesh) -> None:
    """Scales over 1.6, opacity, color and distance copied, no slides; one more row; survivors keep their moments."""
    rows = made_rows(rest)
    step_with_adam(rows)
    chosen = torch.zeros(COUNT, dtype=torch.bool)
    chosen[[3, 20]] = True
    parents = {name: values.detach()[chosen].clone() for name, values in rows.columns().items()}
    moment = rows.optimizer.state[rows["distances"]]["exp_avg"][~chosen].clone()
    before = placed(rows, rest, rest.vertices)
    split_of(rest)(rows, chosen, torch.Generator().manual_seed(0))
    assert len(rows) == COUNT + 2
    for name in ("opacity_logits", "sh", "quats", "distances"):
        assert torch.equal(rows[name][-4:].detach(), parents[name].repeat_interleave(2, 0))
    assert torch.allclose(rows["log_scales"][-4:], parents["log_scales"].repeat_interleave(2, 0) - math.log(1.6))
    assert not rows["slides"][-4:].any()
    after = placed(rows, rest, rest.vertices)
    assert torch.equal(after.means[:-4], before.means[~chosen])
    away = (after.means[-4:] - before.means[chosen].repeat_interleave(2, 0)).norm(dim=1)
    assert (away < 4 * parents["log_scales"].exp().amax()).all() and (away > 0).all()
    new = rows.optimizer.state[rows["distances"]]["exp_avg"]
    assert torch.equal(new[:-4], moment) and not new[-4:].any()


def test_places_of_children_are_where_they_were_drawn(rest: RestMesh) -> None:
    """With the distance along the normal, at the drawn point; without, right along the surface (2 % of the offset)."""
    rows = made_rows(rest, 400)
    with torch.no_grad():
        rows["slides"].copy_(0.05 * torch.randn(400, 2, generator=torch.Generator().manual_seed(4)))
    begin = Places(rows["face"], rows["weights"], rows["distances"].detach())
    slide = slide_shift(rows["slides"].detach())
    offset = 0.003 * torch.randn(400, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    found = split_of(rest).placed(begin, slide, offset)
    posed, quats, scales = rest.posed(rest.vertices), rows["quats"].detach(), rows["log_scales"].detach()
    origin = embed(Places.of(rows), quats, scales, rest, posed, "none", 0.0).means.detach()
    error = (embed(found, quats, scales, rest, posed, "none", 0.0).means - origin - offset).norm(dim=1)
    assert float(error.median()) < 2e-5 and float(error.quantile(0.95)) < 2e-4
    assert int((found.face != begin.face).sum()) > 10
    flat = found._replace(distances=begin.distances)
    moved = embed(flat, quats, scales, rest, posed, "none", 0.0).means - origin
    normals = vertex_normals(rest.vertices, rest.faces)[rest.faces[found.face]]
    normal = torch.nn.functional.normalize((found.weights[:, :, None] * normals).sum(1), dim=1)
    tangential = moved - offset - ((moved - offset) * normal).sum(1, keepdim=True) * normal
    assert float(tangential.norm(dim=1).median()) < 2e-5


def test_children_separate_along_the_normal_only_if_told(rest: RestMesh) -> None:
    for along, equal in ((False, True), (True, False)):
        rows = made_rows(rest)
        chosen = torch.ones(COUNT, dtype=torch.bool)
        parents = rows["distances"].detach().clone()
        split_of(rest, along)(rows, chosen, torch.Generator().manual_seed(0))
        children = rows["distances"].detach()
        assert torch.equal(children, parents.repeat_interleave(2, 0)) == equal
        assert not along or float((children[::2] - children[1::2]).abs().median()) > 0.001


def test_density_control_splits_on_the_mesh_within_the_budget(rest: RestMesh) -> None:
    """Above 5 mm split, else copied; a triangle may lose its last Gaussian, which GaussianAvatars' does not."""
    rows = made_rows(rest)
    with torch.no_grad():
        rows["log_scales"].fill_(math.log(0.004))
        rows["log_scales"][:10] = math.log(0.006)
        rows["opacity_logits"].fill_(0.0)
        rows["opacity_logits"][50:] = -6.0
        rows["gradient"][:20], rows["seen"][:] = 2e-4, 1.0
    control = DensityControl(0, 1_000, 10, 500, extent=0.5, budget=1_000, splitter=split_of(rest), keep_last=False)
    limited = dataclasses.replace(control, budget=65)
    for used, total in ((control, 50 + 20), (limited, 50 + 5)):
        grown = made_rows(rest)
        grown.load_state_dict(rows.state_dict())
        used.apply(grown, 10, torch.ones(len(rest.faces)), torch.Generator().manual_seed(0))
        assert len(grown) == total
    copies = made_rows(rest)
    grow(copies, torch.arange(COUNT) < 3)
    assert all(torch.equal(values[:3], values[-3:]) for values in copies.columns().values())


def test_scaling_regularizer_by_hand() -> None:
    """Large and thin Gaussians only; the mean of their largest deviations; 0, not NaN, if there are none."""
    scales = torch.tensor(
        [[0.003, 0.0002, 0.001], [0.003, 0.0004, 0.001], [0.0019, 1e-5, 1e-5], [0.001, 0.011, 0.005]],
        requires_grad=True,
    )
    found = scaling_regularizer(scales, 0.002, 10.0)
    assert torch.allclose(found, torch.tensor((0.003 + 0.011) / 2))
    (gradient,) = torch.autograd.grad(found, scales)
    assert gradient.nonzero().tolist() == [[0, 0], [3, 1]] and torch.allclose(gradient[0, 0], torch.tensor(0.5))
    assert float(scaling_regularizer(scales[1:3].detach(), 0.002, 10.0)) == 0.0
