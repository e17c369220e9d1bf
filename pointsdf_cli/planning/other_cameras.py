"""The first camera's object in the views of other cameras."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from pointsdf_cli.geometry.arrays import Array, Mask
from pointsdf_cli.planning.labelled_view import UNCLEAN, LabelledView
from pointsdf_cli.planning.object_choice import NoObjectError

SAME_THING = 0.03
"""Largest distance [m] between an object's points in another camera and in the first one."""
TOUCHING = 0.01
"""Largest distance [m] at which two cameras see the same surface."""
PART = 0.1
"""Least share of a group's points that lie on the first camera's object, or on other objects, for
these to be part of the group."""


@dataclass(frozen=True)
class FirstView:
    """Points that the first camera saw, world frame, m.

    Attributes:
        target: [M, 3], points of the object.
        others: [K, 3], points of other objects.
    """

    target: Array
    others: Array

    def check(self, points: Array, name: str) -> None:
        """Require that points [N, 3] of another camera are of the same object, and of it alone.

        Raises:
            NoObjectError: They are of another object, which stands before it perhaps, or of several
                that this camera sees as one.
        """
        to_target, to_others = self._distances(points)
        nearest = float(to_target.min())
        if nearest > min(SAME_THING, float(to_others.min())):
            away = f"what is nearest to the object is {nearest:.2f} m away from it"
            raise NoObjectError(away, where=name)
        if self._is_merged(to_target, to_others):
            raise NoObjectError("this camera sees it and another object as one", where=name)

    def without_target(self, view: LabelledView) -> LabelledView:
        """The view without the target's part of groups that hold other objects, too.

        As an obstacle, that part would block every grasp.
        """
        label = view.objects.label.copy()
        to_target, to_others = self._distances(view.world)
        for group in range(view.objects.count):
            mine = view.objects.label == group
            if mine.any() and self._is_merged(to_target[mine], to_others[mine]):
                label[mine & (to_target < to_others)] = UNCLEAN
        return replace(view, objects=replace(view.objects, label=label))

    def _distances(self, points: Array) -> tuple[Array, Array]:
        """Distances [N] of points [N, 3] to those of the target and to those of other objects."""
        return _to_nearest(self.target, points), _to_nearest(self.others, points)

    @staticmethod
    def _is_merged(to_target: Array, to_others: Array) -> bool:
        """Whether a group at these distances [N] shows both the target and another object."""
        own: Mask = to_target < np.minimum(to_others, TOUCHING)
        foreign: Mask = to_others < np.minimum(to_target, TOUCHING)
        return bool(min(own.mean(), foreign.mean()) >= PART)


def _to_nearest(seen: Array, points: Array) -> Array:
    if not len(seen):
        return np.full(len(points), np.inf)
    return np.asarray(scipy.spatial.cKDTree(seen).query(points)[0])
