"""Segmentation of one object in a cloud with a table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.box import strictly_inside

PLANE_SEARCH = 0.04
"""Largest height [m] of the table's plane above or below z = 0."""
PLANE_TILT = 0.15
"""Largest tilt of the plane [rad]; poses calibrated by hand err by less."""
PLANE_SHARE = 0.4
"""Least share of the points near z = 0 on a plane that is a table."""
PLANE_BAND = 0.006
"""Points nearer to the plane than this [m] belong to the table."""
GAP = 0.012
"""Largest gap between points of one object [m]."""
FEWEST = 50
"""Least number of points of an object."""


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
        if (
            corners.shape != (2, 3)
            or not np.isfinite(corners).all()
            or (corners[0] >= corners[1]).any()
        ):
            raise InputError(
                f"a workspace from {self.low} to {self.high}",
                allowed="two corners of finite numbers [m], the lower one first",
            )


@dataclass(frozen=True)
class Segmentation:
    """Segmentation of N points: a mask of the object, and masks of the others by reason.

    Attributes:
        kept: bool [N], the object.
        outside: bool [N], beyond the workspace, or not finite.
        table: bool [N], on or below the table's plane.
        other: bool [N], in the workspace and above the table, but not in the kept cluster.
        plane: [4], (unit normal, offset) of the table: n·x = offset; None if none was seen.
        clusters: Sizes of all clusters, the largest first.
    """

    kept: NDArray[np.bool_]
    outside: NDArray[np.bool_]
    table: NDArray[np.bool_]
    other: NDArray[np.bool_]
    plane: Array | None
    clusters: tuple[int, ...]

    def report(self) -> str:
        """One sentence for the user."""
        plane = "no table seen" if self.plane is None else f"{int(self.table.sum())} on the table"
        return (
            f"kept {int(self.kept.sum())} of {len(self.kept)} points as the object; dropped "
            f"{int(self.outside.sum())} outside the workspace, {plane}, {int(self.other.sum())} "
            f"in {max(0, len(self.clusters) - 1)} smaller clusters"
        )


def segment_object(
    points: ArrayLike,
    config: SegmentationConfig | None = None,
    target: ArrayLike | None = None,
) -> Segmentation:
    """Crop to the workspace, remove the table, keep the largest cluster.

    Only the points are used, so simulated and real clouds are treated alike.

    Args:
        points: [N, 3], world, m; rows that are not finite are dropped.
        config: Workspace.
        target: [3], a place in the world: the cluster nearest to it is kept instead of the
            largest.

    Raises:
        InputError: Nothing is left; the message says where the points went.
    """
    config = config or SegmentationConfig()
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"a cloud of shape {points.shape}", allowed="[N, 3]")
    inside = strictly_inside(points, config.low, config.high)
    kept = np.zeros(len(points), dtype=bool)
    table, other = kept.copy(), kept.copy()
    index = np.flatnonzero(inside)
    cropped = np.take(points, index, axis=0)
    plane = find_table(cropped)
    above = np.ones(len(index), dtype=bool)
    if plane is not None:
        above = cropped @ plane[:3] - plane[3] > PLANE_BAND
        table[index[~above]] = True
    candidates = index[above]
    sizes: tuple[int, ...] = ()
    if len(candidates):
        label, counts = clusters(points[candidates], GAP)
        order = np.argsort(-counts, kind="stable")
        sizes = tuple(int(counts[i]) for i in order)
        chosen = int(order[0])
        if target is not None:
            away = np.linalg.norm(points[candidates] - np.asarray(target, float), axis=1)
            big = counts[label] >= FEWEST
            if big.any():
                chosen = int(label[big][away[big].argmin()])
        kept[candidates[label == chosen]] = True
        other[candidates[label != chosen]] = True
    found = Segmentation(kept, ~inside, table, other, plane, sizes)
    if kept.sum() < FEWEST:
        raise InputError(
            f"no object in the cloud: {found.report()}",
            allowed=f"at least {FEWEST} points of an object above the table, between "
            f"{config.low} and {config.high} m in the world",
            hint="check the camera's pose (--camera-pose) and the cloud's unit",
        )
    return found


def find_table(points: Array, share: float = PLANE_SHARE) -> Array | None:
    """The plane [4] through most points near z = 0; None if there is no such plane.

    Random sampling of triples, then two rounds of least squares. The seed is fixed: the same
    cloud gives the same plane.

    Args:
        points: [N, 3], world, m.
        share: Least share of the points near z = 0 on the plane.
    """
    # `compress` copies rows several times as fast as an index of booleans.
    near = np.compress(np.abs(points[:, 2]) < PLANE_SEARCH, points, axis=0)
    if len(near) < 100:
        return None
    rng = np.random.default_rng(0)
    sample = near[rng.choice(len(near), min(len(near), 1000), replace=False)]
    triples = sample[rng.integers(len(sample), size=(120, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    length = np.linalg.norm(normals, axis=1)
    usable = length > 1e-6  # not in a line
    normals = normals[usable] / length[usable, None]
    normals *= np.where(normals[:, 2:] < 0, -1.0, 1.0)
    offsets = (normals * triples[usable, 0]).sum(axis=1)
    level = normals[:, 2] > np.cos(PLANE_TILT)
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
        centre = on_plane.mean(axis=0)
        away = on_plane - centre
        _, axes = np.linalg.eigh(away.T @ away)
        normal = axes[:, 0] * np.sign(axes[2, 0])
        offset = float(normal @ centre)
    fits = np.abs(near @ normal - offset) < PLANE_BAND
    if float(fits.mean()) < share or normal[2] < np.cos(PLANE_TILT):
        return None
    # The top of a flat object can be a plane near z = 0 too, but a table reaches far.
    if max(np.ptp(near[fits, axis]) for axis in (0, 1)) < 0.3:
        return None
    return np.array([*normal, offset])


def clusters(points: Array, gap: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Label of each point and size of each cluster, by connected cells of a grid."""
    low = points.min(axis=0)
    cells = np.floor((points - low) / gap).astype(np.int64)
    grid = np.zeros(cells.max(axis=0) + 1, dtype=bool)
    grid[tuple(cells.T)] = True
    labels, count = scipy.ndimage.label(grid, structure=np.ones((3, 3, 3)))
    label = labels[tuple(cells.T)] - 1
    return label, np.bincount(label, minlength=count)
