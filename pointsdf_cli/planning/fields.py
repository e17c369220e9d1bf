"""Signed distance fields for planning: metres, world frame, negative inside, with gradients."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Protocol

import numpy as np
import scipy
from numpy.typing import NDArray

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.geometry.signed_distance import SignedDistance
from pointsdf_cli.models.reconstruction import Reconstruction


class BoundedField(Field, Protocol):
    """A field with bounds of its error."""

    def with_bound(self, points: Array) -> tuple[Array, Array]:
        """Values [N] and the most by which each can exceed the true distance [N], m."""


class ReconstructionField:
    """f_SDF(o, x): the network itself. The reconstruction's cloud must be in the world's frame."""

    def __init__(self, reconstruction: Reconstruction) -> None:
        self._reconstruction = reconstruction

    def __call__(self, points: Array) -> Array:
        return self._reconstruction.sdf(points).astype(np.float64)

    def with_gradient(self, points: Array) -> tuple[Array, Array]:
        values, gradients = self._reconstruction.sdf_and_gradient(points)
        return values.astype(np.float64), gradients.astype(np.float64)


class MeanField:
    """The mean of several fields of one object: reconstructions from several views.

    The mean of distances of slope 1 has a slope of at most 1. One view's wrong guess about a hidden
    side is outvoted by views that saw it. The mean is better than any one of them, and than one
    reconstruction of the joined clouds, which no single camera could have seen (docs/notebook.md).
    """

    def __init__(self, fields: Sequence[Field]) -> None:
        self._fields = tuple(fields)

    def __call__(self, points: Array) -> Array:
        return np.asarray(np.mean([field(points) for field in self._fields], axis=0))

    def with_gradient(self, points: Array) -> tuple[Array, Array]:
        answers = [field.with_gradient(points) for field in self._fields]
        values, gradients = (np.mean(part, axis=0) for part in zip(*answers, strict=True))
        return values, gradients


class SeenField:
    """The distance to the nearest seen point [N, 3]: a surface without an inside."""

    def __init__(self, points: Array) -> None:
        self._points = np.asarray(points, dtype=np.float64)
        self._tree = scipy.spatial.KDTree(self._points)

    def __call__(self, points: Array) -> Array:
        return np.asarray(self._tree.query(points)[0])

    def at_most(self, points: Array, limits: Array) -> Array:
        """Minimum of the distance and a limit [N] at points [N, 3], m.

        Much faster than exact distances. Where thousands of points are about equally near, an exact
        search visits all of them; this one stops at the limit.
        """
        values = np.array(limits, dtype=np.float64)
        asked = np.flatnonzero(values > 0)
        # The tree takes one limit a query: points of nearly the same limit are queried together.
        group = np.floor(np.log(np.maximum(values[asked], 1e-4)) / np.log(1.1))
        for one in np.unique(group):
            rows = asked[group == one]
            # A hair more: a distance that rounds to the limit is still found.
            most = values[rows].max() * (1 + 1e-9)
            found = self._tree.query(points[rows], distance_upper_bound=most)[0]
            values[rows] = np.minimum(values[rows], found)
        return values

    def with_gradient(self, points: Array) -> tuple[Array, Array]:
        values, nearest = self._tree.query(points)
        way = points - self._points[nearest]
        return np.asarray(values), way / np.maximum(values, 1e-12)[:, None]


class UnionField:
    """Union of a field and seen points: the lower of the two distances."""

    def __init__(self, first: Field, seen: SeenField) -> None:
        self._first, self._seen = first, seen

    def __call__(self, points: Array) -> Array:
        return self._seen.at_most(points, self._first(points))

    def with_gradient(self, points: Array) -> tuple[Array, Array]:
        values, gradients = self._first.with_gradient(points)
        others, their = self._seen.with_gradient(points)
        lower = others < values
        return np.where(lower, others, values), np.where(lower[:, None], their, gradients)


class NearField:
    """A field evaluated only near the object; elsewhere the distance to a box around it.

    The surface lies within the box, so the distance to the box never exceeds the distance to the
    object. A network is trained near objects; far away it is slow (all its nearest neighbours are
    equally near) and no more accurate than the box.

    Args:
        field: Field to evaluate.
        low, high: [3], the box [m]; it must enclose the surface.
        exact_to: Points nearer to the box than this [m] are evaluated.
    """

    def __init__(self, field: Field, low: Array, high: Array, exact_to: float = 0.03) -> None:
        self._field, self._low, self._high, self._exact_to = field, low, high, exact_to

    def __call__(self, points: Array) -> Array:
        _, gap, near = self._way(points)
        if near.any():
            gap[near] = self._field(points[near])
        return gap

    def with_gradient(self, points: Array) -> tuple[Array, Array]:
        way, values, near = self._way(points)
        gradients = way / np.maximum(values, 1e-12)[:, None]
        if near.any():
            values[near], gradients[near] = self._field.with_gradient(points[near])
        return values, gradients

    def _way(self, points: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Vectors from the box to the points [N, 3], their lengths [N], and a mask of near ones."""
        way = points - np.clip(points, self._low, self._high)
        gap = np.sqrt((way**2).sum(axis=1))
        return way, gap, gap < self._exact_to


class RedistancedField:
    """A field that, away from its zero level, is at least the distance to it less a margin.

    Where little was seen a network's values may stay near zero far from its surface. On 118 views
    of unknown objects the distance to the surface was the better estimate everywhere beyond
    2 mm (docs/notebook.md, "Redistancing").

    Args:
        field: Field to correct.
        surface: Vertices [V, 3] of its zero level, m; at least as dense as the margin.
        outside: Field whose sign tells the outside beyond the margin.
    """

    MARGIN = 0.01
    """Nearer to the surface than this [m] the field keeps its values: small ones there often mean
    a surface that was missed."""
    ENOUGH = 0.02
    """Corrected value [m] above which the field is not evaluated."""

    def __init__(self, field: Field, surface: Array, outside: Field) -> None:
        self._field, self._outside = field, outside
        self._surface = SeenField(surface)

    def least(self, points: Array) -> Array:
        """Lower bounds [N] of the values at points [N, 3], m; −∞ within `MARGIN` and inside."""
        return self._bound(points, self._surface(points))

    def __call__(self, points: Array) -> Array:
        values = self.least(points)
        asked = values <= self.ENOUGH
        if asked.any():
            values[asked] = np.maximum(values[asked], self._field(points[asked]))
        return values

    def with_gradient(self, points: Array) -> tuple[Array, Array]:
        distance, gradients = self._surface.with_gradient(points)
        values = self._bound(points, distance)
        asked = np.flatnonzero(values <= self.ENOUGH)
        if len(asked):
            own, slopes = self._field.with_gradient(points[asked])
            higher = own > values[asked]
            values[asked[higher]], gradients[asked[higher]] = own[higher], slopes[higher]
        return values, gradients

    def _bound(self, points: Array, distance: Array) -> Array:
        bound = distance - self.MARGIN
        far = np.flatnonzero(bound > 0)
        known = np.zeros(len(points), dtype=bool)
        known[far] = self._outside(points[far]) > 0
        return np.where(known, bound, -np.inf)


class MeshField:
    """The exact distance to a closed mesh: for partial-view grasping, and for the truth in trials.

    Args:
        vertices: [V, 3], world frame, m.
        faces: [F, 3].
    """

    STEP = 1e-4
    """Step of the central differences [m]: far above float32 rounding, far below any curvature."""

    def __init__(self, vertices: Array, faces: NDArray[np.integer]) -> None:
        self._distance = SignedDistance(vertices, faces, threads=1)

    def __call__(self, points: Array) -> Array:
        return self._distance(points).astype(np.float64)

    def with_gradient(self, points: Array) -> tuple[Array, Array]:
        shifts = self.STEP * np.eye(3)
        both = [points + s for s in shifts] + [points - s for s in shifts]
        around = self(np.concatenate(both)).reshape(2, 3, len(points))
        return self(points), ((around[0] - around[1]) / (2 * self.STEP)).T


class RefinedField:
    """A quick field, replaced by the exact one wherever the difference could matter.

    If the quick value minus its error bound exceeds `beyond`, so does the true value, and the quick
    one is returned; otherwise the exact field is evaluated. So values below `beyond` are exact.

    Attributes:
        queries: Number of queries of the exact field.
    """

    def __init__(self, quick: BoundedField, exact: Field, beyond: float) -> None:
        self._quick, self._exact, self._beyond = quick, exact, beyond
        self._cautious = False
        self.queries = 0

    def cautious(self) -> RefinedField:
        """A copy that returns the quick value minus its bound: never more than the exact one."""
        other = copy(self)
        other._cautious = True
        return other

    def __call__(self, points: Array) -> Array:
        values, near = self._judge(points)
        if near.any():
            values[near] = self._exact(points[near])
        return values

    def with_gradient(self, points: Array) -> tuple[Array, Array]:
        values, near = self._judge(points)
        _, gradients = self._quick.with_gradient(points)
        if near.any():
            values[near], gradients[near] = self._exact.with_gradient(points[near])
        return values, gradients

    def _judge(self, points: Array) -> tuple[Array, NDArray[np.bool_]]:
        values, bound = self._quick.with_bound(points)
        near: NDArray[np.bool_] = values - bound <= self._beyond
        self.queries += int(near.sum())
        return (values - bound if self._cautious else values), near


def cautious(field: Field) -> Field:
    """A lower bound of `field`, quicker to evaluate where possible."""
    return field.cautious() if isinstance(field, RefinedField) else field
