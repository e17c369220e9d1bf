"""Hulls drawn in by the skin that PyBullet gives them: bodies as large as they are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError, cKDTree

Array = NDArray[np.float64]

DEEPEST = 0.9
"""What is thinner than two skins is drawn in by this share of the way to its middle."""
FARTHEST = 2.0
"""No corner is drawn in by more skins than this: a square one needs 1.7, the edge of a wedge would
be lost for as long as the wedge is thinner than two skins."""


def drawn_in(corners: Array, skin: float) -> tuple[Array, NDArray[np.int64]]:
    """A convex hull's corners, so drawn in that it has its size again when it has a skin.

    Faces come to lie where they were, edges become round: a square one by 0.4 skins. Where it is
    thinner than two skins it still stands out, by less than one.

    Args:
        corners: [N, 3] of the hull, m.
        skin: Thickness [m], `PhysicsConfig.skin`.

    Returns:
        Corners [V, 3], V ≤ N if the hull is no sliver, and faces [F, 3], outwards.
    """
    hull = ConvexHull(corners)
    corners, sides = corners[hull.vertices], hull.equations
    inside, depth = _middle(corners, sides, skin)
    inward = sides.copy()
    inward[:, 3] += min(skin, DEEPEST * depth)
    # Of the new corners one for each old one: where many faces meet there are more of them, and
    # physics takes longer for each.
    within = HalfspaceIntersection(inward, inside).intersections
    away, nearest = cKDTree(within).query(corners)
    share = np.minimum(1.0, FARTHEST * skin / np.maximum(away, 1e-12))
    try:
        return _hull(corners + share[:, None] * (within[nearest] - corners))
    except QhullError:  # so small that corners met
        return _hull(within)


def drawn_in_cylinder(radius: float, length: float, skin: float) -> tuple[float, float]:
    """Radius and length [m] of a cylinder, the same."""
    depth = min(skin, DEEPEST * min(radius, length / 2.0))
    return radius - depth, length - 2.0 * depth


def _hull(points: Array) -> tuple[Array, NDArray[np.int64]]:
    """Corners [V, 3] and faces [F, 3], outwards, of the convex hull of points [N, 3]."""
    hull = ConvexHull(points)
    a, b, c = (points[hull.simplices[:, k]] for k in range(3))
    inwards = np.einsum("fi,fi->f", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces = np.where(inwards[:, None], hull.simplices[:, ::-1], hull.simplices)
    number = np.full(len(points), -1)
    number[hull.vertices] = np.arange(len(hull.vertices))
    return points[hull.vertices], number[faces].astype(np.int64)


def _middle(corners: Array, sides: Array, skin: float) -> tuple[Array, float]:
    """A place inside, and how deep it is: more than two skins, or as deep as any."""
    centre = corners.mean(axis=0)
    depth = float(-(sides[:, :3] @ centre + sides[:, 3]).max())
    if depth > 2.0 * skin:
        return centre, depth
    # The ball within all sides that has the largest radius (Boyd & Vandenberghe 2004, 4.3.1), in
    # lengths near 1, because the solver's tolerances are absolute.
    unit = float(np.ptp(corners, axis=0).max())
    found = linprog(
        [0.0, 0.0, 0.0, -1.0],
        A_ub=np.column_stack([sides[:, :3], np.ones(len(sides))]),
        b_ub=-(sides[:, 3] + sides[:, :3] @ centre) / unit,
        bounds=[(None, None)] * 3 + [(0.0, None)],
    )
    return centre + unit * found.x[:3], unit * float(found.x[3])
