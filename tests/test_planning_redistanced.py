"""Redistancing against a ball's exact distances: a field that is near zero far from its surface is
corrected, one that is right stays as it is."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from planning_worlds import SphereField

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.planning.fields import RedistancedField, SeenField
from pointsdf_cli.planning.grid import GridConfig, GridField
from pointsdf_cli.planning.target import ObjectField, redistanced

RADIUS = 0.03
LOW, HIGH = np.full(3, -0.1), np.full(3, 0.1)
BALL = SphereField(RADIUS)
MARGIN, ENOUGH = RedistancedField.MARGIN, RedistancedField.ENOUGH


class Flat:
    """A ball's distance that stays at 2 mm above the ball, as networks' fields do."""

    def __init__(self) -> None:
        self.asked = 0

    def __call__(self, points: Array) -> Array:
        self.asked += len(points)
        values = BALL(points)
        return np.where(points[:, 2] > 0.02, np.minimum(values, 0.002), values)

    def with_gradient(self, points: Array) -> tuple[Array, Array]:
        return self(points), BALL.with_gradient(points)[1]


def on_ball() -> NDArray[np.float64]:
    """4000 points of the ball's surface: none of its places is farther than 3 mm from one."""
    ways = np.random.default_rng(1).normal(size=(4000, 3))
    return RADIUS * ways / np.linalg.norm(ways, axis=1, keepdims=True)


@pytest.fixture
def points() -> NDArray[np.float64]:
    return np.random.default_rng(0).uniform(-0.1, 0.1, (4000, 3))


@pytest.fixture
def corrected() -> RedistancedField:
    return RedistancedField(Flat(), on_ball(), BALL)


def test_far_from_the_surface_the_value_is_the_distance_less_the_margin(corrected, points) -> None:
    truth, flat = BALL(points), Flat()(points)
    far = (flat < 0.003) & (truth > 0.02)
    assert far.sum() > 100
    found = corrected(points[far])
    assert (found >= truth[far] - MARGIN - 1e-12).all()
    assert (found <= truth[far] - MARGIN + 0.003).all()


def test_near_the_surface_and_inside_the_field_keeps_its_values(corrected, points) -> None:
    near = BALL(points) < MARGIN - 0.003
    assert (BALL(points) < -0.015).any()
    np.testing.assert_array_equal(corrected(points[near]), Flat()(points[near]))


def test_no_value_exceeds_a_true_distance(corrected, points) -> None:
    assert (corrected(points) <= BALL(points) + 1e-12).all()


def test_the_field_is_not_evaluated_where_the_distance_is_enough(points) -> None:
    field = Flat()
    fixed = RedistancedField(field, on_ball(), BALL)
    far = points[BALL(points) > MARGIN + ENOUGH + 0.003]
    assert len(far) > 1000
    fixed(far)
    assert field.asked == 0
    fixed(np.array([[0.0, 0.0, RADIUS + MARGIN + ENOUGH / 2]]))
    assert field.asked == 1


def test_values_with_gradients_are_the_same_and_point_away_from_the_surface(
    corrected, points
) -> None:
    values, gradients = corrected.with_gradient(points)
    np.testing.assert_allclose(values, corrected(points))
    far = BALL(points) > MARGIN + ENOUGH + 0.003
    outwards = points[far] / np.linalg.norm(points[far], axis=1, keepdims=True)
    assert ((gradients[far] * outwards).sum(axis=1) > 0.99).all()


def test_a_raised_grid_keeps_its_error_bounds(points) -> None:
    grid = GridField(Flat(), LOW, HIGH, GridConfig(step=0.005))
    field = RedistancedField(Flat(), on_ball(), grid)
    raised = grid.raised(field.least, ENOUGH + MARGIN)
    value, bound = raised.with_bound(points)
    # The flat field jumps at z = 0.02, where no bound can hold.
    smooth = (np.abs(points[:, 2] - 0.02) > 0.02) & (BALL(points) < ENOUGH)
    assert (np.abs(value - field(points))[smooth] <= bound[smooth] + 1e-12).all()
    assert (raised(points) >= grid(points) - 1e-12).all()
    assert (raised(points) > grid(points) + 0.01).any()


def test_a_hand_may_be_where_only_a_flat_field_forbade_it() -> None:
    flat = Flat()
    shape = ObjectField.of(flat, LOW, HIGH, GridConfig(step=0.01, levels=3, band=0.0))
    above = np.array([[0.0, 0.0, 0.08]])
    assert shape.field(above)[0] == pytest.approx(0.002)
    fixed = redistanced(shape, np.array([[0.0, 0.0, RADIUS]]))
    assert fixed.surface is not None
    assert np.abs(BALL(fixed.surface[0])).max() < 0.002
    for field in (fixed.field, fixed.kept):
        assert field(above)[0] > 0.02
    assert SeenField(fixed.surface[0])(above)[0] == pytest.approx(0.05, abs=0.003)


def test_a_field_without_an_inside_stays_as_it_is() -> None:
    shape = ObjectField.of(SphereField(-0.01), LOW, HIGH)
    assert redistanced(shape, np.zeros((1, 3))) is shape
