"""Boxes, cylinders and spheres as closed triangle meshes around the origin.

trimesh makes these, too, but takes 0.2 s to load, which a plan and its picture do without.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pointsdf_cli.geometry.arrays import Array, Indices

Triangles = tuple[Array, Indices]
"""Vertices [V, 3] and faces [F, 3], counter-clockwise seen from outside."""

_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2
_BOX = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip


def box(size: Sequence[float]) -> Triangles:
    """A box with sides along the axes, of this size [3]."""
    return _CORNERS * np.asarray(size, dtype=np.float64), _BOX.copy()


def cylinder(radius: float, length: float, sections: int = 48) -> Triangles:
    """A cylinder along z with `sections` facets."""
    profile = np.array([[radius, -length / 2], [radius, length / 2]])
    return _turned(profile, -length / 2, length / 2, sections)


def sphere(radius: float, sections: int = 48) -> Triangles:
    """A sphere with `sections` facets around its equator and half as many from pole to pole."""
    latitudes = np.linspace(-np.pi / 2, np.pi / 2, max(2, sections // 2) + 1)[1:-1]
    profile = radius * np.stack([np.cos(latitudes), np.sin(latitudes)], axis=1)
    return _turned(profile, -radius, radius, sections)


def _turned(profile: Array, bottom: float, top: float, sections: int) -> Triangles:
    """A profile of radii and heights [P, 2], upwards, turned about z and closed by a vertex on the
    axis below and above."""
    angles = 2 * np.pi * np.arange(sections) / sections
    around = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    rings = np.empty((len(profile), sections, 3))
    rings[..., :2] = profile[:, None, :1] * around
    rings[..., 2] = profile[:, None, 1]
    vertices = np.concatenate([rings.reshape(-1, 3), [[0, 0, bottom], [0, 0, top]]])
    first = np.arange(sections)
    after = (first + 1) % sections
    last = sections * (len(profile) - 1)
    faces = [
        np.stack([after, first, np.full(sections, len(vertices) - 2)], axis=1),
        np.stack([last + first, last + after, np.full(sections, len(vertices) - 1)], axis=1),
    ]
    for ring in range(0, last, sections):
        low, low_after = ring + first, ring + after
        high, high_after = low + sections, low_after + sections
        faces.append(np.stack([low, low_after, high_after], axis=1))
        faces.append(np.stack([low, high_after, high], axis=1))
    return vertices, np.concatenate(faces)
