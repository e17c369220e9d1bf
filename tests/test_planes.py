"""Planes against points whose planes are known."""

from __future__ import annotations

import numpy as np
import pytest

from pointsdf_cli.camera.support_plane import largest_plane
from pointsdf_cli.geometry.planes import least_squares_plane, planes_through


def test_planes_of_triples_are_known_by_hand() -> None:
    level = [[0.0, 0.0, 0.3], [1.0, 0.0, 0.3], [0.0, 1.0, 0.3]]
    line = [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [2.0, 2.0, 2.0]]
    slope = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]  # x + y + z = 1
    normals, through = planes_through(np.array([level, line, slope]))
    assert normals == pytest.approx(np.array([[0, 0, 1], np.ones(3) / np.sqrt(3)]))
    assert through == pytest.approx(np.array([level[0], slope[0]]))


def test_the_nearest_plane_lies_between_two_layers() -> None:
    x, y = np.meshgrid(np.arange(4.0), np.arange(5.0))
    layers = [np.stack([x, y, np.full_like(x, z)], axis=-1).reshape(-1, 3) for z in (0.9, 1.1)]
    normal, centre = least_squares_plane(np.concatenate(layers))
    assert np.abs(normal) == pytest.approx([0, 0, 1])
    assert centre == pytest.approx([1.5, 2.0, 1.0])


def test_the_largest_of_three_planes_is_found_and_faces_the_origin() -> None:
    rng = np.random.default_rng(3)
    parts = []
    for axis, at, count in ((2, 1.5, 3000), (0, -0.8, 2000), (1, 0.6, 1000)):
        part = rng.uniform(-0.5, 0.5, (count, 3)) + [0.0, 0.0, 1.0]
        part[:, axis] = at + rng.normal(0, 0.001, count)
        parts.append(part)
    plane, near = largest_plane(np.concatenate(parts))
    assert plane == pytest.approx([0, 0, -1, -1.5], abs=2e-3)
    assert near[:3000].all()
    assert near[3000:].mean() < 0.05


def test_points_in_a_line_have_a_plane_through_them() -> None:
    line = np.outer(np.linspace(1, 2, 50), [0.0, 0.0, 1.0]) + [0.1, 0.0, 0.0]
    plane, near = largest_plane(line)
    assert near.all()
    assert np.linalg.norm(plane[:3]) == pytest.approx(1)
