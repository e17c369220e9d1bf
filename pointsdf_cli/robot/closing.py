"""Closing motion of a hand: positions of its fingertips in the palm's frame, from open to
closed."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.robot.collision import SelfCollision
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.robot.surface import link_surface, robot_surface

STEPS = 25
"""Number of configurations of a closing hand."""
NEARER = 0.002
"""Least distance [m] by which a closing joint brings a fingertip nearer to the palm's axis."""


@dataclass(frozen=True)
class Closing:
    """Closing motion of a hand from the middle of its preshapes, in T steps.

    Attributes:
        q: [T, J], the arm at home.
        tips: Names of the fingers' last links that have a shape; F of them.
        paths: [T, F, 3], the middle of each of them, palm frame, m.
        nearer: By closing joint, how much nearer [m] to the palm's axis a fingertip comes when
            that joint and its followers alone run to their ends; 0 if it only moves away.
    """

    q: Array
    tips: tuple[str, ...]
    paths: Array
    nearer: dict[str, float]

    @property
    def middle(self) -> Array:
        """[3], where the fingertips are on average while they close, palm frame."""
        return np.asarray(self.paths.mean(axis=(0, 1)))


def open_hand(robot: RobotDescription) -> Array:
    """The configuration [J] at home with preshape joints in the middle of their ranges, and other
    joints of the hand at rest, as in plans."""
    return robot.configuration(robot.home[robot.arm], robot.preshape_ranges.mean(axis=1))


def closing_of(robot: RobotDescription) -> Closing:
    """Close the hand without anything in it."""
    kinematics = Kinematics(robot)
    surface = robot_surface(robot)
    start = open_hand(robot)
    ends = robot.closing_ends
    share = np.linspace(0.0, 1.0, STEPS)[:, None]
    q = np.repeat(start[None], STEPS, axis=0)
    q[:, robot.closing_columns] = (1 - share) * start[robot.closing_columns] + share * ends
    ways = dict(zip(robot.closing_columns, q[:, robot.closing_columns].T, strict=True))
    q = robot.follow(q)
    tips = fingertips(robot)
    middles = [(tip, surface[tip].mean(axis=0)[None]) for tip in tips]

    def in_palm(q: Array) -> Array:
        palm = kinematics.palm(q).numpy()
        world = np.concatenate(kinematics.points(q, middles), axis=1)
        apart = world - palm[:, None, :3, 3]
        return np.asarray(np.einsum("tba,tfb->tfa", palm[:, :3, :3], apart))

    nearer = {}
    leaders = {column: (leader, ratio) for column, leader, ratio in robot.followers}
    for joint, column in zip(robot.closing_joints, robot.closing_columns, strict=True):
        leader, ratio = leaders.get(column, (column, 1.0))
        alone = np.repeat(start[None], STEPS, axis=0)
        alone[:, leader] = ways.get(leader, ways[column] / ratio)
        beyond = robot.tree.links_moved_by(robot.moved_with(robot.joint_names[leader]))
        moved = [k for k, tip in enumerate(tips) if tip in beyond]
        away = to_palm_axis(robot, in_palm(robot.follow(alone))[:, moved])
        nearer[joint] = float((away[0] - away.min(axis=0)).max()) if moved else 0.0
    return Closing(q, tips, in_palm(q), nearer)


def fingertips(robot: RobotDescription) -> tuple[str, ...]:
    """Links beyond a hand joint, with a shape, beyond which there is no other such link.

    Struts are left out: a URDF cannot close a linkage, so the inner knuckles of some grippers
    (Robotiq, xArm) end where they meet their finger.
    """
    tree = robot.tree
    moved = dict.fromkeys(
        link for joint in robot.hand_joints for link in tree.links_moved_by([joint])
    )
    shaped = [link for link in moved if tree.shapes[link]]
    inner = {joint.parent for link in shaped for joint in tree.joints_to_root(link)}
    tips = [link for link in shaped if link not in inner]
    if robot.followers:
        chains = {tip: {tip, *(joint.parent for joint in tree.joints_to_root(tip))} for tip in tips}
        struts = _struts(robot, {tip: chains[tip] & set(shaped) for tip in tips})
        tips = [tip for tip in tips if tip not in struts]
    return tuple(tips)


def _struts(robot: RobotDescription, chains: dict[str, set[str]]) -> set[str]:
    """Fingertips that overlap a link of a finger that reaches farther, however far the hand is
    closed.

    Args:
        robot: The robot.
        chains: The links of each finger that have a shape, by its fingertip.
    """
    kinematics, share = Kinematics(robot), np.array([[0.0], [0.5], [1.0]])
    q = robot.follow((1 - share) * robot.lower + share * robot.upper)
    between = {
        (tip, other): [(tip, link) for link in sorted(chains[other] - chains[tip])]
        for tip, other in permutations(chains, 2)
    }
    pairs = [pair for links in between.values() for pair in links]
    overlap = (SelfCollision(kinematics, pairs=pairs)(*kinematics(q)) < 0).all(dim=0)
    met = {pair for pair, always in zip(pairs, overlap.tolist(), strict=True) if always}
    surface = [(tip, link_surface(robot.tree.shapes[tip])) for tip in chains]
    *points, palm = kinematics.points(q[0], [*surface, (robot.palm_link, np.zeros((1, 3)))])
    reach = {
        tip: float((p - palm).norm(dim=1).max()) for tip, p in zip(chains, points, strict=True)
    }
    return {a for (a, b), links in between.items() if reach[a] < reach[b] and met & set(links)}


def to_palm_axis(robot: RobotDescription, points: Array) -> Array:
    """Distances [...] of points [..., 3], palm frame, to the half-line on which objects approach
    the palm: from (0, 0, reach) in the direction of x."""
    local = points - [0.0, 0.0, robot.palm_reach or 0.0]
    local = np.concatenate([np.minimum(local[..., :1], 0.0), local[..., 1:]], axis=-1)
    return np.asarray(np.linalg.norm(local, axis=-1))
