"""The cached grid against fields with known distances: its bound holds, its gradient is its own."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from planning_worlds import BoxField, SphereField

from pointsdf_cli.errors import InputError
from pointsdf_cli.planning.fields import SeenField, UnionField
from pointsdf_cli.planning.grid import GridConfig, GridField, surface_box
from pointsdf_cli.planning.target import MOST_CELLS, ObjectField

LOW, HIGH = np.full(3, -0.1), np.full(3, 0.1)


@pytest.fixture
def points() -> NDArray[np.float64]:
    return np.random.default_rng(0).uniform(-0.1, 0.1, (20_000, 3))


@pytest.mark.parametrize("field", [SphereField(0.05), BoxField((0.08, 0.05, 0.12))])
def test_no_value_is_farther_off_than_its_bound(field, points) -> None:
    grid = GridField(field, LOW, HIGH, GridConfig(step=0.004))
    off = np.abs(grid(points) - field(points))
    assert (off <= grid.with_bound(points)[1] + 1e-12).all()


def test_near_the_surface_the_bound_is_that_of_the_finest_cells(points) -> None:
    config = GridConfig(step=0.004, band=0.005)
    field = SphereField(0.05)
    grid = GridField(field, LOW, HIGH, config)
    near = np.abs(field(points)) < config.band
    assert near.sum() > 500
    assert grid.with_bound(points[near])[1].max() <= np.sqrt(3) / 2 * config.step + 1e-12


def test_a_plane_is_kept_exactly_and_a_sphere_to_curvature(points) -> None:
    field = SphereField(0.05)
    grid = GridField(field, LOW, HIGH, GridConfig(step=0.004, band=0.005))
    near = np.abs(field(points)) < 0.005
    # Second derivatives of |x| are at most 1/|x|: the interpolation error is 3/8 h²/|x| at most.
    assert np.abs(grid(points[near]) - field(points[near])).max() < 3 / 8 * 0.004**2 / 0.04


def test_the_field_is_asked_less_often_than_the_finest_grid_has_nodes() -> None:
    grid = GridField(SphereField(0.05), LOW, HIGH, GridConfig(step=0.004))
    assert grid.queries < 0.25 * 51**3


def test_the_lower_of_two_fields_keeps_the_bound_of_the_first(points) -> None:
    seen = np.random.default_rng(1).normal(size=(500, 3))
    seen = 0.02 * seen / np.linalg.norm(seen, axis=1, keepdims=True) + [0.06, 0.03, 0.0]
    ball, other = SphereField(0.05), SeenField(seen)
    grid = GridField(ball, LOW, HIGH, GridConfig(step=0.004))
    kept = grid(points)
    joint = grid.minimum_with(other)
    value, bound = joint.with_bound(points)
    both = UnionField(ball, other)
    assert (np.abs(value - both(points)) <= bound + 1e-12).all()
    assert (value < ball(points) - 0.01).any()
    np.testing.assert_array_equal(grid(points), kept)
    values, gradients = both.with_gradient(points)
    np.testing.assert_array_equal(values, both(points))
    nearer = other(points) < ball(points)
    np.testing.assert_array_equal(gradients[nearer], other.with_gradient(points[nearer])[1])
    np.testing.assert_array_equal(gradients[~nearer], ball.with_gradient(points[~nearer])[1])


def test_a_distance_up_to_a_limit_is_the_lower_of_the_two() -> None:
    rng = np.random.default_rng(2)
    seen = SeenField(np.c_[rng.uniform(-0.1, 0.1, (400, 2)), np.zeros(400)])
    points = rng.uniform(-0.3, 0.3, (3000, 3))
    limits = rng.uniform(-0.05, 0.4, 3000)
    limits[:500] = seen(points[:500])  # ties
    limits[500] = 0.0
    expected = np.minimum(seen(points), limits)
    assert (expected < limits).any()
    assert (expected == limits).any()
    np.testing.assert_array_equal(seen.at_most(points, limits), expected)


def test_gradients_agree_with_differences_of_the_grid_itself(points) -> None:
    grid = GridField(BoxField((0.08, 0.05, 0.12)), LOW, HIGH)
    # Also outside of the box, but not so near to a cell's side that the difference crosses it.
    x = points[:2000] * 1.8
    place = ((x + 0.1) / 0.004) % 1
    x = x[((place > 0.01) & (place < 0.99)).all(axis=1)]
    _, gradient = grid.with_gradient(x)
    step = 1e-6
    for axis in range(3):
        shift = np.eye(3)[axis] * step
        difference = (grid(x + shift) - grid(x - shift)) / (2 * step)
        np.testing.assert_allclose(gradient[:, axis], difference, atol=1e-5)


def test_outside_of_the_box_the_distance_is_never_overstated(points) -> None:
    field = SphereField(0.05)
    grid = GridField(field, LOW, HIGH)
    far = points * 4
    far = far[(np.abs(far) > 0.1).any(axis=1)]
    edge = grid.with_bound(np.clip(far, -0.1, 0.1))[1]
    assert (grid(far) <= field(far) + edge).all()


def test_an_impossible_grid_is_refused() -> None:
    with pytest.raises(InputError, match="step"):
        GridConfig(step=0.0)
    with pytest.raises(InputError, match="256"):
        GridField(SphereField(0.05), LOW * 100, HIGH * 100, GridConfig(levels=1))


def test_the_surface_box_holds_the_object_and_little_more() -> None:
    field = BoxField((0.04, 0.1, 0.2), (0.03, 0.0, 0.1))
    low, high = surface_box(field, np.full(3, -0.3), np.full(3, 0.3), step=0.03)
    assert (low <= [0.01, -0.05, 0.0]).all()
    assert (high >= [0.05, 0.05, 0.2]).all()
    assert (high - low <= np.array([0.04, 0.1, 0.2]) + 4 * 0.03).all()
    with pytest.raises(InputError, match="positive everywhere"):
        surface_box(SphereField(0.05, (2, 0, 0)), LOW, HIGH, step=0.05)


def test_a_room_gets_larger_cells_and_not_more_of_them() -> None:
    room = ObjectField.of(SphereField(0.5), np.full(3, -1.0), np.full(3, 1.0))
    assert room.kept._values.size < 1.3 * MOST_CELLS
    value, bound = room.kept.with_bound(np.array([[0.6, 0.1, 0.0]]))
    assert abs(value - (np.hypot(0.6, 0.1) - 0.5)) <= bound
