"""Surface of a vessel: its outline revolved, united with the meshes of its other parts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.arrays import Array, Surface
from pointsdf_cli.geometry.axis_fit import perpendicular
from pointsdf_cli.geometry.vessel import Vessel

SECTORS = 96
"""Faces around the axis."""


def vessel_surface(
    vessel: Vessel, others: Surface | None = None, smallest_part: float = 0.0
) -> tuple[Array, NDArray[np.int32], int]:
    """A closed surface of a vessel.

    Args:
        vessel: The vessel.
        others: Closed surface of its other parts: vertices [V, 3] m and faces [F, 3].
        smallest_part: Separate parts smaller than this share of the largest are dropped.

    Returns:
        Vertices [V, 3] m, faces [F, 3], and the number of parts dropped.
    """
    from manifold3d import CrossSection, Error, FillRule, Manifold, Mesh

    # About the origin; the axis of a revolved body is z.
    u, v = perpendicular(vessel.wall.direction)
    placed = np.stack([u, v, vessel.wall.direction, np.zeros(3)], axis=1)
    half = CrossSection([vessel.wall.outline], FillRule.NonZero)
    body = half.revolve(SECTORS).transform(placed)
    if others is not None:
        mesh = Mesh(np.float32(others[0] - vessel.wall.point), np.uint32(others[1]))
        part = Manifold(mesh)
        if part.status() == Error.NoError:
            body = body + part
    parts = sorted(body.decompose(), key=lambda part: -part.volume())
    kept = [part for part in parts if part.volume() >= smallest_part * parts[0].volume()]
    made = Manifold.compose(kept).to_mesh()
    vertices = np.asarray(made.vert_properties[:, :3], dtype=np.float64) + vessel.wall.point
    return vertices, np.asarray(made.tri_verts, dtype=np.int32), len(parts) - len(kept)
