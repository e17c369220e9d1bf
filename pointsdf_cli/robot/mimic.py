"""Joints that others move along (`<mimic>`), such as the second jaw of a gripper."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.robot.urdf import Joint, Tree

APART = 0.005
"""Largest difference [rad or m] of a joint from where its leader puts it."""
Followers = tuple[tuple[int, int, float], ...]
"""By follower: its column in q, its leader's, and the ratio of their motions."""


def followers_of(tree: Tree, names: Sequence[str]) -> Followers:
    """The joints among `names`, the order of q, that follow another of them."""
    coupled = {joint.name: joint.mimic for joint in tree.joints if joint.mimic}
    found = []
    for column, name in enumerate(names):
        leader, ratio = name, 1.0
        while leader in coupled:
            leader, share = coupled[leader]
            ratio *= share
        if leader != name and leader in names:
            found.append((column, names.index(leader), ratio))
    return tuple(found)


def follow(q: Array, followers: Followers) -> Array:
    """Configurations [..., J] like `q`, with followers where their leaders put them."""
    q = np.array(q, dtype=float)
    for column, leader, ratio in followers:
        q[..., column] = ratio * q[..., leader]
    return q


def require_together(
    q: Array, joints: Sequence[Joint], followers: Followers, where: object
) -> None:
    """Refuse a configuration with joints apart that the hardware moves together.

    Args:
        q: [J], rad or m.
        joints: The joints of q.
        followers: The joints among them that follow others.
        where: Source of q, for the message.

    Raises:
        InputError: A follower is farther than `APART` from its place.
    """
    for column, leader, ratio in followers:
        place, joint = ratio * float(q[leader]), joints[column]
        if abs(q[column] - place) <= APART:
            continue
        one, other = (f"{joints[k].name} at {q[k]:.4g}" for k in (column, leader))
        within = joint.lower - APART <= place <= joint.upper + APART
        raise InputError(
            f"{one} does not follow {other}",
            where=where,
            allowed=f"{place:.4g}: the hardware moves both together",
            hint=None
            if within
            else f"mend <limit> or <mimic> of {joint.name} in the URDF: "
            f"its limits {joint.lower:g} to {joint.upper:g} leave this out",
        )
