"""The mesh of a partial cloud: closed, around the seen points, and blind to the rest."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pointsdf_cli.errors import InputError
from pointsdf_cli.planning.fields import MeshField
from pointsdf_cli.planning.partial_view import SPAN, partial_mesh


@pytest.fixture
def half_ball() -> np.ndarray:
    """The side of a ball of 5 cm about (0.6, 0, 0.1) that faces −x."""
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(20_000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return np.array([0.6, 0, 0.1]) + 0.05 * direction[direction[:, 0] < 0]


def test_the_mesh_is_closed_and_follows_the_points(half_ball: np.ndarray) -> None:
    vertices, faces = partial_mesh(half_ball)
    mesh = trimesh.Trimesh(vertices, faces)
    voxel = 0.1 / SPAN
    assert mesh.is_watertight
    assert mesh.volume > 0
    from_centre = np.linalg.norm(vertices - [0.6, 0, 0.1], axis=1)
    assert np.abs(from_centre - 0.05).max() < 2 * voxel


def test_seen_points_are_taken_and_the_unseen_side_is_free(half_ball: np.ndarray) -> None:
    field = MeshField(*partial_mesh(half_ball))
    voxel = 0.1 / SPAN
    assert field(half_ball).max() < voxel
    behind = np.array([[0.64, 0.0, 0.1], [0.6, 0.0, 0.1]])
    assert (field(behind) > 0.02).all()


def test_gradients_point_away(half_ball: np.ndarray) -> None:
    value, gradient = MeshField(*partial_mesh(half_ball)).with_gradient(np.array([[0.4, 0.0, 0.1]]))
    assert value[0] == pytest.approx(0.15, abs=0.1 / SPAN)
    assert gradient[0, 0] < -0.98


def test_what_is_no_cloud_is_refused() -> None:
    with pytest.raises(InputError, match="shape"):
        partial_mesh(np.zeros((0, 3)))
    with pytest.raises(InputError, match="same"):
        partial_mesh(np.ones((5, 3)))
