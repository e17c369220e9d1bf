"""Body of revolution: signed distance of an outline that is turned about an axis.

The distance in space is the distance in the half plane of radius and height. For many queries it is
tabulated there once and interpolated, so that a query costs two lookups. Near the surface, where a
wall may be thinner than a cell of the table, it is computed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from pointsdf_cli.geometry.arrays import Array, Mask, Surface
from pointsdf_cli.geometry.axis_fit import about_axis, perpendicular

CELLS = (160, 200)
"""Cells of the table along radius and height."""
STEP = 0.0005
"""Distance [m] of the samples by which the nearest segment is found."""
MARGIN = 0.5
"""Width of the table beyond the outline, over the outline's larger extent."""


@dataclass(frozen=True, eq=False)
class Profile:
    """Half of a body of revolution's section.

    Attributes:
        outline: [K, 2], radius and height [m], counter-clockwise from the axis back to the axis;
            its ends have radius 0.
    """

    outline: Array

    @cached_property
    def table(self) -> tuple[Array, Array, Array]:
        """Its distances [R, H] m, made when first asked for (20 ms), with the lowest radius and
        height [2] m, and the sides of the cells [2] m."""
        low, high = self.outline.min(axis=0), self.outline.max(axis=0)
        margin = MARGIN * float((high - low).max())
        low, high = np.array([0.0, low[1] - margin]), high + margin
        sides = (high - low) / CELLS
        radii, heights = (low[k] + sides[k] * np.arange(CELLS[k] + 1) for k in (0, 1))
        places = np.stack(np.meshgrid(radii, heights, indexing="ij"), axis=-1).reshape(-1, 2)
        values = _signed_distance(places, self.outline).reshape(len(radii), len(heights))
        return values, low, sides


@dataclass(frozen=True)
class BodyOfRevolution:
    """A body of revolution.

    Attributes:
        direction: [3], of unit length.
        point: [3], on the axis at height 0, m.
        profile: Half of its section.
    """

    direction: Array
    point: Array
    profile: Profile

    @classmethod
    def of(cls, direction: Array, point: Array, outline: Array) -> BodyOfRevolution:
        """Turn an outline [K, 2] about an axis; see the attributes."""
        return cls(direction, point, Profile(outline))

    @property
    def outline(self) -> Array:
        """Outline [K, 2] of the profile."""
        return self.profile.outline

    def sdf(self, points: Array) -> Array:
        """Signed distances [N] m at points [N, 3], negative inside; far away, lower bounds."""
        radius, height, _ = self._place(points)
        return self._look_up(radius, height)[0]

    def exact_sdf(self, points: Array) -> Array:
        """The same without the table, for up to some thousand points."""
        radius, height, _ = self._place(points)
        return _signed_distance(np.stack([radius, height], axis=1), self.outline)

    def sdf_and_gradient(self, points: Array) -> tuple[Array, Array]:
        """Signed distances [N] m, far away lower bounds, and their gradients [N, 3]."""
        radius, height, radial = self._place(points)
        values, by_radius, by_height = self._look_up(radius, height)
        return values, by_radius[:, None] * radial + by_height[:, None] * self.direction

    def at(self, radius: Array, height: Array, azimuth: Array) -> Array:
        """Points [..., 3] at radii and heights [...] m and azimuths [...] rad."""
        around = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
        across = radius[..., None] * (around @ perpendicular(self.direction))
        return np.asarray(self.point + height[..., None] * self.direction + across)

    def surface(self, sectors: int = 48) -> Surface:
        """The outline revolved, with this number of faces around the axis."""
        turns = 2 * np.pi * np.arange(sectors) / sectors
        inner = self.outline[1:-1]
        rings = self.at(inner[:, :1], inner[:, 1:], turns).reshape(-1, 3)
        ends = self.point + self.outline[[0, -1], 1:] * self.direction
        here = np.arange(sectors)
        beside = (here + 1) % sectors
        below = sectors * np.arange(len(inner) - 1)[:, None]
        first, last = len(rings) + np.zeros((2, sectors), dtype=np.int64) + [[0], [1]]
        top = sectors * (len(inner) - 1)
        corners = [
            (below + here, below + beside, below + sectors + here),
            (below + beside, below + sectors + beside, below + sectors + here),
            (first, beside, here),
            (top + here, top + beside, last),
        ]
        faces = [np.stack([c.ravel() for c in three], axis=1) for three in corners]
        return np.concatenate([rings, ends]), np.concatenate(faces)

    @property
    def radius(self) -> float:
        """Largest radius [m]."""
        return float(self.outline[:, 0].max())

    def moved(self, rotation: Array, translation: Array) -> BodyOfRevolution:
        """The body in another frame: rotation [3, 3], then translation [3]."""
        point = rotation @ self.point + translation
        return replace(self, direction=rotation @ self.direction, point=point)

    def _place(self, points: Array) -> tuple[Array, Array, Array]:
        return about_axis(np.asarray(points, dtype=np.float64), self.direction, self.point)

    def _look_up(self, radius: Array, height: Array) -> tuple[Array, Array, Array]:
        """Values [N] and their derivatives [N] by radius and height."""
        values, low, sides = self.profile.table
        place = (np.stack([radius, height], axis=1) - low) / sides
        inside = np.clip(place, 0.0, np.array(CELLS))
        beyond = (place - inside) * sides
        cell = np.minimum(inside.astype(np.int64), np.array(CELLS) - 1)
        x, y = (inside - cell).T
        i, j = cell.T
        a, b = values[i, j], values[i, j + 1]
        c, d = values[i + 1, j], values[i + 1, j + 1]
        value = (1 - x) * ((1 - y) * a + y * b) + x * ((1 - y) * c + y * d)
        by_radius = ((1 - y) * (c - a) + y * (d - b)) / sides[0]
        by_height = ((1 - x) * (b - a) + x * (d - c)) / sides[1]
        # Beyond the table: the body is at least as far as from the nearest place of the table, at a
        # right angle or more to the way there, so this never exceeds the distance.
        away = np.flatnonzero(beyond.any(axis=1))
        there, beyond = value[away], beyond[away]
        value[away] = total = np.sqrt((beyond**2).sum(axis=1) + there**2)
        for k, slope in enumerate((by_radius, by_height)):
            out = beyond[:, k]
            slope[away] = np.where(out != 0, out, there * slope[away]) / total
        near = np.flatnonzero(np.abs(value) < sides.max())
        if len(near):
            places = np.stack([radius[near], height[near]], axis=1)
            gap = outline_gap(places, self.outline)
            sign = np.where(_inside(places, self.outline), -1.0, 1.0)
            value[near] = exact = sign * np.linalg.norm(gap, axis=1)
            on = exact == 0  # there the table's slopes are as good
            for k, slope in enumerate((by_radius, by_height)):
                slope[near] = np.where(on, slope[near], gap[:, k] / np.where(on, 1.0, exact))
        return value, by_radius, by_height


def _signed_distance(places: Array, outline: Array) -> Array:
    distance = outline_distance(places, outline)
    return np.where(_inside(places, outline), -distance, distance)


def outline_distance(places: Array, outline: Array) -> Array:
    """Distances [N] of radii and heights [N, 2] to an outline [K, 2]; the axis between its ends is
    no part of it."""
    return np.asarray(np.linalg.norm(outline_gap(places, outline), axis=1))


def outline_gap(places: Array, outline: Array) -> Array:
    """Vectors [N, 2] from the nearest points of an outline [K, 2] to radii and heights [N, 2]."""
    begin, way = outline[:-1], np.diff(outline, axis=0)
    length = np.linalg.norm(way, axis=1)
    counts = np.ceil(length / STEP).astype(int).clip(min=1)
    segment = np.repeat(np.arange(len(counts)), counts)
    share = np.arange(len(segment)) - np.repeat(counts.cumsum() - counts, counts) + 0.5
    samples = begin[segment] + (share / counts[segment])[:, None] * way[segment]
    nearest = segment[cKDTree(samples).query(places)[1]]
    # The nearest point lies on the sample's segment or on one beside it.
    asked = np.clip(nearest[:, None] + [-1, 0, 1], 0, len(way) - 1)
    away = places[:, None] - begin[asked]
    along = (away * way[asked]).sum(axis=-1) / np.maximum(length[asked] ** 2, 1e-18)
    gap = away - np.clip(along, 0.0, 1.0)[..., None] * way[asked]
    best = (gap * gap).sum(axis=-1).argmin(axis=1)
    return np.asarray(np.take_along_axis(gap, best[:, None, None], axis=1)[:, 0])


def _inside(places: Array, outline: Array) -> Mask:
    """Whether radii and heights [N, 2] are inside: to larger radii the outline is crossed an odd
    number of times."""
    begin, way = outline[:-1], np.diff(outline, axis=0)
    above = outline[:, 1] > places[:, 1:]
    row, segment = np.nonzero(above[:, :-1] != above[:, 1:])
    share = (places[row, 1] - begin[segment, 1]) / way[segment, 1]
    beyond = places[row, 0] < begin[segment, 0] + way[segment, 0] * share
    return np.asarray(np.bincount(row[beyond], minlength=len(places)) % 2 == 1)
