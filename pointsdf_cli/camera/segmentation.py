"""The table in a cloud, and groups of connected points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.planes import least_squares_plane, planes_through

PLANE_SEARCH = 0.04
"""Largest height [m] of the table's plane above or below z = 0."""
PLANE_TILT = 0.15
"""Largest tilt of the plane [rad]; poses calibrated by hand err by less."""
PLANE_SHARE = 0.4
"""Least share of the points near z = 0 on a plane that is a table."""
LEAST_REACH, LEAST_AREA = 0.3, 0.03
"""Least extent [m] of a table, and least area [m²] of its largest connected region: the foot of a
can has a tenth of that."""
AREA_CELL, AREA_GAP = 0.01, 0.05
"""Side of the cells [m] in which the area is counted, and gap [m] up to which they connect."""
PLANE_BAND = 0.006
"""Points nearer to the plane than this [m] belong to the table."""
GAP = 0.012
"""Largest gap between points of one object [m]."""
FEWEST = 50
"""Least number of points of an object."""


LARGEST = 100.0
"""Largest volume of a workspace [m³]: points are grouped in a grid that fills it."""


@dataclass(frozen=True)
class SegmentationConfig:
    """Workspace of the segmentation.

    Attributes:
        low, high: Corners of the workspace in the world [m]; the table top is near z = 0.
    """

    low: tuple[float, float, float] = (0.25, -0.6, -0.05)
    high: tuple[float, float, float] = (1.1, 0.6, 0.5)

    def __post_init__(self) -> None:
        corners = np.array([self.low, self.high])
        finite = corners.shape == (2, 3) and np.isfinite(corners).all()
        if not finite or (corners[0] >= corners[1]).any():
            what = f"a workspace from {self.low} to {self.high}"
            raise InputError(what, allowed="two corners of finite numbers [m], the lower one first")
        volume = float(np.prod(corners[1] - corners[0]))
        if volume > LARGEST:
            what = f"a workspace of {volume:.0f} m³"
            raise InputError(what, where="--workspace", allowed=f"at most {LARGEST:g} m³")


def find_table(points: Array, share: float = PLANE_SHARE, tilt: float = PLANE_TILT) -> Array | None:
    """The plane [4] through most points near z = 0; None if there is no such plane.

    Random sampling of triples, then two rounds of least squares. The seed is fixed: the same
    cloud gives the same plane.

    Args:
        points: [N, 3], world, m.
        share: Least share of the points near z = 0 on the plane.
        tilt: Largest tilt of the plane [rad].
    """
    # `compress` copies rows several times as fast as an index of booleans.
    near = np.compress(np.abs(points[:, 2]) < PLANE_SEARCH, points, axis=0)
    if len(near) < 100:
        return None
    rng = np.random.default_rng(0)
    sample = near[rng.choice(len(near), min(len(near), 1000), replace=False)]
    triples = sample[rng.integers(len(sample), size=(120, 3))]
    normals, through = planes_through(triples)
    normals *= np.where(normals[:, 2:] < 0, -1.0, 1.0)
    offsets = (normals * through).sum(axis=1)
    level = normals[:, 2] > np.cos(tilt)
    normals, offsets = normals[level], offsets[level]
    if not len(normals):
        return None
    distance = np.abs(sample @ normals.T - offsets)
    best = int((distance < PLANE_BAND).sum(axis=0).argmax())
    normal, offset = normals[best], float(offsets[best])
    for _ in range(2):
        on_plane = np.compress(np.abs(near @ normal - offset) < PLANE_BAND, near, axis=0)
        if len(on_plane) < 3:
            return None
        normal, centre = least_squares_plane(on_plane)
        normal = normal * np.sign(normal[2])
        offset = float(normal @ centre)
    fits = np.abs(near @ normal - offset) < PLANE_BAND
    if float(fits.mean()) < share or normal[2] < np.cos(tilt):
        return None
    # The top of a flat object can be a plane near z = 0 too, but a table reaches far. Where it
    # returns nothing, since it is black or shiny, the feet of objects lie on a plane.
    level = near[fits] * [1.0, 1.0, 0.0]
    if np.ptp(level, axis=0).max() < LEAST_REACH or _largest_area(level) < LEAST_AREA:
        return None
    return np.array([*normal, offset])


def _largest_area(level: Array) -> float:
    """Area [m²] of the largest connected region of points [N, 3] of a plane z = 0."""
    cells = np.unique(np.floor(level / AREA_CELL), axis=0)
    _, sizes = clusters(cells * AREA_CELL, AREA_GAP)
    return float(sizes.max()) * AREA_CELL**2


def clusters(points: Array, gap: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Label of each point and size of each cluster, by connected cells of a grid.

    Points up to `gap` [m] apart are joined, those farther than twice that are not.
    """
    low = points.min(axis=0)
    cells = np.floor((points - low) / gap).astype(np.int64)
    grid = np.zeros(cells.max(axis=0) + 1, dtype=bool)
    grid[tuple(cells.T)] = True
    labels, count = scipy.ndimage.label(grid, structure=np.ones((3, 3, 3)))
    label = labels[tuple(cells.T)] - 1
    return label, np.bincount(label, minlength=count)
