"""Closing motion of a hand: positions of its fingertips in the palm's frame, from open to
closed."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np
import torch
from torch import Tensor

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.robot.surface import link_surface, robot_surface

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


def closing_of(robot: RobotDescription, steps: int = 25) -> Closing:
    """Close the hand without anything in it."""
    kinematics = Kinematics(robot)
    surface = robot_surface(robot)
    start = open_hand(robot)
    ends = robot.closing_ends
    share = np.linspace(0.0, 1.0, steps)[:, None]
    q = np.repeat(start[None], steps, axis=0)
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
        alone = np.repeat(start[None], steps, axis=0)
        alone[:, leader] = ways.get(leader, ways[column] / ratio)
        beyond = robot.tree.beyond(robot.moved_with(robot.joint_names[leader]))
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
    moved = dict.fromkeys(link for joint in robot.hand_joints for link in tree.beyond([joint]))
    shaped = [link for link in moved if tree.shapes[link]]
    inner = {joint.parent for link in shaped for joint in tree.way_up(link)}
    tips = [link for link in shaped if link not in inner]
    if robot.followers:
        chains = {tip: {tip, *(joint.parent for joint in tree.way_up(tip))} for tip in tips}
        struts = _struts(robot, {tip: chains[tip] & set(shaped) for tip in tips})
        tips = [tip for tip in tips if tip not in struts]
    return tuple(tips)


def _struts(robot: RobotDescription, chains: dict[str, set[str]]) -> set[str]:
    """Fingertips that overlap a link of another finger, one that reaches farther, however far the
    hand is closed.

    Args:
        robot: The robot.
        chains: The links of each finger that have a shape, by its fingertip.
    """
    kinematics = Kinematics(robot)
    share = np.array([[0.0], [0.5], [1.0]])
    q = robot.follow((1 - share) * robot.lower + share * robot.upper)
    rotation, position = kinematics(q)
    surface = {
        link: link_surface(robot.tree.shapes[link]) for chain in chains.values() for link in chain
    }
    at = {link: kinematics.index(link) for link in [robot.palm_link, *surface]}

    def local(link: str, frame: str) -> Tensor:
        """Points of a link in the frame of another, [3, P, 3]."""
        points = torch.from_numpy(surface[link])
        world = points @ rotation[:, at[link]].transpose(1, 2) + position[:, None, at[link]]
        return (world - position[:, None, at[frame]]) @ rotation[:, at[frame]]

    def depth(link: str, other: str) -> Tensor:
        """Distances [3] of a link's points to the shapes of another."""
        points = local(link, other)
        far = [shape.signed_distance(points).amin(dim=1) for shape in robot.tree.shapes[other]]
        return torch.stack(far).amin(dim=0)

    reach = {tip: float(local(tip, robot.palm_link).norm(dim=2).max()) for tip in chains}
    return {
        tip
        for tip, other in permutations(chains, 2)
        if tip not in chains[other] and reach[tip] < reach[other]
        if any(
            bool((torch.minimum(depth(tip, link), depth(link, tip)) < 0).all())
            for link in chains[other] - chains[tip]
        )
    }


def to_palm_axis(robot: RobotDescription, points: Array) -> Array:
    """Distances [...] of points [..., 3], palm frame, to the half-line on which objects approach
    the palm: from (0, 0, reach) in the direction of x."""
    local = points - [0.0, 0.0, robot.palm_reach or 0.0]
    local = np.concatenate([np.minimum(local[..., :1], 0.0), local[..., 1:]], axis=-1)
    return np.asarray(np.linalg.norm(local, axis=-1))
