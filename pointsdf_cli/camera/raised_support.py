"""Things that stand on a tray, in a box or on a pedestal, apart from what they stand on.

All of it is often one group of points above the table. A thing that stands on a level surface has
that surface around it; the rim of a tray and the wall of a bin have it on one side only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from pointsdf_cli.camera.concave_split import standing_parts
from pointsdf_cli.camera.segmentation import FEWEST, GAP, clusters
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.box import horizontal_width

NARROWEST = 0.18
"""Least width [m] of a support in every horizontal direction: drills, wings of toy aeroplanes, lids
and the floors of pans are narrower."""
SHARE, FILLED, CELL = 0.3, 0.7, 0.01
"""Least share of the group's points on its level surface, and least share of the cells [m] within
the surface's convex hull that have such points: a wall all around is not filled."""
STEP, BAND = 0.003, 0.006
"""Bins of the heights [m] among which that surface is found, and its half thickness [m]."""
LOWEST = 0.015
"""Least height of a thing above it [m]."""
AROUND = 0.04
"""Distance [m] from a thing within which the surface is looked for around it."""
SURROUNDED, AT_WALL = 200.0, 90.0
"""Least angle [deg] about a thing in which the surface is seen; beside a wall it is 180°. And that
about a part of a wall's group that stands by itself: of a thing in a corner."""
UNDER = 0.15
"""Largest share of the surface's points below a thing's convex hull; a rim encloses most."""

OVER = 0.8
"""Least share of another group's points over the surface on which it stands."""


class RaisedSupport(NamedTuple):
    """A group of points with a wide level surface, divided.

    Attributes:
        part: i8 [N], 0 for the support, from 1 for each thing on it.
        height: Height of the level surface above the table [m].
        sides: [S, 3], the sides of its convex hull: a·x + b·y + c < 0 within.
    """

    part: NDArray[np.int64]
    height: float
    sides: Array

    def carries(self, points: Array, height: Array) -> bool:
        """Whether another group of points [K, 3], at these heights [K] above the table, stands on
        the surface."""
        over = within_hull(points[:, :2], self.sides).mean()
        return bool(over > OVER and np.median(height) > self.height)


def raised_support(points: Array, height: Array, camera: Array) -> RaisedSupport | None:
    """Divide a group of points into a support and the things on it; None without a wide level
    surface.

    Args:
        points: [N, 3], world, m, one a voxel.
        height: [N], heights above the table, m.
        camera: [3], position of the camera, m.
    """
    if horizontal_width(points) < NARROWEST:
        return None
    bins = np.floor(height / STEP).astype(np.int64) - int(np.floor(height.min() / STEP))
    counts = np.convolve(np.bincount(bins), np.ones(3), "same")
    level = float(np.median(height[np.abs(bins - int(counts.argmax())) <= 1]))
    surface = np.abs(height - level) < BAND
    if surface.mean() < SHARE or horizontal_width(points[surface]) < NARROWEST:
        return None
    hull = scipy.spatial.ConvexHull(points[surface, :2])
    cells = np.unique(np.floor(points[surface, :2] / CELL), axis=0)
    if len(cells) * CELL**2 < FILLED * hull.volume:  # in the plane its area
        return None
    sides = hull.equations
    part = np.zeros(len(points), dtype=np.int64)
    above = np.flatnonzero(height > level + BAND)
    if len(above) < FEWEST:
        return RaisedSupport(part, level, sides)
    group, sizes = clusters(points[above], GAP)
    for one in np.flatnonzero(sizes >= FEWEST):
        mine = above[group == one]
        if _is_thing(points[mine, :2], height[mine] - level, points[surface, :2], SURROUNDED):
            part[mine] = part.max() + 1
            continue
        # What stands at a wall of a bin is connected with it.
        own, _ = standing_parts(points[mine], height[mine] - level, camera)
        wall = int(np.bincount(own).argmax())
        for other in sorted(set(own.tolist()) - {wall}):
            thing = mine[own == other]
            if _is_thing(points[thing, :2], height[thing] - level, points[surface, :2], AT_WALL):
                part[thing] = part.max() + 1
    return RaisedSupport(part, level, sides)


def _is_thing(foot: Array, height: Array, surface: Array, around: float) -> bool:
    """Whether places [M, 2] of a surface lie around a thing at places [K, 2], not below it, and it
    rises above them.

    Args:
        foot, height: [K, 2], [K], the thing's places, and heights above the surface, m.
        surface: [M, 2].
        around: Least angle [deg] about the thing in which the surface is seen.
    """
    if np.percentile(height, 95) <= LOWEST:
        return False
    near = surface[scipy.spatial.cKDTree(foot).query(surface)[0] < AROUND]
    away = near - foot.mean(axis=0)
    sector = np.floor(np.rad2deg(np.arctan2(away[:, 1], away[:, 0])) / 10.0)
    if 10.0 * len(np.unique(sector)) < around:
        return False
    sides = scipy.spatial.ConvexHull(foot, qhull_options="QJ").equations  # of a sheet, too
    return bool(within_hull(surface, sides).mean() < UNDER)


def within_hull(places: Array, sides: Array) -> NDArray[np.bool_]:
    """Mask of the places [M, 2] within a convex hull of sides [S, 3]; see `RaisedSupport`."""
    return np.asarray((places @ sides[:, :2].T + sides[:, 2] < 0).all(axis=1))
