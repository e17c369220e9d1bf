"""The order in which the things on a table can be taken: in reach and least enclosed first."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.planning.object_choice import Thing
from pointsdf_cli.planning.scene import Scene

HAND_ROOM = 0.10
"""Another thing nearer than this [m] is in the way of a hand that comes from its side."""

SECTORS = 24
"""Level directions around a thing that are free or not."""

EQUALLY_FREE = 0.1
"""Shares of free directions that differ by less count as equal."""


class Turn(NamedTuple):
    """One thing in the order.

    Attributes:
        thing: The thing.
        free: Share of the level directions around it in which nothing stands near.
        reached: It stands where the robot's palm gets near the table.
    """

    thing: Thing
    free: float
    reached: bool

    def describe(self) -> str:
        """Place in the order in words."""
        where = "in reach" if self.reached else "at the edge of the reach"
        return f"object {self.thing.number} ({where}, {self.free:.0%} of the directions free)"


def take_order(scene: Scene, reach: tuple[float, float] | None = None) -> list[Turn]:
    """The standing things of a scene, the easiest to take first.

    Args:
        scene: Sorted.
        reach: From `object_choice.reach_of`; None where the robot's place is not known.
    """
    label = scene.things.label
    standing = [thing for thing in scene.listed if thing.stands]
    turns = []
    for thing in standing:
        mine = label == thing.label
        free = free_share(scene.world[mine], scene.world[(label >= 0) & ~mine])
        level = float(np.linalg.norm(thing.centre[:2]))
        turns.append(Turn(thing, free, reach is None or reach[0] <= level <= reach[1]))
    # What is about equally free keeps the order of the numbers.
    turns.sort(key=lambda turn: (not turn.reached, -round(turn.free / EQUALLY_FREE)))
    return turns


def free_share(points: Array, others: Array) -> float:
    """Share of the level directions around a thing in which no other stands within `HAND_ROOM`.

    Args:
        points: [N, 3], of the thing, world, m.
        others: [M, 3], of all others.
    """
    if not len(others):
        return 1.0
    away, _ = scipy.spatial.cKDTree(points[:, :2]).query(
        others[:, :2], distance_upper_bound=HAND_ROOM
    )
    near = others[np.isfinite(away), :2]
    middle = (points[:, :2].min(axis=0) + points[:, :2].max(axis=0)) / 2
    angle = np.arctan2(*(near - middle).T[::-1]) / (2 * np.pi)
    blocked = np.unique(np.floor(angle * SECTORS).astype(int) % SECTORS)
    return 1.0 - len(blocked) / SECTORS
