"""Objects on the table: every point of a view assigned to one object, the table, or neither."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from pointsdf_cli.camera.concave_split import standing_parts
from pointsdf_cli.camera.hollow import whole_bowls
from pointsdf_cli.camera.raised_support import RaisedSupport, raised_support
from pointsdf_cli.camera.rim import joined_at_rims
from pointsdf_cli.camera.segmentation import (
    FEWEST,
    GAP,
    PLANE_BAND,
    SegmentationConfig,
    clusters,
    find_table,
)
from pointsdf_cli.camera.table_relief import table_relief
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.box import strictly_inside
from pointsdf_cli.geometry.voxels import thin

OUTSIDE, TABLE, LOOSE, BESIDE_MASK = -1, -2, -3, -6
"""Labels of points that belong to no object: outside the workspace, on or below the table, and in
groups too small for an object."""

VOXEL = 0.0025
"""Side of the voxels to which clouds are thinned [m]: finer than a depth camera's noise."""


THICKEST_BAND = 0.015
"""Largest thickness of the table's band [m]; from `PLANE_BAND` at 1 m it grows with
the square of the distance from the camera, as noise does."""
FLOATING = 0.03
"""Height [m] of its lowest point above which a part floats."""
BRIDGE = 0.05
"""Largest distance [m] from a floating part to the object that it is joined to: the camera did not
see their connection."""
BEYOND = 0.1
"""Objects that the workspace cuts are followed so far outside of it [m]: a hand's width."""
FLATTEST = 0.008
"""Least height of an object [m]; lower groups are unevenness of the table."""


@dataclass(frozen=True)
class TableObjects:
    """Objects on a table, unordered.

    Attributes:
        label: i8 [N], the object of each point, or OUTSIDE, TABLE, LOOSE, BESIDE_MASK.
        plane: [4], (unit normal, offset) of the table in the world; None if none was seen.
        unsplit: Objects that look like several in contact but could not be separated.
        cut: Objects that go on farther outside of the workspace than they are followed.
        raised: Height above the table [m] of what carries an object that stands on a tray, in a box
            or on a pedestal.
        supports: Height above the table [m] of the wide level surface of an object that has one,
            such as a tray; it may carry others.
    """

    label: NDArray[np.int64]
    plane: Array | None
    unsplit: frozenset[int] = frozenset()
    cut: frozenset[int] = frozenset()
    raised: Mapping[int, float] = field(default_factory=dict)
    supports: Mapping[int, float] = field(default_factory=dict)

    def plane_below(self, label: int) -> Array | None:
        """Plane [4], as `plane`, on which an object stands."""
        if self.plane is None or label not in self.raised:
            return self.plane
        return np.asarray(self.plane + [0.0, 0.0, 0.0, self.raised[label]])

    @property
    def count(self) -> int:
        """Number of objects."""
        return int(self.label.max(initial=-1)) + 1


def segment_table(
    points: Array, camera: Array, workspace: SegmentationConfig | None = None
) -> TableObjects:
    """Crop to the workspace, remove the table, and group the remaining points.

    Objects that the border of the workspace cuts go on outside of it, up to `BEYOND`.

    Args:
        points: [N, 3], world, m, one a voxel of a few millimetres; finite.
        camera: [3], position of the camera in the world, m.
        workspace: Corners of the workspace.
    """
    workspace = workspace or SegmentationConfig()
    label = np.full(len(points), OUTSIDE, dtype=np.int64)
    index = np.flatnonzero(strictly_inside(points, workspace.low, workspace.high))
    inside = points[index]
    plane = find_table(inside)
    if plane is None and len(index):  # a workspace may hold too little of the table
        plane = find_table(points)
    height, above = _over_table(inside, camera, plane)
    label[index[~above]] = TABLE
    low, index, height = index[~above], index[above], height[above]
    if not len(index):
        return TableObjects(label, plane)
    own, _ = clusters(points[index], GAP)
    bowls: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
    if plane is not None:
        own, floor = whole_bowls(points[index], own, points[low], camera)
        own = joined_at_rims(points[index], own, np.flatnonzero(np.bincount(own) >= FEWEST), camera)
        # From here on, floors take part in the grouping.
        is_floor = floor >= 0
        bowls = np.unique(floor[is_floor])
        index = np.concatenate([index, low[is_floor]])
        height = np.concatenate([height, points[low[is_floor]] @ plane[:3] - plane[3]])
        own = np.concatenate([own, floor[is_floor]])
        flat = _flat(height, own)
        label[index[flat]] = TABLE
        index, height, own = index[~flat], height[~flat], own[~flat]
        own = _bridged(points[index], height, own)
    big = np.flatnonzero(np.bincount(own) >= FEWEST)
    label[index] = LOOSE
    unsplit, supports, raised = set[int](), dict[int, RaisedSupport](), dict[int, float]()
    count = 0
    for one in big:
        mine = np.flatnonzero(own == one)
        parts, doubtful = np.zeros(len(mine), dtype=np.int64), frozenset[int]()
        if found := raised_support(points[index[mine]], height[mine], camera):
            supports[count], parts = found, found.part
            raised |= {count + k: found.height for k in range(1, int(parts.max()) + 1)}
        elif one not in bowls:  # the valley between a bowl's walls parts nothing
            parts, doubtful = standing_parts(points[index[mine]], height[mine], camera)
        label[index[mine]] = count + parts
        unsplit |= {count + part for part in doubtful}
        count += int(parts.max()) + 1
    for carrier, support in supports.items():
        for other in sorted(set(range(count)) - {carrier, *raised}):
            mine = np.flatnonzero(label[index] == other)
            if len(mine) and support.carries(points[index[mine]], height[mine]):
                raised[other] = support.height
    cut = _follow_outside(label, points, camera, plane, workspace)
    levels = {one: support.height for one, support in supports.items()}
    return TableObjects(label, plane, frozenset(unsplit), cut, raised, levels)


def _follow_outside(
    label: NDArray[np.int64],
    points: Array,
    camera: Array,
    plane: Array | None,
    workspace: SegmentationConfig,
) -> frozenset[int]:
    """Label, in place, points outside of the workspace on objects that its border cuts.

    Otherwise the rest of the object would be free space for the hand.

    Args:
        label: [N], as found within the workspace.
        points, camera, plane, workspace: As in `segment_table`; the plane may be None.

    Returns:
        The objects that go on beyond `BEYOND`.
    """
    low, high = np.array(workspace.low), np.array(workspace.high)
    deep = strictly_inside(points, low + GAP, high - GAP)
    base = np.flatnonzero((label >= 0) & ~deep)  # no others touch points outside
    wide, side = np.array([BEYOND] * 3), np.array([1.0, 1.0, 0.0])  # below is the table
    near = np.flatnonzero(strictly_inside(points, low - wide * side, high + wide))
    if not len(base) or not (label[near] == OUTSIDE).any():
        return frozenset()
    _, above = _over_table(points[near], camera, plane)
    index = near[above & (label[near] == OUTSIDE)]
    if not len(index):
        return frozenset()
    away, nearest = scipy.spatial.cKDTree(points[base]).query(points[index])
    group, counts = clusters(points[index], GAP)
    gap = np.full(len(counts), np.inf)
    np.minimum.at(gap, group, away)
    index, owner = index[gap[group] <= GAP], label[base[nearest[gap[group] <= GAP]]]
    label[index] = owner
    wide -= GAP
    past = ~strictly_inside(points[index], low - wide * side, high + wide)
    return frozenset(owner[past].tolist())


def _over_table(
    points: Array, camera: Array, plane: Array | None
) -> tuple[Array, NDArray[np.bool_]]:
    """Heights [N] of points above the measured table, and a mask of those that rise above it.

    Without a plane heights are z, and the mask holds all points.
    """
    if plane is None:
        return points[:, 2], np.ones(len(points), dtype=bool)
    distance = np.linalg.norm(points - camera, axis=1)
    band = np.clip(PLANE_BAND * distance**2, PLANE_BAND, THICKEST_BAND)
    height = points @ plane[:3] - plane[3]
    height = height - table_relief(points[:, :2], height, band)
    return height, height > band


def nearest_object(
    points: Array, camera: Array, place: Array
) -> tuple[NDArray[np.bool_], Array | None]:
    """Mask [N] of the object nearest to a place, and the table's plane.

    Args:
        points: [N, 3], a dense cloud, world, m; finite.
        camera: [3], position of the camera in the world, m.
        place: [3], world, m.

    Raises:
        InputError: Nothing stands on the table.
    """
    few = thin(points, VOXEL)
    found = segment_table(points[few.first], camera)
    of_object = found.label >= 0
    if not of_object.any():
        raise InputError("no object in the cloud", allowed="an object that stands on the table")
    away = np.linalg.norm(points[few.first] - place, axis=1)
    nearest = int(np.where(of_object, away, np.inf).argmin())
    return (found.label == found.label[nearest])[few.voxel], found.plane


def add_masked_object(mask: NDArray[np.bool_], found: TableObjects) -> TableObjects:
    """Add one more object: the points of a mask above the table.

    Raises:
        InputError: The mask covers nothing above the table.
    """
    label = found.label.copy()
    chosen = mask & ((label >= 0) | (label == LOOSE))
    if not chosen.any():
        raise InputError(
            f"the mask covers no points above the table ({int(mask.sum())} on it or elsewhere)",
            where="--mask",
            allowed="a mask of an object that stands on the table",
        )
    count = found.count
    label[chosen] = count
    # Objects that lost most of their points to the mask: what is left is the object's rim, whose
    # hull as an obstacle would hold the object itself.
    for one in range(count):
        before = found.label == one
        left = before & (label == one)
        if left.sum() < max(50, 0.2 * before.sum()):
            label[left] = BESIDE_MASK
    partly = {count} if found.cut & {int(one) for one in np.unique(found.label[mask])} else set()
    raised, mostly = dict(found.raised), int(np.bincount(found.label[chosen] + 3).argmax()) - 3
    if mostly in raised:
        raised[count] = raised[mostly]
    return replace(found, label=label, cut=found.cut | partly, raised=raised)


def _flat(height: Array, group: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Mask of the points [N] of groups no higher than the table's unevenness."""
    high = np.bincount(group, weights=height > FLATTEST)
    return high[group] < 0.02 * np.bincount(group)[group]


def _bridged(points: Array, height: Array, label: NDArray[np.int64]) -> NDArray[np.int64]:
    """Labels [N] with floating parts assigned to the nearest object, if it is near."""
    counts = np.bincount(label)
    lowest = np.full(len(counts), np.inf)
    np.minimum.at(lowest, label, height)
    few = FEWEST // 5
    floats = (lowest > FLOATING) & (counts >= few)
    standing = (lowest <= FLOATING) & (counts >= few)
    if not floats.any() or not standing.any():
        return label
    joined = label.copy()
    base = standing[label]
    tree, owner = scipy.spatial.cKDTree(points[base]), label[base]
    for one in np.flatnonzero(floats):
        distance, nearest = tree.query(points[label == one])
        if distance.min() <= BRIDGE:
            joined[label == one] = owner[nearest[distance.argmin()]]
    return joined
