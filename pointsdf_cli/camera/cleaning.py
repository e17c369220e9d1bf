"""Detection of spurious points: flying pixels, outliers and specks.

A camera that matches patterns reports depths between an object and what is behind it, lone points,
and small detached groups of points. A network that centres and scales its input by all points is
misled by a single one of them.

Distances are taken in a space in which the camera samples evenly: pixel directions, and the
logarithm of depth compressed by `SLANT`, so that a steeply seen surface is still one surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array, Mask

SLANT = 4.0
"""Depth steps are divided by this: tan of the angle (76°) up to which sampling looks even."""

ENOUGH = 8000
"""Largest number of a group's points used to measure its distance to another."""


NEIGHBOURS = 4
"""A point is judged by the distance to this neighbour."""
ISOLATION = 4.0
"""A point is isolated if that distance exceeds this multiple of its median."""
PART_SHARE = 0.2
"""A detached group with at least this share of all points is a part of the object however far away
it is."""
PART_GAP = 0.4
"""A smaller group is a speck if it is farther from what is kept than this share of the object's
size."""
TINY_SHARE, TINY_GAP = 0.005, 0.015
"""Share of all points below which a group is tiny, and largest gap [m] at which it is kept."""


@dataclass(frozen=True)
class Cleaning:
    """Mask of the N points to keep, and counts of the others by cause.

    Attributes:
        kept: bool [N].
        flying: Points between a nearer and a farther surface.
        outliers: Points with no others near them.
        specks: Points of small detached groups.
    """

    kept: Mask
    flying: int = 0
    outliers: int = 0
    specks: int = 0

    @property
    def dropped(self) -> int:
        """The number of points that are not kept."""
        return self.flying + self.outliers + self.specks

    def report(self) -> str:
        """One sentence for the user; empty if everything was kept."""
        named = {"flying pixels": self.flying, "outliers": self.outliers, "in specks": self.specks}
        said = ", ".join(f"{count} {name}" for name, count in named.items() if count)
        return f"cleaning dropped {self.dropped} of {len(self.kept)} points: {said}" if said else ""


def clean(points: ArrayLike, specks: bool = True) -> Cleaning:
    """Find the spurious points of a cloud.

    Args:
        points: [N, 3], camera frame, m; finite. Where some lie behind the camera, the viewpoint
            is unknown and plain distances are used.
        specks: Also drop small detached groups. Only for a cloud of one object: in a scene they
            may be objects.

    Raises:
        InputError: Not [N, 3].
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"a cloud of shape {points.shape}", allowed="[N, 3]")
    if len(points) < 4 * NEIGHBOURS:
        return Cleaning(np.ones(len(points), dtype=bool))
    even, seen_from_camera = _evenly_sampled(points)
    tree = scipy.spatial.cKDTree(even, compact_nodes=False, balanced_tree=False)
    distance, neighbour = tree.query(even, k=NEIGHBOURS + 1)
    pitch = _typical(distance[:, -1])
    isolated = distance[:, -1] > ISOLATION * pitch
    kept = ~isolated
    flying = _count_flying(even, isolated, ISOLATION * pitch) if seen_from_camera else 0
    outliers = int(isolated.sum()) - flying
    dropped = np.zeros(len(points), dtype=bool)
    if specks:
        close = distance[:, 1:] <= ISOLATION * pitch
        dropped = _specks(points, neighbour[:, 1:], close, kept)
    return Cleaning(kept & ~dropped, flying, outliers, int(dropped.sum()))


def flying_pixels(depth: NDArray[np.floating], focal: float) -> Mask:
    """Pixels of a depth image that lie between a nearer and a farther surface.

    A pixel belongs to a surface if at least three of its eight neighbours continue it: their depth
    differs by no more than a surface seen at 83° does from pixel to pixel, plus noise.

    Args:
        depth: [height, width], m along z; 0 where nothing returned.
        focal: Focal length [px].

    Returns:
        bool [height, width], False where nothing returned, and everywhere in a sparse image.
    """
    z = np.pad(np.asarray(depth, dtype=np.float32), 1)
    middle = z[1:-1, 1:-1]
    # 0.2 % of the depth at 1 m is three deviations of a structured-light camera's noise.
    step = np.float32(8.0 / focal) * middle + np.float32(0.006) * middle**2
    count = np.zeros(middle.shape, dtype=np.uint8)
    height, width = middle.shape
    for down in range(3):
        for right in range(3):
            if (down, right) != (1, 1):
                beside = z[down : down + height, right : right + width]
                count += np.abs(beside - middle) <= step
    seen = middle > 0
    flying: Mask = seen & (count < 3)
    # Where hardly any pixel has neighbours the image is sparse, and that says nothing.
    return flying if 2 * flying.sum() < seen.sum() else np.zeros_like(flying)


def _evenly_sampled(points: Array) -> tuple[Array, bool]:
    """Points [N, 3] in the space where the camera samples evenly [m at the median depth]."""
    z = points[:, 2]
    if not (z > 0).all():
        return points, False
    middle = float(np.median(z))
    even = np.empty_like(points)
    even[:, :2] = points[:, :2] * (middle / z)[:, None]
    even[:, 2] = np.log(z / middle) * (middle / SLANT)
    return even, True


def _typical(distance: Array) -> float:
    """The median of the distances; of those above 0 where most points are repeated."""
    middle = float(np.median(distance))
    if middle > 0:
        return middle
    above = distance[distance > 0]
    return float(np.median(above)) if len(above) else np.inf


def _count_flying(even: Array, isolated: Mask, near: float) -> int:
    """Number of isolated points with kept neighbours in the image, which therefore jump in
    depth."""
    lone = even[isolated, :2]
    if not len(lone) or isolated.all():
        return 0
    image = scipy.spatial.cKDTree(even[~isolated, :2], compact_nodes=False, balanced_tree=False)
    return int((image.query(lone)[0] <= near).sum())


def _specks(points: Array, neighbour: NDArray[np.intp], close: Mask, kept: Mask) -> Mask:
    """Kept points in small groups that are detached from the largest group and its surroundings."""
    count = len(points)
    rows = np.repeat(np.arange(count), neighbour.shape[1])
    joined = close.ravel() & kept[rows] & kept[neighbour.ravel()]
    ends = rows[joined], neighbour.ravel()[joined]
    graph = scipy.sparse.coo_array((np.ones(len(ends[0]), dtype=np.int8), ends), (count, count))
    _, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    sizes = np.bincount(label, weights=kept).astype(np.int64)
    dropped = np.zeros(count, dtype=bool)
    if sizes.max() == kept.sum():
        return dropped
    body = label == sizes.argmax()
    extent = float(np.ptp(points[body], axis=0).max())
    total = int(kept.sum())
    # The largest first: a handle's far end may hang on its near end.
    order = np.argsort(-sizes, kind="stable")[1:]
    for one in order[sizes[order] >= TINY_SHARE * total]:
        group = kept & (label == one)
        far = _gap(points[body], points[group]) > PART_GAP * extent
        if far and sizes[one] < PART_SHARE * total:
            dropped |= group
        else:
            body |= group
    tiny = kept & ~body & ~dropped
    gaps = np.full(len(sizes), np.inf)
    distance, _ = scipy.spatial.cKDTree(_thinned(points[body])).query(points[tiny])
    np.minimum.at(gaps, label[tiny], distance)
    dropped |= tiny & (gaps[label] > TINY_GAP)
    # What falls apart so far is no one body with specks around it.
    return dropped if 2 * dropped.sum() < total else np.zeros(count, dtype=bool)


def _gap(points: Array, others: Array) -> float:
    """The least distance [m] between points [N, 3] and others [M, 3], to within their spacing when
    both are thinned."""
    return float(scipy.spatial.cKDTree(_thinned(points)).query(_thinned(others))[0].min())


def _thinned(points: Array) -> Array:
    """At most `ENOUGH` of the points [N, 3], evenly spread over their order: gaps of centimetres
    do not need every pixel."""
    count = len(points)
    return points if count <= ENOUGH else points[np.arange(ENOUGH) * count // ENOUGH]
