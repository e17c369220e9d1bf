"""Axis of revolution of a partial cloud: the cloud is registered to itself, turned about the axis.

A start comes from the normals, which meet the axis (Pottmann and Wallner, Computational Line
Geometry, 2001, chapter 3). It is refined as in point-to-plane registration (Chen and Medioni 1992):
each point is paired with a point of another azimuth at nearly the same radius and height, and the
axis moves until the pairs agree along their normals. The distance that remains tells whether the
cloud is part of a surface of revolution.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from pointsdf_cli.geometry.arrays import Array, Indices, Mask

PLANE = 20
"""Number of points of each plane that gives a normal."""
ROUNDS = 12
"""Largest number of rounds of pairing."""
APART = np.deg2rad(25.0)
"""Smallest difference of azimuth [rad] within a pair."""
NEIGHBOURS = 24
"""Neighbours among which a point's partner is looked for."""
NEAR = 0.08
"""Largest distance of a pair in radius and height, and the weight of its normals, over the cloud's
size."""
TOLERANCE = 0.002
"""Distance [m] of a pair at which its weight is one half."""
FEWEST_PAIRS = 40
ACROSS = 0.5
"""Normals with a smaller component across the axis say nothing about its place."""


class OrientedPoints(NamedTuple):
    """Points [N, 3] m and outward normals [N, 3] of unit length, and the points' `noise` [m]: the
    median deviation from a plane through their neighbours."""

    points: Array
    normals: Array
    noise: float


class Turned(NamedTuple):
    """Points about an axis.

    Attributes:
        radius, height: [N] m.
        azimuth: [N] rad.
        radial: [N, 3], unit vectors from the axis.
        outward, upward: [N], components of the normals along `radial` and along the axis.
    """

    radius: Array
    height: Array
    azimuth: Array
    radial: Array
    outward: Array
    upward: Array


class AxisFit(NamedTuple):
    """An axis.

    Attributes:
        direction: [3], of unit length, towards the camera's side.
        point: [3], on the axis, level with the mean of the points, m.
        residual: Median distance of pairs along their normals [m].
        paired: Share of the points that are in a pair.
    """

    direction: Array
    point: Array
    residual: float
    paired: float


def oriented_points(points: Array) -> OrientedPoints:
    """Smoothed points with normals, by plane fits; the camera is at the origin.

    Args:
        points: [N, 3], camera frame, m.
    """
    _, index = cKDTree(points).query(points, k=min(PLANE, len(points)))
    around = points[index]
    middle = around.mean(axis=1)
    away = around - middle[:, None]
    values, vectors = np.linalg.eigh(away.transpose(0, 2, 1) @ away)
    normals = vectors[:, :, 0]
    normals *= np.where((points * normals).sum(axis=1, keepdims=True) > 0, -1.0, 1.0)
    deviation = np.sqrt(np.maximum(values[:, 0], 0.0) / around.shape[1])
    return OrientedPoints(middle, normals, float(np.median(deviation)))


def normal_directions(seen: OrientedPoints) -> Array:
    """Unit directions [3, 3] of axes that the normals meet, the best first."""
    size = float(np.ptp(seen.points, axis=0).max())
    moment = np.cross((seen.points - seen.points.mean(axis=0)) / size, seen.normals)
    weight = np.ones((len(moment), 1))
    for _ in range(5):
        mixed = moment.T @ (weight * seen.normals)
        across = seen.normals.T @ (weight * seen.normals) + 1e-3 * weight.sum() * np.eye(3)
        eliminated = np.linalg.solve(across, mixed.T)
        _, vectors = np.linalg.eigh(moment.T @ (weight * moment) - mixed @ eliminated)
        direction = vectors[:, 0]
        miss = moment @ direction - seen.normals @ (eliminated @ direction)
        weight = 1.0 / (1.0 + (miss[:, None] / 0.03) ** 2)
    return np.asarray(vectors.T)


def axis_point(seen: OrientedPoints, direction: Array) -> Array | None:
    """A point [3] of the axis in this direction that most normals meet; None if no normal lies
    across it."""
    basis = perpendicular(direction)
    places, normals = seen.points @ basis.T, seen.normals @ basis.T
    across = np.linalg.norm(normals, axis=1)
    used = across > ACROSS
    if not used.any():
        return None
    # A normal's line n·t⊥ misses c by t⊥·(p − c), linear in c.
    tangent = np.stack([-normals[used, 1], normals[used, 0]], axis=1) / across[used, None]
    offset = (tangent * places[used]).sum(axis=1)
    weight = np.ones(len(offset))
    for _ in range(6):
        weighted = tangent * weight[:, None]
        centre = np.linalg.solve(weighted.T @ tangent + 1e-9 * np.eye(2), weighted.T @ offset)
        weight = 1.0 / (1.0 + ((tangent @ centre - offset) / (2 * TOLERANCE)) ** 2)
    return np.asarray(centre @ basis)


def refined_axis(
    seen: OrientedPoints,
    direction: Array,
    point: Array,
    upright: bool = False,
    rounds: int = ROUNDS,
) -> AxisFit | None:
    """Refine an axis by registering the points to themselves; None where few points have a partner.

    Args:
        seen: The points.
        direction: [3], of unit length.
        point: [3], on the axis, m.
        upright: Keep the direction.
        rounds: Largest number of rounds of pairing.
    """
    size = float(np.ptp(seen.points, axis=0).max())
    regular = 1e-6 * len(seen.points) * np.diag([1.0, 1.0, 0.0025, 0.0025])
    residual, paired = np.inf, 0.0
    for _ in range(rounds):
        basis = perpendicular(direction)
        around = turned(seen, direction, point)
        first, second = _pairs(around, NEAR * size)
        if len(first) < FEWEST_PAIRS:
            return None
        gap = around.outward[first] * (around.radius[second] - around.radius[first])
        gap += around.upward[first] * (around.height[second] - around.height[first])
        weight = 1.0 / (1.0 + (gap / TOLERANCE) ** 2)
        by_radius, by_height = _derivatives(seen.points - point, around, basis)
        slope = around.outward[first, None] * (by_radius[second] - by_radius[first])
        slope += around.upward[first, None] * (by_height[second] - by_height[first])
        if upright:
            slope[:, 2:] = 0.0
        weighted = slope * weight[:, None]
        step = -np.linalg.solve(weighted.T @ slope + regular, weighted.T @ gap)
        point = point + step[:2] @ basis
        direction = direction + step[2:] @ basis
        direction = direction / np.linalg.norm(direction)
        residual, paired = float(np.median(np.abs(gap))), len(first) / len(seen.points)
        if np.abs(step[:2]).max() < 2e-5 and np.abs(step[2:]).max() < 2e-4:
            break
    point = point + ((seen.points.mean(axis=0) - point) @ direction) * direction
    # The camera is at the origin.
    return AxisFit(direction * np.sign(-point @ direction), point, residual, paired)


def turned(seen: OrientedPoints, direction: Array, point: Array) -> Turned:
    """Points about an axis; see `Turned`."""
    radius, height, radial = about_axis(seen.points, direction, point)
    u, v = perpendicular(direction)
    return Turned(
        radius,
        height,
        np.arctan2(radial @ v, radial @ u),
        radial,
        (seen.normals * radial).sum(axis=1),
        seen.normals @ direction,
    )


def about_axis(points: Array, direction: Array, point: Array) -> tuple[Array, Array, Array]:
    """Radii [N] m, heights [N] m and unit vectors from the axis [N, 3] of points [N, 3] about the
    axis of this direction [3] through `point` [3]."""
    away = points - point
    height = away @ direction
    across = away - height[:, None] * direction
    radius = np.linalg.norm(across, axis=1)
    return radius, height, across / np.maximum(radius, 1e-9)[:, None]


def neighbours_apart(around: Turned, keys: Array) -> tuple[Array, Indices, Mask]:
    """The nearest `NEIGHBOURS` of points by their keys [N, K].

    Returns:
        Distances [N, M] in the keys' unit, indices [N, M], and which are of another azimuth.
    """
    distance, index = cKDTree(keys).query(keys, k=min(NEIGHBOURS, len(keys)))
    turn = around.azimuth[index] - around.azimuth[:, None]
    return distance, index, np.abs((turn + np.pi) % (2 * np.pi) - np.pi) > APART


def perpendicular(direction: Array) -> Array:
    """Two unit vectors [2, 3] that are perpendicular to a direction and to each other."""
    axis = np.eye(3)[int(np.argmin(np.abs(direction)))]
    u = np.cross(direction, axis)
    u = u / np.linalg.norm(u)
    return np.stack([u, np.cross(direction, u)])


def _pairs(around: Turned, near: float) -> tuple[Indices, Indices]:
    """Indices of points and of their partners: the nearest in radius, height and normal among
    points of another azimuth."""
    keys = np.stack(
        [around.radius, around.height, near * around.outward, near * around.upward], axis=1
    )
    distance, index, apart = neighbours_apart(around, keys)
    nearest = apart.argmax(axis=1)
    rows = np.arange(len(keys))
    usable = apart.any(axis=1) & (distance[rows, nearest] < near)
    first = np.flatnonzero(usable)
    return first, index[first, nearest[first]]


def _derivatives(away: Array, around: Turned, basis: Array) -> tuple[Array, Array]:
    """Derivatives [N, 4] of radius and height by a shift of the axis along `basis` and by a turn of
    its direction towards `basis`."""
    along = around.radial @ basis.T
    by_radius = np.concatenate([-along, -around.height[:, None] * along], axis=1)
    by_height = np.concatenate([np.zeros_like(along), away @ basis.T], axis=1)
    return by_radius, by_height
