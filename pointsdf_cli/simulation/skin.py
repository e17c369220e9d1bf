"""Shrinking of hulls by the skin that PyBullet adds, so that bodies keep their size."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError, cKDTree

from pointsdf_cli.geometry.arrays import Array

Faces = NDArray[np.int64]

DEEPEST = 0.9
"""Share of its inner radius by which a shape about as thin as two skins is shrunk."""
FARTHEST = 3.0
"""Largest shift of a corner, in skins: a right-angled one needs 1.7, the end of an edge of 45° 2.8;
a sharper wedge would lose everything thinner than two skins."""
WORTH = 0.2
"""Distance, in skins, from the hull of the others beyond which a further corner is kept."""
SIDES = 32
"""Corners on the circle of the prism that PyBullet uses for a URDF's cylinder."""


def shrunk(corners: Array, faces: Faces, skin: float) -> tuple[Array, Faces]:
    """Shrink a convex hull so that with its skin it has its original size.

    Faces stay where they were, edges become round: a right-angled one by 0.4 skins. Where more than
    three faces meet, they may lean by a fifth of a skin. At edges and corners sharper than 45°, and
    where it is thinner than two skins, the hull still protrudes by less than one skin and loses up
    to two at the sharp end. A nearly flat hull is unchanged.

    Args:
        corners: [N, 3], corners of the hull, m.
        faces: [F, 3], outwards.
        skin: Thickness [m], `PhysicsConfig.skin`.

    Returns:
        Corners [V, 3] and faces [G, 3], outwards.
    """
    if skin == 0.0:
        return corners, faces
    try:
        hull = ConvexHull(corners)
        inside, depth = _middle(corners, hull.equations, skin)
        inward = hull.equations.copy()
        inward[:, 3] += min(skin, DEEPEST * depth)
        within = HalfspaceIntersection(inward, inside).intersections
        old = corners[hull.vertices]
        away, nearest = cKDTree(within).query(old)
        share = np.minimum(1.0, FARTHEST * skin / np.maximum(away, 1e-12))
        try:
            new = _with_the_rest(old + share[:, None] * (within[nearest] - old), within, skin)
        except QhullError:  # so small that corners met
            new = within
        return _hull(new)
    except QhullError:
        return corners, faces


def _with_the_rest(corners: Array, within: Array, skin: float) -> Array:
    """Add those of the corners `within` [N, 3] that change the hull noticeably.

    Where more than three faces meet, an old corner has several new ones, and with the nearest alone
    the other faces would lean inwards. All of them would slow the physics down.
    """
    sides = ConvexHull(corners).equations
    outside = (within @ sides[:, :3].T + sides[:, 3]).max(axis=1)
    return np.concatenate([corners, within[outside > WORTH * skin]])


def shrunk_cylinder(radius: float, length: float, skin: float) -> tuple[float, float]:
    """Radius and length [m] of a shrunk cylinder. PyBullet's prism has its corners outside the
    circle by as much as its sides are inside, 0.24% of the radius."""
    if skin == 0.0:
        return radius, length
    depth = min(skin, DEEPEST * min(radius, length / 2.0))
    return (radius - depth) * 2.0 / (1.0 + np.cos(np.pi / SIDES)), length - 2.0 * depth


def _hull(points: Array) -> tuple[Array, Faces]:
    """Corners [V, 3] and faces [F, 3], outwards, of the convex hull of points [N, 3]."""
    hull = ConvexHull(points)
    a, b, c = (points[hull.simplices[:, k]] for k in range(3))
    inwards = np.einsum("fi,fi->f", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces = np.where(inwards[:, None], hull.simplices[:, ::-1], hull.simplices)
    number = np.full(len(points), -1)
    number[hull.vertices] = np.arange(len(hull.vertices))
    return points[hull.vertices], number[faces].astype(np.int64)


def _middle(corners: Array, sides: Array, skin: float) -> tuple[Array, float]:
    """A point inside, and its depth: more than two skins, or the largest possible."""
    centre = corners.mean(axis=0)
    depth = float(-(sides[:, :3] @ centre + sides[:, 3]).max())
    if depth > 2.0 * skin:
        return centre, depth
    # The largest ball within all sides (Boyd & Vandenberghe 2004, 4.3.1), in lengths near 1,
    # because the solver's tolerances are absolute.
    unit = float(np.ptp(corners, axis=0).max())
    found = linprog(
        [0.0, 0.0, 0.0, -1.0],
        A_ub=np.column_stack([sides[:, :3], np.ones(len(sides))]),
        b_ub=-(sides[:, 3] + sides[:, :3] @ centre) / unit,
        bounds=[(None, None)] * 3 + [(0.0, None)],
    )
    if found.x is None:
        raise QhullError(found.message)
    return centre + unit * found.x[:3], unit * float(found.x[3])
