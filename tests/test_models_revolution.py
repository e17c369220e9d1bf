"""Axes of partial clouds against shapes with a known axis, and symmetric points of queries."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pointsdf_cli.models.neighbours import farthest_point_order, gather, nearest_neighbours
from pointsdf_cli.models.revolution import (
    Axis,
    places,
    revolution_axis,
    surface_normals,
    symmetric_points,
)
from pointsdf_cli.training.presets import SIDEWAYS

CAMERA = torch.tensor([[0.0, 0.0, -10.0]], dtype=torch.float64)
DIRECTION = np.array([0.3, 0.8, -0.52]) / np.linalg.norm([0.3, 0.8, -0.52])
POINT = np.array([0.05, -0.02, 0.1])


def _turned(heights: np.ndarray, radii: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Points at those cylindrical coordinates about the line of POINT and DIRECTION."""
    first = np.cross(DIRECTION, [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(DIRECTION, first)
    radial = np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second
    return POINT + heights[:, None] * DIRECTION + radii[:, None] * radial


def _half_vase(noise: float, handle: int = 0, count: int = 1000) -> torch.Tensor:
    """The front of a vase r(h) = 0.3 + 0.1 sin 4h, |h| < 0.4, as a cloud [1, count, 3]."""
    rng = np.random.default_rng(0)
    heights, angles = rng.uniform(-0.4, 0.4, 6 * count), rng.uniform(-np.pi, np.pi, 6 * count)
    points = _turned(heights, 0.3 + 0.1 * np.sin(4 * heights), angles)
    outwards = _turned(np.zeros(6 * count), np.ones(6 * count), angles) - POINT
    front = points[outwards[:, 2] < -0.25][: count - handle]
    bar = np.array([0.45, 0.1, -0.1]) + rng.uniform(-1, 1, (handle, 3)) * [0.02, 0.15, 0.02]
    cloud = np.concatenate([front, bar]) + rng.normal(0.0, noise, (count, 3))
    return torch.from_numpy(cloud)[None]


def _axis(cloud: torch.Tensor, sideways: float = 0.0) -> Axis:
    points = gather(cloud, farthest_point_order(cloud, 256))
    neighbours = nearest_neighbours(points, cloud, 24)
    normals = surface_normals(points, neighbours, cloud, CAMERA)
    return revolution_axis(points, normals, CAMERA, sideways)


@pytest.mark.parametrize(("noise", "handle"), [(0.0, 0), (0.003, 0), (0.003, 120)])
def test_the_axis_of_a_vase_is_found_from_its_front(noise: float, handle: int) -> None:
    axis = _axis(_half_vase(noise, handle))
    assert abs(float(axis.direction[0] @ torch.from_numpy(DIRECTION))) > np.cos(np.radians(3))
    offset = axis.point[0].numpy() - POINT
    aside = offset - (offset @ DIRECTION) * DIRECTION
    assert np.linalg.norm(aside) < 0.02
    assert float(axis.miss[0]) < 0.02


def test_the_axis_points_to_the_camera() -> None:
    axis = _axis(_half_vase(0.0))
    assert float(((CAMERA - axis.point) * axis.direction).sum()) > 0


@pytest.mark.parametrize("sideways", [0.0, 1e-3])
def test_the_axis_of_a_ball_goes_through_its_centre(sideways: float) -> None:
    axis = _axis(_near_side_of_a_ball(), sideways)
    offset = np.array([0.1, 0.0, 0.2]) - axis.point[0].numpy()
    direction = axis.direction[0].numpy()
    assert np.linalg.norm(offset - (offset @ direction) * direction) < 0.01


def _near_side_of_a_ball() -> torch.Tensor:
    rng = np.random.default_rng(1)
    outwards = rng.normal(size=(3000, 3))
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    cloud = 0.4 * outwards[outwards[:, 2] < -0.1][:1000] + [0.1, 0.0, 0.2]
    return torch.from_numpy(cloud + rng.normal(0.0, 0.003, cloud.shape))[None]


def test_of_the_axes_of_a_ball_one_across_the_view_is_wanted() -> None:
    cloud = _near_side_of_a_ball()
    axis = _axis(cloud, SIDEWAYS)
    view = torch.nn.functional.normalize(CAMERA, dim=-1)
    assert abs(float((axis.direction * view).sum())) < 0.1
    # Turned about it, the far side has been seen.
    far = torch.tensor([[[0.1, 0.0, 0.6]]], dtype=cloud.dtype)
    symmetric, _ = symmetric_points(far, axis, cloud, places(cloud, axis))
    assert float(torch.cdist(far, cloud).min()) > 0.3
    assert float(torch.cdist(symmetric, cloud).min()) < 0.03


@pytest.mark.parametrize("away", [0.2, 0.6, 1.5])
def test_an_axis_that_is_the_only_one_is_found_from_anywhere(away: float) -> None:
    # Only one line fits a vase, be it seen from above or from the side.
    rng = np.random.default_rng(0)
    heights, angles = rng.uniform(-0.4, 0.4, 9000), rng.uniform(-np.pi, np.pi, 9000)
    points = _turned(heights, 0.3 + 0.1 * np.sin(4 * heights), angles)
    outwards = _turned(np.zeros(9000), np.ones(9000), angles) - POINT
    side = np.cross(DIRECTION, [0.0, 0.0, 1.0])
    across = np.cross(side / np.linalg.norm(side), DIRECTION)
    view = np.cos(away) * DIRECTION + np.sin(away) * across
    cloud = torch.from_numpy(points[outwards @ view > 0.2 * np.sin(away)][:1000])[None]
    camera = torch.from_numpy(3.0 * view)[None]
    near = gather(cloud, farthest_point_order(cloud, 256))
    normals = surface_normals(near, nearest_neighbours(near, cloud, 24), cloud, camera)
    axis = revolution_axis(near, normals, camera, SIDEWAYS)
    assert abs(float(axis.direction[0] @ torch.from_numpy(DIRECTION))) > np.cos(np.radians(3))


def test_normals_of_a_slab_seen_from_an_edge_miss_the_axis_of_any_turning() -> None:
    rng = np.random.default_rng(2)
    sides = []
    for normal, reach in (([0.0, 0.0, 1.0], 0.1), ([1.0, 0.0, 0.0], 0.45), ([0.0, 1.0, 0.0], 0.3)):
        extent = np.array([0.45, 0.3, 0.1])
        points = rng.uniform(-1, 1, (400, 3)) * extent
        points[:, np.argmax(normal)] = -reach
        sides.append(points)
    axis = _axis(torch.from_numpy(np.concatenate(sides)[rng.permutation(1200)[:1000]])[None])
    assert float(axis.miss[0]) > 3 * float(_axis(_half_vase(0.003)).miss[0])


def test_the_symmetric_point_of_a_point_on_the_hidden_side_lies_on_the_seen_side() -> None:
    cloud = _half_vase(0.0)
    axis = _axis(cloud)
    rng = np.random.default_rng(3)
    heights, angles = rng.uniform(-0.35, 0.35, 400), rng.uniform(-np.pi, np.pi, 400)
    surface = _turned(heights, 0.3 + 0.1 * np.sin(4 * heights), angles)
    outwards = _turned(np.zeros(400), np.ones(400), angles) - POINT
    hidden = torch.from_numpy(surface[outwards[:, 2] > 0.3])[None]
    symmetric, trust = symmetric_points(hidden, axis, cloud, places(cloud, axis))
    before = torch.cdist(hidden, cloud).amin(-1)
    after = torch.cdist(symmetric, cloud).amin(-1)
    assert float(before.median()) > 0.3
    assert float(after.quantile(0.9)) < 0.03
    # The cosine of the turn.
    assert float(trust[0, :, 3].median()) < 0.5


def test_a_seen_point_is_its_own_symmetric_point() -> None:
    cloud = _half_vase(0.0)
    axis = _axis(cloud)
    symmetric, trust = symmetric_points(cloud, axis, cloud, places(cloud, axis))
    torch.testing.assert_close(symmetric, cloud, atol=1e-6, rtol=0.0)
    assert float(trust[0, :, 3].min()) > 0.999
