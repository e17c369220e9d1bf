"""Detection of the table's plane in a view without a camera pose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.camera.segmentation import clusters
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.planes import least_squares_plane, planes_through

SAMPLE = 30_000
"""Number of points used."""
PLANES = 6
"""Number of candidates, the largest first."""
ITERATIONS = 400
"""Random triples for each."""
SCORED = 10_000
"""Number of points among which those near each candidate are counted."""
BAND = 0.008
"""Points nearer to a plane than this [m] at 1 m from the camera lie on it; it grows with the square
of the distance, as depth noise does."""
LEAST_SHARE = 0.02
"""Least share of the points on a candidate."""
CAMERA_HEIGHT = 0.1
"""Least height of the camera above the table [m]."""
ROLL = 1.75
"""Usual largest angle between the table's normal and the image's upward direction [rad]; beyond it
the camera is mounted upside down."""
OVERHEAD = 0.25
"""Weight of a candidate that only a camera mounted upside down would stand above: ceilings look so,
too."""
TALLEST = 0.45
"""Largest height of objects on the table [m]."""
FLATNESS = 0.5
"""Least ratio of the points within one band to those within three."""
CELL = 0.03
"""Size of the cells whose connected region is the table [m]."""


def find_support_plane(points: Array) -> Array:
    """The plane [4] on which objects stand, (unit normal, offset): n·x = offset, camera frame.

    Candidates are found one after another by RANSAC (Fischler and Bolles 1981), in NumPy: to load
    Open3D for it would take longer than the search. Unlike floors and walls, a table is seen from
    above and has objects near the middle of the image on it; its size does not matter.

    Args:
        points: [N, 3], camera frame, m, one for each measured pixel.

    Returns:
        The normal points from the table to the camera's side.

    Raises:
        InputError: No plane is seen from above.
    """
    rng = np.random.default_rng(0)
    taken = rng.permutation(len(points))[:SAMPLE]
    sample = points[np.sort(taken)]
    best, plane = 0.0, None
    rest = sample
    for _ in range(PLANES):
        if len(rest) < max(50.0, LEAST_SHARE * len(sample)):
            break
        found, _ = largest_plane(rest)
        on_plane = np.abs(rest @ found[:3] - found[3]) < band_at(rest)
        if on_plane.sum() < LEAST_SHARE * len(sample):
            break
        if -found[3] > CAMERA_HEIGHT:
            found, score = _stood_on(found, sample)
            score *= _upright(found)
            if score > best:
                best, plane = score, found
        rest = rest[~on_plane]
    if plane is None:
        raise InputError(
            "no table: the camera looks down on no plane",
            allowed="a table-top view",
            hint="give the camera's pose: --camera-pose X,Y,Z,QW,QX,QY,QZ",
        )
    return plane


def pose_over_plane(plane: Array) -> Array:
    """T_world_camera [4, 4] with z = 0 on a plane [4] and the camera over x = y = 0.

    The camera looks along −x, like one opposite a robot at the origin.
    """
    up = plane[:3]
    # The viewing direction along the table; for a view straight down, the image's upward direction.
    forward = np.array([0.0, 0.0, 1.0]) - up[2] * up
    if np.linalg.norm(forward) < 0.1:
        forward = np.array([0.0, -1.0, 0.0]) + up[1] * up
    x = -forward / np.linalg.norm(forward)
    rotation = np.stack([x, np.cross(up, x), up])
    T_world_camera = np.eye(4)
    T_world_camera[:3, :3] = rotation
    T_world_camera[2, 3] = -float(plane[3])
    return T_world_camera


def band_at(points: Array) -> Array:
    """Half the thickness [N] [m] of a plane at points [N, 3], camera frame."""
    return BAND * np.clip(points[:, 2] ** 2, 0.6, 6.0)


def largest_plane(points: Array) -> tuple[Array, NDArray[np.bool_]]:
    """The plane [4] through most points [N, 3], m, in any frame, and a mask [N] of those within
    `BAND` of it. Its normal points towards the origin: the camera, in its own frame."""
    rng = np.random.default_rng(0)
    normals, through = planes_through(points[rng.integers(len(points), size=(ITERATIONS, 3))])
    if not len(normals):  # all points lie in a line: any plane through it
        normals, through = (row[None] for row in least_squares_plane(points))
    offsets = (normals * through).sum(axis=1)
    few = points[:: 1 + len(points) // SCORED].astype(np.float32)
    away = np.abs(few @ normals.T.astype(np.float32) - offsets.astype(np.float32))
    best = int(np.count_nonzero(away < BAND, axis=0).argmax())
    plane = _fitted(points[np.abs(points @ normals[best] - offsets[best]) < BAND])
    return plane, np.abs(points @ plane[:3] - plane[3]) < BAND


def _upright(plane: Array) -> float:
    """Weight of a plane by the angle between its normal and the image's upward direction."""
    upward = float(plane[:3] @ [0.0, -1.0, 0.0])
    return 1.0 if upward > np.cos(ROLL) else OVERHEAD


def _stood_on(plane: Array, sample: Array) -> tuple[Array, float]:
    """The plane [4], fitted to its nearest region, and its score as a table.

    The score is the product of the points on the table and those of objects that touch it, both
    weighted towards the middle of the image. Objects count no more than the table itself: otherwise
    a box's side with the table "standing" on it would win. A bare table has a small score.
    """
    for _ in range(3):
        height = sample @ plane[:3] - plane[3]
        flat = np.abs(height) < band_at(sample)
        if flat.sum() < 50:
            return plane, 0.0
        plane = _fitted(sample[flat])
    height = sample @ plane[:3] - plane[3]
    flat = np.abs(height) < band_at(sample)
    about = np.abs(height) < 3 * band_at(sample)
    if flat.sum() < FLATNESS * about.sum():
        return plane, 0.0
    level = (pose_over_plane(plane)[:3, :3] @ sample.T).T[:, :2]
    region = _main_region(level, flat, CELL)
    if region is None:
        return plane, 0.0
    above = (height > 1.5 * band_at(sample)) & (height < TALLEST) & region(level)
    table = float(_centrality(sample[flat]).sum())
    things = 0.001 * table
    if above.sum() >= 20:
        label, counts = clusters(sample[above], 0.03)
        lowest = np.full(len(counts), np.inf)
        np.minimum.at(lowest, label, height[above])
        stands = lowest < 0.03 + BAND
        things += float(_centrality(sample[above])[stands[label]].sum())
    return plane, table * min(things, table)


def _fitted(points: Array) -> Array:
    """The least-squares plane [4] of points [N, 3], its normal towards the camera."""
    normal, centre = least_squares_plane(points)
    normal = normal * (-1.0 if normal @ centre > 0 else 1.0)
    return np.array([*normal, float(normal @ centre)])


def _main_region(level: Array, flat: NDArray[np.bool_], cell: float):  # type: ignore[no-untyped-def]
    """Mask of the places [N, 2] on or next to the largest connected region of flat points."""
    from scipy import ndimage

    low = level[flat].min(axis=0)
    cells = np.floor((level[flat] - low) / cell).astype(np.int64)
    shape = cells.max(axis=0) + 3
    if shape.prod() > 10_000_000:
        return None
    grid = np.zeros(shape, dtype=np.int64)
    np.add.at(grid, tuple(cells.T + 1), 1)
    label, _ = ndimage.label(ndimage.binary_dilation(grid > 0))
    weight = np.bincount(label.ravel(), weights=grid.ravel())
    weight[0] = 0
    # Fill the parts of the table that objects hide.
    largest = label == weight.argmax()
    main = ndimage.binary_fill_holes(ndimage.binary_closing(largest, iterations=3) | largest)

    def inside(places: Array) -> NDArray[np.bool_]:
        at = np.floor((places - low) / cell).astype(np.int64) + 1
        ok = (at >= 0).all(axis=1) & (at < shape).all(axis=1)
        found = np.zeros(len(places), dtype=bool)
        found[ok] = main[tuple(at[ok].T)]
        return found

    return inside


def _centrality(points: Array) -> Array:
    """1 on the optical axis to 0 far from it, for points [N, 3] of the camera frame."""
    angle = np.linalg.norm(points[:, :2] / points[:, 2:], axis=1)
    return np.exp(-((angle / 0.3) ** 2))
