"""Primitives are closed, turned outwards, and of the volume that geometry says."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from pointsdf_cli.geometry.primitives import Triangles, box, cylinder, sphere


@pytest.mark.parametrize(
    ("made", "volume", "extents"),
    [
        (box((0.1, 0.2, 0.3)), 0.006, (0.1, 0.2, 0.3)),
        (cylinder(0.05, 0.2, 256), math.pi * 0.05**2 * 0.2, (0.1, 0.1, 0.2)),
        (sphere(0.05, 256), 4 / 3 * math.pi * 0.05**3, (0.1, 0.1, 0.1)),
    ],
)
def test_a_primitive_is_a_solid(
    made: Triangles, volume: float, extents: tuple[float, float, float]
) -> None:
    mesh = trimesh.Trimesh(*made, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(volume, rel=1e-3)
    np.testing.assert_allclose(mesh.extents, extents, rtol=1e-3)
    np.testing.assert_allclose(mesh.bounds.sum(axis=0), 0, atol=1e-12)
