"""Separation of touching objects at concave edges."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from pointsdf_cli.camera.rim import joined_at_rims
from pointsdf_cli.geometry.arrays import Array

RADIUS = 0.012
"""Radius of the neighbourhood in which concavity is measured [m]."""
DEPTH = 0.0002
"""Least mean height [m] of a point's neighbours above its tangent plane at a concave edge, smoothed
over the neighbours: about 1 mm where two boxes touch. Noise exceeds it too, so the size and the
foot of the parts decide."""
BORDER = 0.004
"""Width of the strip along a concave edge that belongs to neither part at first [m]: noise leaves
gaps in the edge."""
GAP = 0.0045
"""Largest gap between points of one part [m]."""
SHARE, ENOUGH = 0.12, 1000
"""Least share of the points in a part; and the number of points that are enough, as of a bottle at
the wall of a large box."""
FOOT = 0.025
"""Largest height of the lowest point of a part that stands by itself [m]."""
RISE = 0.03
"""Least height of its highest point [m]."""
BASE = 0.025
"""Its least width in both horizontal directions [m]."""
MOST = 60_000
"""Largest number of points; larger clouds are not split."""


def standing_parts(
    points: Array, height: Array, camera: Array
) -> tuple[NDArray[np.int64], frozenset[int]]:
    """Split a group of points at concave edges into parts that stand by themselves.

    Surfaces that meet at a concave edge usually belong to two objects (Stein et al. 2014, "Object
    partitioning using local convexity"). A handle also meets its mug so, but does not stand by
    itself.

    Args:
        points: [N, 3], world, m, one a voxel.
        height: [N], heights above the table, m.
        camera: [3], position of the camera, m.

    Returns:
        The part [N] of each point, from 0, and the parts into which another large part was merged
        because it does not stand by itself.
    """
    whole = np.zeros(len(points), dtype=np.int64)
    if not 200 <= len(points) <= MOST:
        return whole, frozenset()
    tree = scipy.spatial.cKDTree(points)
    concave = _valley(points, camera, tree)
    if not concave.any():
        return whole, frozenset()
    smooth = np.flatnonzero(scipy.spatial.cKDTree(points[concave]).query(points)[0] > BORDER)
    if len(smooth) < 100:
        return whole, frozenset()
    pairs = scipy.spatial.cKDTree(points[smooth]).query_pairs(GAP, output_type="ndarray")
    shape = (len(smooth), len(smooth))
    graph = scipy.sparse.coo_array((np.ones(len(pairs), dtype=np.int8), tuple(pairs.T)), shape)
    _, smooth_label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    _, nearest = scipy.spatial.cKDTree(points[smooth]).query(points)
    label = smooth_label[nearest]
    sizes = np.bincount(label)
    large = np.flatnonzero(sizes >= np.clip(SHARE * len(points), 60, ENOUGH))
    label = joined_at_rims(points, label, large, camera)
    large = np.intersect1d(large, label)
    if len(large) < 2:
        return whole, frozenset()
    standing = [one for one in large if _stands(points[label == one], height[label == one])]
    if len(standing) < 2:
        return whole, frozenset({0})
    chosen = np.isin(label, standing)
    _, nearest = scipy.spatial.cKDTree(points[chosen]).query(points)
    part = np.searchsorted(standing, label[chosen][nearest])
    # What does not stand by itself goes as a whole with the part that most of it is nearest to.
    votes = np.zeros((len(sizes), len(standing)), dtype=np.int64)
    np.add.at(votes, (label, part), 1)
    owner = votes.argmax(axis=1)
    return owner[label], frozenset(int(owner[one]) for one in large if one not in standing)


def _valley(points: Array, camera: Array, tree: scipy.spatial.cKDTree) -> NDArray[np.bool_]:
    """Points [N] whose neighbours lie above the tangent plane."""
    distance, neighbour = tree.query(points, k=48, distance_upper_bound=RADIUS)
    found = np.isfinite(distance)
    count = found.sum(axis=1)
    starts = np.concatenate([[0], np.cumsum(count)])
    weights, shape = np.repeat(1.0 / count, count), (len(points), len(points))
    mean_of = scipy.sparse.csr_array((weights, neighbour[found], starts), shape)
    local = points - points.mean(axis=0)  # squares of large coordinates would cancel
    squares = (local[:, :, None] * local[:, None]).reshape(-1, 9)
    centre, moments = np.split(mean_of @ np.hstack([local, squares]), [3], axis=1)
    spread = moments.reshape(-1, 3, 3) - centre[:, :, None] * centre[:, None]
    normal = np.linalg.eigh(spread)[1][:, :, 0]
    normal = normal * np.where(((camera - points) * normal).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    # The centre of the neighbours is above a valley's bottom and below a ridge's top.
    rise = ((centre - local) * normal).sum(axis=1)
    # Smoothed over the neighbours, so that noise does not separate surfaces.
    mean = mean_of @ rise
    return (mean > DEPTH) & (count >= 8)


def _stands(points: Array, height: Array) -> bool:
    """Whether a part [N, 3] would stand on the table without the others."""
    level = points[:, :2] - points[:, :2].mean(axis=0)
    _, axes = np.linalg.eigh(level.T @ level)
    width = np.ptp(level @ axes, axis=0).min()
    low, high = np.percentile(height, [1, 99])
    return bool(low < FOOT and high > RISE and width > BASE)
