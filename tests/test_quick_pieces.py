"""Greedy convex cutting: convex things stay whole, an L falls into two, closed or not."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from manifold3d import Manifold

from pointsdf_cli.errors import InputError
from pointsdf_cli.simulation.quick_pieces import MOST_CORNERS, quick_pieces


def volume_of(pieces: list) -> float:
    return sum(trimesh.Trimesh(*piece).volume for piece in pieces)


def arrays(solid: Manifold) -> tuple[np.ndarray, np.ndarray]:
    mesh = solid.to_mesh()
    return np.asarray(mesh.vert_properties)[:, :3].astype(float), np.asarray(mesh.tri_verts)


def test_a_ball_is_one_piece() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    (piece,) = quick_pieces(ball.vertices, ball.faces)
    assert len(piece[0]) <= MOST_CORNERS
    assert volume_of([piece]) == pytest.approx(ball.volume, rel=0.15)


def test_an_l_becomes_two_boxes() -> None:
    # Arms of 10 cm, 5 cm thick: one cut at half the length leaves no concavity.
    solid = Manifold.cube((0.1, 0.05, 0.05)) + Manifold.cube((0.05, 0.1, 0.05))
    pieces = quick_pieces(*arrays(solid))
    assert volume_of(pieces) == pytest.approx(solid.volume(), rel=0.02)
    assert len(pieces) <= 4


def test_a_ring_keeps_its_hole() -> None:
    ring = Manifold.cylinder(0.02, 0.05, circular_segments=48)
    ring -= Manifold.cylinder(0.04, 0.035, circular_segments=48).translate((0, 0, -0.01))
    pieces = quick_pieces(*arrays(ring))
    assert volume_of(pieces) < 1.35 * ring.volume()
    middle = np.array([0.0, 0.0, 0.01])
    for corners, faces in pieces:
        hull = trimesh.Trimesh(corners, faces).convex_hull
        assert not hull.contains(middle[None])[0]


def test_an_open_mesh_is_taken_as_its_hull() -> None:
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    pieces = quick_pieces(box.vertices, box.faces[:-2])
    assert volume_of(pieces) == pytest.approx(1e-3, rel=1e-3)


def test_a_flat_thing_is_refused() -> None:
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]], dtype=float)
    with pytest.raises(InputError, match="no volume"):
        quick_pieces(corners, np.array([[0, 1, 2], [0, 2, 3]]))
