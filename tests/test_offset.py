"""Surfaces moved outwards."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pointsdf_cli.geometry.offset import offset_surface


def test_a_ball_grows_by_the_distance() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.05)
    vertices, faces = offset_surface((ball.vertices, ball.faces), 0.004)
    np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 0.054, atol=1e-6)
    assert trimesh.Trimesh(vertices, faces).volume > ball.volume
    smaller, _ = offset_surface((ball.vertices, ball.faces), -0.004)
    np.testing.assert_allclose(np.linalg.norm(smaller, axis=1), 0.046, atol=1e-6)


def test_a_plane_moves_along_its_normal_whatever_its_triangles() -> None:
    grid = np.stack(np.meshgrid([0, 0.01, 0.05], [0, 0.03, 0.04], [0.2]), axis=-1).reshape(-1, 3)
    faces = np.array([[0, 1, 3], [1, 4, 3], [1, 2, 4], [2, 5, 4], [3, 4, 6], [4, 7, 6], [4, 5, 7]])
    vertices, _ = offset_surface((grid, faces), 0.01)
    up = np.sign(np.cross(grid[1] - grid[0], grid[3] - grid[0])[2])
    np.testing.assert_allclose(vertices[:8], grid[:8] + [0, 0, 0.01 * up], atol=1e-12)
    # A vertex without faces has no normal, and stays.
    assert vertices[8] == pytest.approx(grid[8])
