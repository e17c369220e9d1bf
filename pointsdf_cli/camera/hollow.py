"""Completion of bowls in a segmentation: near wall, far wall, and a floor as low as the table."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from pointsdf_cli.geometry.arrays import Array

Labels = NDArray[np.int64]


CELL = 0.0035
"""Width of the image's cells at the distance of the group [m]."""
EDGE = 5
"""Width of an island's border in cells: edges return no depth."""
OWN = 0.8
"""Least share of a floor's border on one bowl."""
BOTH = 0.9
"""Least share of the border on both walls of one bowl."""
EACH = 0.1
"""Least share of the border on each of the two walls."""
GAP = 0.03
"""Largest distance between the two walls [m]."""
WITHIN = 0.7
"""Least share of the floor within the walls, seen from above."""
FEWEST = 20
"""Least number of cells of a floor that joins two walls."""
WIDEST = 0.45
"""Largest width of a group [m]; wider ones are skipped."""
OPEN = -2
"""Index and group of a cell of open table."""


def whole_bowls(points: Array, group: Labels, flat: Array, camera: Array) -> tuple[Labels, Labels]:
    """Join the walls of a bowl and its floor.

    In the image, the floor of a bowl is an island of points at table height, between the far wall
    and the near rim; seen from above it is within the walls. The table seen through the handle of a
    mug is an island too, but lies outside the walls.

    Args:
        points: [N, 3], points above the table, world, m.
        group: [N], cluster of each, from 0.
        flat: [M, 3], points at table height, world, m.
        camera: [3], position of the camera, m.

    Returns:
        The group [N] of each point, with the walls of a bowl in one group, and the group [M] of
        each flat point: that of its bowl, or -1.
    """
    joined = group.copy()
    floor = np.full(len(flat), -1, dtype=np.int64)
    if not len(flat) or not len(points):
        return joined, floor
    sight, flat_sight = _tangents(points, flat, camera)
    for one in np.argsort(-np.bincount(group), kind="stable"):
        mine = joined == one
        if mine.sum() < 60 or np.ptp(points[mine, :2], axis=0).max() > WIDEST:
            continue
        size = CELL / float(np.linalg.norm(np.median(points[mine], axis=0) - camera))
        islands = _islands(sight, joined, flat_sight, int(one), size)
        for on_island, border in islands:
            _claim(points, joined, flat, floor, int(one), on_island, border)
    return joined, floor


def _claim(
    points: Array,
    joined: Labels,
    flat: Array,
    floor: Labels,
    one: int,
    on_island: Labels,
    border: Labels,
) -> None:
    """Assign an island (indices of flat points) to group `one`, and join its other wall if any.

    Args:
        points, joined, flat, floor: As in `whole_bowls`; `joined` and `floor` are changed.
        one: The group.
        on_island, border: As `_islands` returns them.
    """
    # An earlier island may have joined the groups of this one's border.
    groups, counts = np.unique(np.where(border < 0, OPEN, joined[border]), return_counts=True)
    share = dict(zip(groups.tolist(), (counts / len(border)).tolist(), strict=True))
    mine = share.pop(one, 0.0)
    if mine >= OWN:
        if _within(flat[on_island], points[joined == one]):
            floor[on_island] = one
        return
    other = max(share, key=lambda k: share[k], default=-1)
    if other < 0 or len(on_island) < FEWEST:
        return
    if min(mine, share[other]) < EACH or mine + share[other] < BOTH:
        return
    first, second = points[joined == one], points[joined == other]
    both = np.concatenate([first, second])
    if np.ptp(both[:, :2], axis=0).max() > WIDEST:
        return
    near = scipy.spatial.cKDTree(first).query(second, distance_upper_bound=GAP)[0].min() < GAP
    if near and _within(flat[on_island], both):
        joined[joined == other] = one
        floor[floor == other] = one
        floor[on_island] = one


def _tangents(points: Array, flat: Array, camera: Array) -> tuple[Array, Array]:
    """Positions of points [N, 3] and flat ones [M, 3] in an image centred on the points."""
    forward = np.median(points, axis=0) - camera
    forward /= np.linalg.norm(forward)
    side = np.cross(forward, [0.0, 0.0, 1.0])
    if np.linalg.norm(side) < 1e-3:
        side = np.array([1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    down = np.cross(forward, side)

    def seen(places: Array) -> Array:
        away = places - camera
        depth = np.maximum(away @ forward, 0.05)
        return np.stack([away @ side, away @ down], axis=1) / depth[:, None]

    return seen(points), seen(flat)


def _islands(
    sight: Array, group: Labels, flat_sight: Array, one: int, size: float
) -> list[tuple[Labels, Labels]]:
    """Islands of flat points in the window of a group.

    Returns:
        For each the indices of its flat points, and for the cells at its border the indices [B] of
        their points, `OPEN` for open table.
    """
    low = sight[group == one].min(axis=0) - 20 * size
    shape = np.ceil((sight[group == one].max(axis=0) - low) / size).astype(int) + 21
    if shape.prod() > 4_000_000:
        return []

    def cells(places: Array) -> tuple[Labels, tuple[Labels, Labels]]:
        at = np.floor((places - low) / size).astype(np.int64)
        ok = np.flatnonzero(((at >= 0) & (at < shape)).all(axis=1))
        return ok, (at[ok, 0], at[ok, 1])

    things = np.full(shape, -1, dtype=np.int64)
    ok, at = cells(sight)
    things[at] = ok
    ok, flat_at = cells(flat_sight)
    low_cells = np.zeros(shape, dtype=bool)
    low_cells[flat_at] = True
    square = np.ones((3, 3))
    low_cells &= things < 0
    # A rim has gaps without depth: gaps of up to four cells count as closed.
    wide_open = scipy.ndimage.convolve(low_cells.astype(np.int8), np.ones((5, 5), np.int8)) >= 20
    label, _ = scipy.ndimage.label(low_cells & wide_open, square)
    for _ in range(2):
        label = np.where(label > 0, label, scipy.ndimage.grey_dilation(label, (3, 3)) * low_cells)
    found = []
    for k, box in enumerate(scipy.ndimage.find_objects(label), 1):
        touches = any(s.start == 0 or s.stop == n for s, n in zip(box, shape, strict=True))
        if touches:
            continue
        wide = tuple(slice(max(0, s.start - EDGE), s.stop + EDGE) for s in box)
        island = label[wide] == k
        ring = scipy.ndimage.binary_dilation(island, square, EDGE) & ~island
        border = things[wide][ring]
        # Other flat cells beside it are open table, which does not lie in a bowl.
        beside_it = scipy.ndimage.binary_dilation(island, square, 2) & ~island
        open_ground = int((low_cells[wide][beside_it]).sum())
        border = np.concatenate([border[border >= 0], np.full(open_ground, OPEN)])
        if len(border):
            found.append((ok[label[flat_at] == k], border))
    return found


def _within(flat: Array, walls: Array) -> bool:
    """Whether most flat points [M, 3] are within the walls [N, 3], seen from above."""
    try:
        hull = scipy.spatial.ConvexHull(walls[:, :2])
        inside = scipy.spatial.Delaunay(walls[hull.vertices, :2]).find_simplex(flat[:, :2]) >= 0
    except scipy.spatial.QhullError:
        return False
    return bool(inside.mean() >= WITHIN)
