"""Hidden support of a reconstruction.

An object at rest has its centre of mass above its feet. A reconstruction that could not stand lacks
some of them, in the unseen space below it: the wheels of an aeroplane seen from above. So the hand
must keep out of that space. (Of 156 reconstructions in trials 8 could not stand, and 3 of the 6
early contacts were with these: docs/notebook.md, "What it stands on".)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from pointsdf_cli.camera.view import View
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.planning.grid import GridField
from pointsdf_cli.planning.target import ObjectField

FOOT = 0.012
"""Height above the table [m] below which parts of a reconstruction count as feet: their height is
uncertain."""

FINE = 0.004
"""Grid step [m] of a second search for feet if a coarser grid shows none: cups have thin bases."""

DIRECTIONS = 16
"""Feet are first looked for at the likeliest place in each of this many directions."""
BATCH = 512
"""Then they are looked for at this many places at a time, the likeliest first."""

SPACING = 0.008
"""Spacing of the occupied points below the shape [m]: no finger passes between them."""

BEHIND = 0.005
"""Least distance [m] between a seen point and a point that it hides."""


def unseen_support(shape: ObjectField, views: Sequence[View]) -> Array:
    """Points [M, 3] in unseen space below a shape that could not stand; none if it could."""
    solid = shape.kept.inside()
    if not len(solid) or stands(shape.field, shape.kept, solid, shape.low, shape.high):
        return np.zeros((0, 3))
    return hidden_below(solid, [(view.T_world_camera[:3, 3], view.in_world) for view in views])


def stands(field: Field, kept: GridField, solid: Array, low: Array, high: Array) -> bool:
    """Whether a body could stand on the table, z = 0: its centre is above its feet.

    Args:
        field: Signed distances, world, m.
        kept: The same on a grid; `field` is evaluated where its bounds do not tell.
        solid: [N, 3], points spread evenly over its inside, m.
        low, high: [3], a box around the body [m].
    """
    centre = solid[:, :2].mean(axis=0)
    if _above(solid[solid[:, 2] < FOOT, :2], centre):
        return True
    axes = [np.arange(low[k], high[k] + FINE, FINE) for k in (0, 1)]
    heights = np.arange(FINE / 2, FOOT, FINE)
    places = np.stack(np.meshgrid(*axes, heights, indexing="ij"), axis=-1).reshape(-1, 3)
    value, bound = kept.with_bound(places)
    if _above(places[value + bound < 0, :2], centre):
        return True
    unsure = value - bound < 0
    places, value = places[unsure], value[unsure]
    if not _above(places[:, :2], centre):
        return False
    places = places[np.argsort(value, kind="stable")]
    turn = np.arctan2(*(places[:, :2] - centre).T[::-1]) / (2 * np.pi)
    sector = np.floor(turn * DIRECTIONS).astype(np.int64)
    likely = places[np.unique(sector, return_index=True)[1]]
    batches = [likely, *(places[k : k + BATCH] for k in range(0, len(places), BATCH))]
    feet = likely[:0]
    for some in batches:
        feet = np.concatenate([feet, some[field(some) < 0]])
        if _above(feet[:, :2], centre):
            return True
    return False


def _above(feet: Array, centre: Array) -> bool:
    """Whether a centre [2] lies in the convex hull of feet [N, 2]."""
    if len(feet) < 3:
        return False
    try:
        return bool(scipy.spatial.Delaunay(feet).find_simplex(centre) >= 0)
    except scipy.spatial.QhullError:  # all on one line
        return False


def hidden_below(solid: Array, views: Sequence[tuple[Array, Array]]) -> Array:
    """Points [M, 3] between a body and the table that no view has seen to be free.

    Args:
        solid: [N, 3], points inside the body, world, m.
        views: Camera position [3] and observed object points [P, 3] of each view, world, m.
    """
    squares = np.floor(solid[:, :2] / SPACING).astype(np.int64)
    cells, column = np.unique(squares, axis=0, return_inverse=True)
    lowest = np.full(len(cells), np.inf)
    np.minimum.at(lowest, column.ravel(), solid[:, 2])
    heights = np.arange(SPACING / 2, max(float(lowest.max()), SPACING), SPACING)
    middle = np.repeat((cells + 0.5) * SPACING, len(heights), axis=0)
    places = np.column_stack([middle, np.tile(heights, len(cells))])
    places = places[places[:, 2] < np.repeat(lowest, len(heights))]
    for eye, seen in views:
        if len(places):
            places = places[_is_hidden(places, eye, seen)]
    return places


def _is_hidden(places: Array, eye: Array, seen: Array) -> NDArray[np.bool_]:
    """Mask of the points [M, 3] that lie behind a seen point [P, 3], in the same direction from the
    eye."""
    way, seen_way = places - eye, seen - eye
    distance, seen_distance = (np.linalg.norm(w, axis=1) for w in (way, seen_way))
    directions = scipy.spatial.KDTree(seen_way / seen_distance[:, None])
    # Points a spacing apart hide what is between them.
    off, nearest = directions.query(way / distance[:, None])
    same = off < SPACING / distance
    hidden: NDArray[np.bool_] = same & (distance > seen_distance[nearest] + BEHIND)
    return hidden
