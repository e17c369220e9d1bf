"""Contacts of the robot in PyBullet, and tests for links below an object."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from pointsdf_cli.simulation.bullet import Bullet


@dataclass(frozen=True)
class RobotContact:
    """Contact of the robot with the object.

    Attributes:
        links: Number of the robot's links that touch the object.
        hand_links: Number of the hand's links that touch it.
        depth: Deepest overlap of any robot link with the object [m], 0 if none.
    """

    links: int
    hand_links: int
    depth: float


def contact_of(
    bullet: Bullet, bodies: Iterable[int], item: int, hand: set[tuple[int, int]]
) -> RobotContact:
    """Present contact of a robot with an object.

    Args:
        bullet: The physics client.
        bodies: Bodies of the robot.
        item: Body of the object.
        hand: Body and number of each link of the hand.
    """
    points = [point for body in bodies for point in bullet.getContactPoints(bodyA=body, bodyB=item)]
    touching = [point for point in points if point[9] > 0.0 or point[8] < 0.0]
    links = {(point[1], point[3]) for point in touching}
    return RobotContact(
        links=len(links),
        hand_links=len(links & hand),
        depth=max((max(0.0, -point[8]) for point in points), default=0.0),
    )


def any_below(bullet: Bullet, links: Iterable[tuple[int, int]], item: int, aside: float) -> bool:
    """Whether a link is below an object's top and horizontally within `aside` [m] of it.

    Uses upright boxes around both.

    Args:
        bullet: The physics client.
        links: Body and number of each link.
        item: Body of the object.
        aside: Margin on all sides [m], upwards too.
    """
    low, high = bullet.getAABB(item, -1)
    for body, number in links:
        at, end = bullet.getAABB(body, number)
        if at[2] < high[2] + aside and all(
            at[k] < high[k] + aside and end[k] > low[k] - aside for k in (0, 1)
        ):
            return True
    return False
