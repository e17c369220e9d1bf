"""Order in which to grasp the objects on a table: in reach and least enclosed first."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.planning.labelled_view import LabelledView
from pointsdf_cli.planning.object_choice import ListedObject, Reach

HAND_ROOM = 0.10
"""Distance [m] within which another object blocks a hand that comes from its side."""

SECTORS = 24
"""Number of horizontal directions around an object to test."""

EQUALLY_FREE = 0.1
"""Difference of two shares of free directions below which they count as equal."""


class OrderedObject(NamedTuple):
    """One object in the order.

    Attributes:
        item: The object.
        free: Share of the horizontal directions around it without a near neighbour.
        reached: Whether the robot's palm can get near the table there.
        fits: Whether it is narrow enough for the robot's jaws.
    """

    item: ListedObject
    free: float
    reached: bool
    fits: bool = True

    def describe(self) -> str:
        """Describe the reason for its place in the order."""
        where = "in reach" if self.reached else "at the edge of the reach"
        where += "" if self.fits else ", too wide for the jaws"
        return f"object {self.item.number} ({where}, {self.free:.0%} of the directions free)"


def take_order(view: LabelledView, reach: Reach | None = None) -> list[OrderedObject]:
    """The standing objects of a view, the easiest to grasp first.

    Args:
        view: The labelled view.
        reach: Result of `object_choice.reach_of`; None if the robot's pose is not known.
    """
    label = view.objects.label
    ordered = []
    for item in (each for each in view.listed if each.stands):
        mine = label == item.label
        free = free_share(view.world[mine], view.world[(label >= 0) & ~mine])
        reached = reach is None or reach.beyond(item.centre) == 0
        ordered.append(OrderedObject(item, free, reached, reach is None or reach.fits(item.size)))
    # Objects that are about equally free keep the order of their numbers.
    ordered.sort(key=lambda one: (not one.reached, not one.fits, -round(one.free / EQUALLY_FREE)))
    return ordered


def free_share(points: Array, others: Array) -> float:
    """Share of the horizontal directions around an object without another within `HAND_ROOM`.

    Args:
        points: [N, 3], points of the object, world, m.
        others: [M, 3], points of all other objects.
    """
    if not len(others):
        return 1.0
    tree = scipy.spatial.cKDTree(points[:, :2])
    away, _ = tree.query(others[:, :2], distance_upper_bound=HAND_ROOM)
    near = others[np.isfinite(away), :2]
    middle = (points[:, :2].min(axis=0) + points[:, :2].max(axis=0)) / 2
    angle = np.arctan2(*(near - middle).T[::-1]) / (2 * np.pi)
    blocked = np.unique(np.floor(angle * SECTORS).astype(int) % SECTORS)
    return 1.0 - len(blocked) / SECTORS
