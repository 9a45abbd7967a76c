"""Schedule of points and targets of their motion, by hand."""

from __future__ import annotations

import dataclasses

import pytest
import torch

from ggavatar.head.model import HeadModel
from ggavatar.points.deformer import Bases
from ggavatar.points.head_targets import HeadTargets
from ggavatar.points.point_cloud import CloudSchedule, PointCloud

PLAN = CloudSchedule(steps_per_epoch=10, upsampling_epochs=5, pruning_steps=10, max_points=1_000, min_radius=0.006)


@pytest.fixture
def cloud() -> PointCloud:
    return PointCloud(400, 0.5, 0.3, 1e-4, torch.Generator().manual_seed(0))


def none(cloud: PointCloud) -> torch.Tensor:
    return torch.zeros(len(cloud.rows), dtype=torch.bool)


def test_printed_start(cloud: PointCloud) -> None:
    assert torch.allclose(cloud.points.norm(dim=1), torch.tensor(0.5)) and len(cloud.rows) == 400
    assert float(cloud.radius) == pytest.approx(0.16875)


def test_doubling_shrinks_discs_and_stays_within_half_a_radius(cloud: PointCloud) -> None:
    before = cloud.points.detach().clone()
    cloud.upsample(torch.Generator().manual_seed(1))
    assert len(cloud.rows) == 800 and float(cloud.radius) == pytest.approx(0.75 * 0.16875)
    assert torch.equal(cloud.points[:400], before)
    apart = (cloud.points[400:] - before).abs()
    assert 0.9 * 0.16875 / 2 < apart.max() <= 0.16875 / 2


def test_points_that_never_showed_go_and_doubling_stops_at_the_limit(cloud: PointCloud) -> None:
    seen = none(cloud)
    seen[:300] = True
    for step in range(1, 101):
        shown = none(cloud)
        shown[: min(300, len(shown))] = step % 10 == 3
        cloud.advance(step, shown, PLAN, torch.Generator().manual_seed(step))
        if step == 9:
            assert len(cloud.rows) == 400
        if step == 10:
            assert len(cloud.rows) == 300 and not cloud.rows["shown"].any()
        if step == 50:
            assert len(cloud.rows) == 600
    assert len(cloud.rows) == 600
    cloud.advance(150, ~none(cloud), dataclasses.replace(PLAN, max_points=1_199), torch.Generator())
    assert len(cloud.rows) == 600
    cloud.advance(200, ~none(cloud), dataclasses.replace(PLAN, max_points=1_200), torch.Generator())
    assert len(cloud.rows) == 1_200


def test_no_pruning_of_small_discs_nor_of_everything(cloud: PointCloud) -> None:
    cloud.advance(10, none(cloud), PLAN, torch.Generator())
    assert len(cloud.rows) == 400
    cloud.radius.fill_(0.0059)
    some = none(cloud)
    some[:7] = True
    cloud.advance(20, some, PLAN, torch.Generator())
    assert len(cloud.rows) == 400
    cloud.radius.fill_(0.006)
    cloud.advance(30, some, PLAN, torch.Generator())
    assert len(cloud.rows) == 7


def test_another_number_of_points_can_be_loaded(cloud: PointCloud) -> None:
    other = PointCloud(100, 0.5, 0.3, 1e-4, torch.Generator().manual_seed(5))
    cloud.upsample(torch.Generator().manual_seed(1))
    other.load_state_dict(cloud.state_dict())
    assert torch.equal(other.points, cloud.points) and torch.equal(other.radius, cloud.radius)


def test_targets_are_those_of_the_nearest_vertex(toy_head: HeadModel) -> None:
    coefficients = torch.tensor([[0.0, 0, 0, 0, 0], [2.0, 1, 1, 0, 0]])
    targets = HeadTargets.of(toy_head, toy_head.neutral_drive(), coefficients, unit=4.0)
    chosen = torch.tensor([5, 40, 70])
    near = 4 * toy_head.template[chosen] + 1e-3
    assert torch.equal(targets.nearest(near), chosen)
    shapes = torch.zeros(3, 36 + 5, 3)
    shapes[:, 36:39] = 4 * toy_head.expression_basis[chosen].transpose(1, 2)
    weights = torch.cat((torch.zeros(3, 1), toy_head.skinning_weights[chosen]), dim=1)
    exact = targets.losses(Bases(shapes, weights, torch.zeros(3, 3)), near)
    assert set(exact) == {"skinning", "correctives", "expressions"} and all(value < 1e-12 for value in exact.values())

    shapes[:, 0, 0] += 0.01
    shapes[:, 36, 1] += 0.02
    wrong = targets.losses(Bases(shapes, weights + 0.1, torch.zeros(3, 3)), near)
    assert wrong["skinning"] == pytest.approx(0.1 * 0.01, rel=1e-4)
    assert wrong["correctives"] == pytest.approx(10 * 0.1**2 / (36 * 3), rel=1e-4)
    assert wrong["expressions"] == pytest.approx(10 * 0.2**2 / 2.0 / 50 / (5 * 3), rel=1e-4)
    assert torch.allclose(targets.variances, torch.tensor([2.0, 0.5, 0.5, 0.006, 0.006]))
