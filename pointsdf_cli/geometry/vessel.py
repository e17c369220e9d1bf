"""Cups, bowls and mugs: a thin wall of revolution, completed from the two sides that are seen.

A network's field is least certain where a wall is thinner than the error of its distances: walls
vanish there. But a camera that looks into a vessel of revolution sees the near outside and the far
inside, which together are the whole wall. So the axis is fitted (`axis_fit.py`), the wall's outline
is read off (`vessel_outline.py`), and turned about the axis (`body_of_revolution.py`). Parts that
are not of revolution, such as handles, are left to the network: `others` are their seen points.

Only clouds that show the inside of a surface of revolution are completed so; every other cloud
raises `NoVesselError`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from pointsdf_cli.geometry.arrays import Array, Mask
from pointsdf_cli.geometry.axis_fit import (
    NEAR,
    AxisFit,
    OrientedPoints,
    Turned,
    axis_point,
    neighbours_apart,
    normal_directions,
    oriented_points,
    refined_axis,
    turned,
)
from pointsdf_cli.geometry.body_of_revolution import BodyOfRevolution
from pointsdf_cli.geometry.cloud_sampling import systematic_sample
from pointsdf_cli.geometry.vessel_outline import NoVesselError, Outline, Section, wall_outline
from pointsdf_cli.geometry.visibility import PLANE_BAND

SAMPLE = 3000
"""Number of points used."""
FEWEST, SMALLEST = 100, 0.005
"""Least number of points, and least extent [m] of a cloud that is looked at."""
ROUGH, DOUBT = 750, 0.1
"""Number of points with which the axis is searched, and the share by which the limits of agreeing
points are relaxed for it."""
UPRIGHT = 2.0
"""Preference for an axis along the support plane's normal, as a ratio of residuals."""
BRIEF = 3
"""Number of rounds of pairing for every start of the axis."""
CLOSE = 1.3
"""Starts are refined further if their cost is then at most this many times the best one's."""
FACING = 0.25
"""Least component of a wall's normal towards or away from the axis."""
FEWEST_INSIDE = 0.02
"""Least share of points on the inside."""
AZIMUTHS = 60.0
"""Least angle [deg] about the axis in which the inside is seen."""
MOST_OUTSIDE = 240.0
"""Largest angle [deg] in which the outside can be seen where the inside is seen too."""
CONSISTENT, CONTRADICTING = 0.7, 0.06
"""Least share of points that lie on the outline of other azimuths, and largest share off it."""
ON_WALL = 0.9
"""Least share on the completed wall, among the points that do not lie beyond the wall."""
NEAR_WALL = 0.05
"""Largest distance of points on the wall, over the vessel's radius."""
MOST_OTHERS = 0.3
"""Largest share of points beyond the wall."""
NOISIEST = 0.06
"""Largest deviation of the points from planes, over the vessel's radius. Beyond it normals point
anywhere: 200 noisy points of a brick became a ring."""
FLOOR_SEEN = 0.6
"""Least share of a floor's visible places at which points were measured; else it has a hole."""
CLEAR = 0.001
"""Distance [m] of places in the cavity from the wall."""
FEWEST_OTHERS = 10
"""Fewer points beyond the wall are noise."""


@dataclass(frozen=True)
class Vessel:
    """A vessel of revolution.

    Attributes:
        wall: Wall and floor.
        filled: The same with its cavity filled up to the rim.
        others: [M, 3], seen points outside of `filled`: handles, lids, spoons; m.
        thickness: Thickness of the wall [m].
    """

    wall: BodyOfRevolution
    filled: BodyOfRevolution
    others: Array
    thickness: float

    def moved(self, rotation: Array, translation: Array) -> Vessel:
        """The vessel in another frame: rotation [3, 3], then translation [3]."""
        return replace(
            self,
            wall=self.wall.moved(rotation, translation),
            filled=self.filled.moved(rotation, translation),
            others=self.others @ rotation.T + translation,
        )

    def cavity(self, count: int = 250) -> Array:
        """Places [K, 3] within the cavity, a millimetre or more from the wall and the opening."""
        heights = self.filled.outline[:, 1]
        low, high = heights.min(), heights.max()
        away, turn, up = np.random.default_rng(0).random((3, 8 * count))
        radius = self.filled.radius * np.sqrt(away)
        places = self.wall.at(radius, low + (high - low) * up, 2 * np.pi * turn)
        outside = self.wall.exact_sdf(places) > CLEAR
        inside = outside & (self.filled.exact_sdf(places) < -CLEAR)
        return places[inside][:count]


def fit_vessel(points: Array, support_plane: Array | None = None) -> Vessel:
    """Complete a partial cloud of a vessel of revolution.

    Args:
        points: [N, 3], camera frame, m.
        support_plane: [4], unit normal n upwards and offset d: n·x = d on the plane it stands on.

    Raises:
        NoVesselError: The points do not show one, or not enough of its inside.
    """
    if len(points) < FEWEST or np.ptp(points, axis=0).max() < SMALLEST:
        raise NoVesselError("too few points, or all in one place")
    rng = np.random.default_rng(0)
    rays = points[:, :2] / np.maximum(points[:, 2:], 1e-9)
    few = points[systematic_sample(rays, SAMPLE, rng)] if len(points) > SAMPLE else points
    seen = oriented_points(few)
    tolerance, size = max(3 * seen.noise, 0.0012), float(np.ptp(few, axis=0).max())
    # Most objects are no vessels: fewer points show that in a quarter of the time.
    step = max(1, round(len(few) / ROUGH))
    some = OrientedPoints(seen.points[::step], seen.normals[::step], seen.noise)
    rough, upright = _best_axis(some, support_plane)
    _agreeing(turned(some, rough.direction, rough.point), tolerance, size, DOUBT)
    fit = refined_axis(seen, rough.direction, rough.point, upright)
    if fit is None:
        raise NoVesselError("no inside is seen")
    around = turned(seen, fit.direction, fit.point)
    agree = _agreeing(around, tolerance, size)
    # The points themselves: means over neighbours lie nearer to the axis than a curved wall.
    raw = turned(seen._replace(points=few), fit.direction, fit.point)
    section = Section(
        raw.radius,
        raw.height,
        agree & (around.outward < -FACING),
        agree & (around.outward > FACING),
        agree & (around.upward > 0.7),
        agree,
    )
    _check_sides(section, around)
    base = _base_height(fit, support_plane)
    outline = wall_outline(section, base)
    wall = BodyOfRevolution.of(fit.direction, fit.point, outline.wall)
    filled = BodyOfRevolution.of(fit.direction, fit.point, outline.filled)
    if seen.noise > NOISIEST * wall.radius:
        raise NoVesselError("the points are too noisy for its size")
    _check_floor(few, wall, outline, base is not None)
    beyond = filled.exact_sdf(few) > max(0.006, 3 * tolerance)
    near = max(0.002, 2 * tolerance, NEAR_WALL * wall.radius)
    on_wall = np.abs(wall.exact_sdf(few)) < near
    if beyond.mean() > MOST_OTHERS or on_wall[~beyond].mean() < ON_WALL:
        raise NoVesselError("the wall misses points")
    others = few[beyond] if beyond.sum() >= FEWEST_OTHERS else few[:0]
    return Vessel(wall, filled, others, outline.thickness)


def _best_axis(seen: OrientedPoints, support_plane: Array | None) -> tuple[AxisFit, bool]:
    """The axis with the least residual for its pairs, and whether it is the support plane's normal,
    kept as it is; others start from the directions that normals meet."""
    starts = [(each, False) for each in normal_directions(seen)[:2]]
    if support_plane is not None:
        starts.append((support_plane[:3], True))
    fits = []
    for direction, upright in starts:
        point = axis_point(seen, direction)
        # A convex body has no normal towards its axis, so it is rejected here at little cost.
        if point is None:
            continue
        inside = turned(seen, direction, point).outward < -FACING
        if inside.mean() >= FEWEST_INSIDE:
            fits.append((refined_axis(seen, direction, point, upright, BRIEF), upright))
    least = min((_cost(*each) for each in fits), default=np.inf)
    close = [(fit, up) for fit, up in fits if fit and _cost(fit, up) <= CLOSE * least]
    fits = [(refined_axis(seen, fit.direction, fit.point, up, BRIEF), up) for fit, up in close]
    best, upright = min(fits, key=lambda each: _cost(*each), default=(None, False))
    if best is None:
        raise NoVesselError("no inside is seen")
    return best, upright


def _cost(fit: AxisFit | None, upright: bool) -> float:
    """Residual of the pairs [m], larger the fewer there are."""
    if fit is None:
        return np.inf
    # Errors of depth tilt an axis that is free to.
    return fit.residual / max(fit.paired, 0.05) / (UPRIGHT if upright else 1.0)


def _agreeing(around: Turned, tolerance: float, size: float, doubt: float = 0.0) -> Mask:
    """Mask [N] of points near which points of other azimuths lie on the same outline.

    Args:
        around: The points about the axis.
        tolerance: Largest distance from that outline [m].
        size: Largest extent of the points [m].
        doubt: Share by which the limits are relaxed.

    Raises:
        NoVesselError: Too few agree, or too many contradict.
    """
    places = np.stack([around.radius, around.height], axis=1)
    distance, index, apart = neighbours_apart(around, places)
    cosine = around.outward[index] * around.outward[:, None]
    alike = cosine + around.upward[index] * around.upward[:, None] > 0.5
    used = apart & alike & (distance < NEAR * size)
    gap = around.outward[:, None] * (around.radius[index] - around.radius[:, None])
    gap = gap + around.upward[:, None] * (around.height[index] - around.height[:, None])
    paired = used.any(axis=1)
    masked = np.sort(np.where(used, np.abs(gap), np.inf), axis=1)
    middle = masked[np.arange(len(masked)), (used.sum(axis=1) - 1).clip(min=0) // 2]
    agree = paired & (middle < tolerance)
    if agree.mean() < CONSISTENT - doubt:
        raise NoVesselError("few points agree with an axis of revolution")
    if (paired & ~agree).mean() > CONTRADICTING + doubt:
        raise NoVesselError("points contradict an axis of revolution")
    return np.asarray(agree)


def _check_sides(section: Section, around: Turned) -> None:
    """Require that the inside is seen, and the outside from one side only."""
    if section.inside.mean() < FEWEST_INSIDE or section.inside.sum() < 40:
        raise NoVesselError("little of an inside is seen")
    if _seen_angle(around.azimuth[section.inside]) < AZIMUTHS:
        raise NoVesselError("the inside is seen in a narrow sector")
    if _seen_angle(around.azimuth[section.outside]) > MOST_OUTSIDE:
        raise NoVesselError("the outside is seen all around")


def _seen_angle(azimuth: Array) -> float:
    """Angle [deg] in which there are points, in sectors of 10°."""
    return 10.0 * len(np.unique(np.floor(np.rad2deg(azimuth) / 10.0)))


def _base_height(fit: AxisFit, support_plane: Array | None) -> float | None:
    """Height of the support plane on the axis [m]; None if the axis is not upright on it."""
    if support_plane is None or fit.direction @ support_plane[:3] < 0.97:
        return None
    gap = support_plane[3] - fit.point @ support_plane[:3]
    return float(gap / (fit.direction @ support_plane[:3]))


def _check_floor(points: Array, wall: BodyOfRevolution, outline: Outline, standing: bool) -> None:
    """Require that the floor was measured where the camera looks at it: else there is a hole."""
    # Points of a thinner floor count as the table's.
    if standing and outline.thickness < PLANE_BAND:
        return
    turns = 2 * np.pi * np.arange(24) / 24
    inner = outline.cavity[outline.cavity[:, 0] < 0.6 * outline.cavity[:, 0].max()]
    middle = inner[0] * [[0.3, 1.0], [0.6, 1.0]]
    places = np.concatenate([inner[::3], middle])
    floor = wall.at(places[:, :1], places[:, 1:], turns).reshape(-1, 3)
    # Such a place is seen, from the origin, through the opening.
    rim = outline.cavity[-1]
    low, high = (floor - wall.point) @ wall.direction, -wall.point @ wall.direction
    if high <= rim[1]:
        return
    crossing = floor * (1.0 - (rim[1] - low) / (high - low))[:, None]
    crossing -= wall.point + rim[1] * wall.direction
    free = np.linalg.norm(crossing, axis=1) < rim[0]
    if free.sum() < 10:
        return
    found = cKDTree(points).query(floor[free])[0] < max(0.004, 0.1 * wall.radius)
    if found.mean() < FLOOR_SEEN:
        raise NoVesselError("the floor has a hole")
