"""A surface moved outwards."""

from __future__ import annotations

import numpy as np

from pointsdf_cli.geometry.arrays import Array, Surface


def offset_surface(surface: Surface, distance: float) -> Surface:
    """Move every vertex along its normal, the mean of its faces' by area.

    Args:
        surface: Vertices [V, 3] m and faces [F, 3]; normals point outwards.
        distance: Outwards if positive, m.
    """
    vertices, faces = surface
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    summed: Array = np.zeros_like(vertices)
    for corner in faces.T:
        np.add.at(summed, corner, normals)
    length = np.linalg.norm(summed, axis=1, keepdims=True)
    return vertices + distance * summed / np.maximum(length, 1e-300), faces
