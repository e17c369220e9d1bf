"""Free, seen, unknown: the evidence of one depth image about the space around an object.

A depth image contains more than points. Each pixel has one of three states: a point of the *object*
was seen; something else was seen, so the ray is *free* up to it; or nothing returned, and the pixel
is *unknown*. Where a mask is known, a pixel of it without depth shows the object too, at an unknown
depth. The space behind an occluder in front of the object is unknown too: the ray is free
only up to the occluder.

`VisibilityImage` stores this as a coarse image of tangents around the object: for each cell whether
the object was seen, and the free depth of the ray. `ViewEvidence` adds the plane on which the
object stands. Both are computed alike for simulated views, depth images and clouds, so that
training and use agree.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from pointsdf_cli.geometry.arrays import Array, Mask

SIZE = 64
"""Cells along each side of a visibility image."""

WIDTH = 1.8
"""Side of the image over the object's largest extent in it: surface hidden at the silhouette's edge
still lies inside."""

REACH = 1.5
"""Largest distance, in cells or pixels, to the pixel whose evidence a cell takes over."""

BINS = 3
"""Bins along each side of a cell; of the pixels in a bin the one nearest to its centre is looked
at."""

PLANE_BAND = 0.006
"""Points nearer to the support plane than this [m] belong to it."""


class VisibilityImage(NamedTuple):
    """Three states of the rays around an object.

    Rows run along the camera's y axis, columns along x.

    Attributes:
        window: f8 [4], left, top, width and height of the image in tangents x/z, y/z.
        seen: bool [SIZE, SIZE], cells in which the object was seen; where `free` is 0, by a mask
            and without a depth.
        free: f4 [SIZE, SIZE], depth [m] along z up to which the ray holds nothing of the object;
            0 where nothing is known, inf where the whole ray is free.
    """

    window: Array
    seen: Mask
    free: NDArray[np.float32]


@dataclass(frozen=True)
class ViewEvidence:
    """Observed space around an object's points, camera frame (OpenCV axes), m.

    Attributes:
        visibility: None where only the object's points are known: all else is unknown then.
        support_plane: f8 [4], (unit normal n that points up, offset d): n·x = d on the plane that
            the object stands on; None where it is not known.
    """

    visibility: VisibilityImage | None = None
    support_plane: Array | None = None


def visibility_image(
    object_points: Array,
    other_points: Array,
    support_plane: Array | None = None,
    pitch: float | None = None,
    object_rays: Array | None = None,
) -> VisibilityImage:
    """The visibility around an object.

    Args:
        object_points: [N, 3], N ≥ 1, camera frame, m, z > 0.
        other_points: [M, 3], all other measured points: table, background, other objects, and
            pixels that may be the object's but were cut off; camera frame, m. Points outside of
            the image do not matter.
        support_plane: [4], as in `ViewEvidence`: rays that end on it hold nothing of the object.
        pitch: Distance of neighbouring pixels in tangents (1/f); estimated from the points if None.
        object_rays: [K, 2], tangents x/z, y/z of pixels that a mask gives to the object and that
            have no depth: the object was seen there, at an unknown depth. None for none.
    """
    tangents = object_points[:, :2] / object_points[:, 2:]
    low, high = tangents.min(axis=0), tangents.max(axis=0)
    side = WIDTH * max(float((high - low).max()), 1e-4)
    window = np.array([*((low + high - side) / 2.0), side, side])

    other_points = other_points[other_points[:, 2] > 0]
    others = other_points[:, :2] / other_points[:, 2:]
    near = _within(others, (low + high) / 2.0, 0.6 * side)
    other_points, others = other_points[near], others[near]
    rays = np.zeros((0, 2)) if object_rays is None else object_rays
    rays = rays[_within(rays, (low + high) / 2.0, 0.6 * side)]
    until = other_points[:, 2].copy()
    if support_plane is not None:
        until[other_points @ support_plane[:3] - support_plane[3] < PLANE_BAND] = np.inf

    if pitch is None:
        pitch = _pitch(np.concatenate([tangents, others]))
    cell = side / SIZE
    centres = (np.arange(SIZE) + 0.5) * cell
    x, y = np.meshgrid(window[0] + centres, window[1] + centres)
    every = np.concatenate([tangents, others, rays])
    some = _nearest_of_each_bin(every, cell / BINS)
    tree = scipy.spatial.cKDTree(every[some], compact_nodes=False, balanced_tree=False)
    away, nearest = tree.query(np.stack([x.ravel(), y.ravel()], axis=1))
    index = some[nearest]
    index[away > REACH * max(cell, pitch)] = -1
    measured = len(tangents) + len(others)
    seen = ((index >= 0) & (index < len(tangents))) | (index >= measured)
    # The last entry is that of cells that know nothing.
    depth = np.concatenate([object_points[:, 2], until, np.zeros(len(rays) + 1)])
    free = depth[index].astype(np.float32)
    return VisibilityImage(window, seen.reshape(SIZE, SIZE), free.reshape(SIZE, SIZE))


def _within(tangents: Array, middle: Array, reach: float) -> Mask:
    """Whether tangents [N, 2] lie in the square of half side `reach` about `middle` [2]."""
    away = np.abs(tangents - middle) < reach
    return np.asarray(away[:, 0] & away[:, 1])


def _nearest_of_each_bin(places: Array, side: float) -> NDArray[np.intp]:
    """Indices into `places` [N, 2] of the one nearest to the centre of each square bin.

    A dense image has tens of pixels in a cell, and one search tree of all of them costs more than
    everything else.
    """
    scaled = (places - places.min(axis=0)) / side
    bins = scaled.astype(np.int64)
    apart = scaled - bins - 0.5
    off = apart[:, 0] ** 2 + apart[:, 1] ** 2
    number = bins[:, 1] * (int(bins[:, 0].max()) + 1) + bins[:, 0]
    least = np.full(int(number.max()) + 1, np.inf)
    np.minimum.at(least, number, off)
    return np.flatnonzero(off == least[number])


def _pitch(tangents: Array) -> float:
    """Median distance of neighbouring points [N, 2]: the pixels' distance where none is missing."""
    if len(tangents) < 2:
        return 0.0
    some = tangents[:: max(1, len(tangents) // 500)]
    away, _ = scipy.spatial.cKDTree(tangents).query(some, k=2)
    return float(np.median(away[:, 1]))
