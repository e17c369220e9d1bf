"""Inside of closed meshes, convex and not, against the winding number."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pointsdf_cli.geometry.inside import Inside
from pointsdf_cli.geometry.signed_distance import SignedDistance


@pytest.mark.parametrize(
    ("mesh", "convex"),
    [
        (trimesh.creation.box((0.1, 0.06, 0.04)), True),
        (trimesh.creation.icosphere(subdivisions=3, radius=0.05), True),
        (trimesh.creation.torus(0.04, 0.012), False),
        (trimesh.creation.annulus(0.02, 0.04, 0.1), False),
    ],
)
def test_inside_is_where_the_mesh_winds_around(mesh: trimesh.Trimesh, convex: bool) -> None:
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    inside = Inside(vertices, faces)
    assert (inside._planes is not None) == convex
    exact = SignedDistance(vertices, faces)
    points = np.random.default_rng(0).uniform(-0.07, 0.07, (400, 3))
    points = points[np.abs(exact(points)) > 1e-6]
    told = np.array([inside(point) for point in points])
    np.testing.assert_array_equal(told, exact.inside(points))
    assert 0 < told.sum() < len(told)


def test_a_part_within_another_counts_once_and_a_cavity_does_not() -> None:
    outer = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    part = trimesh.creation.torus(0.02, 0.006)
    hole = part.copy()
    hole.invert()
    for inner, solid in ((part, True), (hole, False)):
        body = trimesh.util.concatenate([outer, inner])
        inside = Inside(np.asarray(body.vertices), np.asarray(body.faces))
        assert inside(np.array([0.021, 0.001, 0.002])) is solid
        assert inside(np.array([0.001, 0.0, 0.0]))
        assert not inside(np.array([0.0, 0.0, 0.0501]))
