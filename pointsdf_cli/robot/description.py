"""Description of a robot for grasping: a YAML file beside its URDF. Another robot needs no code."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from pointsdf_cli.assets import bundled_robots, robot_file
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array, Indices, Mask
from pointsdf_cli.io.input_files import read_input
from pointsdf_cli.io.untrusted import read_yaml
from pointsdf_cli.robot.mimic import Followers, follow, followers_of, require_together
from pointsdf_cli.robot.robot_keys import RobotKeys, read_only
from pointsdf_cli.robot.urdf import MOVING, Joint, Tree, read_urdf


@dataclass(frozen=True, eq=False)
class RobotDescription:
    """An arm with a hand. A configuration q [J] is the arm's joints, then the hand's.

    Attributes:
        name: Name of the robot.
        urdf: The URDF file.
        tree: Its links, joints and shapes.
        T_world_base: [4, 4], the root link in the world, whose z = 0 is the table top.
        arm_joints, hand_joints: Joint names; together they order q.
        preshape_joints: The hand joints that a grasp chooses; the others stay at 0.
        preshape_ranges: [K, 2], what preshapes are drawn from [rad].
        closing_joints: The hand joints that close.
        closing_speeds: [C], rad/s on the real robot, towards each joint's upper limit if
            positive.
        palm_link: The link that carries the palm frame and, beyond it, all fingers.
        T_link_palm: [4, 4], the palm frame (x out of the palm, z along the fingers, y towards the
            thumb's side) in that link.
        palm_reach: Distance along z [m] from the palm frame's origin to the middle of the grasped
            object; None leaves it to the heuristic.
        lower, upper: [J], limits to plan within.
        hard_lower, hard_upper: [J], limits of the URDF.
        velocity, effort: [J], largest speeds and torques.
        home: [J], where the robot waits.
        links_on_table: Links that stand on the table and are never checked against it.
        may_touch: Pairs of links that may touch each other, beside neighbours.
    """

    name: str
    urdf: Path
    tree: Tree
    T_world_base: Array
    arm_joints: tuple[str, ...]
    hand_joints: tuple[str, ...]
    preshape_joints: tuple[str, ...]
    preshape_ranges: Array
    closing_joints: tuple[str, ...]
    closing_speeds: Array
    palm_link: str
    T_link_palm: Array
    palm_reach: float | None
    lower: Array
    upper: Array
    hard_lower: Array
    hard_upper: Array
    velocity: Array
    effort: Array
    home: Array
    links_on_table: frozenset[str]
    may_touch: frozenset[frozenset[str]]

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """The order of q."""
        return self.arm_joints + self.hand_joints

    @cached_property
    def joints(self) -> tuple[Joint, ...]:
        """The joints in the order of q."""
        by_name = {joint.name: joint for joint in self.tree.joints}
        return tuple(by_name[name] for name in self.joint_names)

    @cached_property
    def slides(self) -> Mask:
        """bool [J], prismatic joints."""
        return np.array([joint.kind == "prismatic" for joint in self.joints])

    @property
    def arm(self) -> slice:
        """The arm's part of q."""
        return slice(0, len(self.arm_joints))

    @cached_property
    def preshape_columns(self) -> Indices:
        """Columns of the preshape joints in q."""
        return np.array([self.joint_names.index(name) for name in self.preshape_joints])

    @cached_property
    def closing_columns(self) -> Indices:
        """Columns of the closing joints in q."""
        return np.array([self.joint_names.index(name) for name in self.closing_joints])

    @cached_property
    def closing_ends(self) -> Array:
        """Hard limits [K] at which the closing joints end when they close [rad; m]."""
        columns = self.closing_columns
        return np.where(self.closing_speeds > 0, self.hard_upper[columns], self.hard_lower[columns])

    @cached_property
    def followers(self) -> Followers:
        """Joints that others move along (`<mimic>`), such as the second jaw of a gripper: column in
        q, the leader's column, and the ratio of their motions."""
        return followers_of(self.tree, self.joint_names)

    def moved_with(self, joint: str) -> tuple[str, ...]:
        """A joint and its followers."""
        names, leader = self.joint_names, self.joint_names.index(joint)
        return joint, *(names[column] for column, first, _ in self.followers if first == leader)

    def follow(self, q: Array) -> Array:
        """Configurations [..., J] like `q`, with followers where their leaders put them."""
        return follow(q, self.followers)

    @cached_property
    def hand_links(self) -> tuple[str, ...]:
        """Hand links: the palm's link, all links fixed to it and all links beyond."""
        return self.tree.subtree([self.palm_link])

    @cached_property
    def checked_pairs(self) -> tuple[tuple[str, str], ...]:
        """Pairs of links with shapes that must not touch each other."""
        free = self.may_touch | self.tree.neighbours()
        links = [link for link in self.tree.links if self.tree.shapes[link]]
        return tuple(pair for pair in combinations(links, 2) if frozenset(pair) not in free)

    def configuration(self, arm: Array, preshape: Array) -> Array:
        """Whole configurations [..., J] from arm [..., A] and preshape [..., K] joints; followers
        take the place that their leader gives them."""
        arm, preshape = np.asarray(arm, dtype=float), np.asarray(preshape, dtype=float)
        q = np.zeros((*arm.shape[:-1], len(self.joint_names)))
        q = np.clip(q, self.lower, self.upper)  # a joint whose range leaves out 0 rests at its end
        q[..., self.arm] = arm
        q[..., self.preshape_columns] = preshape
        return self.follow(q)


def load_robot(path: Path | str | None = None) -> RobotDescription:
    """The robot of a YAML file, or the bundled one of a name; LBR4 with Allegro hand if None.

    Raises:
        InputError: The file or its URDF cannot be used; the message names the key.
    """
    path = robot_file(path)
    if not path.is_file():
        allowed = "a YAML file beside its URDF, or " + ", ".join(bundled_robots())
        raise InputError("no such robot file", where=path, allowed=allowed)
    return robot_of(read_yaml(path), path)


def robot_digest(path: Path | str | None = None) -> str:
    """SHA-256 of all that describes a robot: its YAML, its URDF and the shapes that this names.

    Raises:
        InputError: As `load_robot`.
    """
    path = robot_file(path)
    robot = load_robot(path)
    digest = hashlib.sha256(read_input(path, "text") + read_input(robot.urdf, "text"))
    for link in robot.tree.links:
        for shape in robot.tree.shapes[link]:
            if shape.vertices is not None:
                digest.update(shape.vertices.tobytes())
    return digest.hexdigest()


def robot_of(data: Any, path: Path) -> RobotDescription:
    """The robot of the contents of a YAML file that is, or will be, at `path`.

    Raises:
        InputError: As `load_robot`.
    """
    keys = RobotKeys(path, data)
    # The YAML's folder may not exist yet; `newdir/../robot.urdf` does.
    urdf = Path(os.path.realpath(path.parent / str(keys.data["urdf"])))
    tree = read_urdf(urdf)
    movable = {joint.name: joint for joint in tree.joints if joint.kind in MOVING}
    arm = keys.names("arm_joints", movable)
    hand = keys.names("hand_joints", movable)
    both = [name for name in hand if name in arm]
    if both:
        raise keys.wrong("hand_joints", f"names {both[0]!r} of the arm", "joints of the hand")
    joints = [movable[name] for name in arm + hand]
    for joint in joints[: len(arm)]:
        if joint.mimic:
            what = f"holds {joint.name!r}, which follows {joint.mimic[0]!r} (<mimic>)"
            raise keys.wrong("arm_joints", what, "joints that move by themselves")
    keys.check_limits(joints)
    lower, upper = _limits_less_margin(keys, joints, len(arm))
    preshape = _preshape_ranges(keys, hand, movable)
    closing = _closing_speeds(keys, hand)
    palm_link, T_link_palm, reach = _palm(keys, tree, hand)
    return RobotDescription(
        name=str(keys.data.get("name", path.stem)),
        urdf=urdf,
        tree=tree,
        T_world_base=keys.pose("mount", keys.data.get("mount", {})),
        arm_joints=arm,
        hand_joints=hand,
        preshape_joints=tuple(preshape),
        preshape_ranges=read_only(np.array(list(preshape.values()))),
        closing_joints=tuple(closing),
        closing_speeds=read_only(np.array(list(closing.values()))),
        palm_link=palm_link,
        T_link_palm=read_only(T_link_palm),
        palm_reach=reach,
        lower=read_only(lower),
        upper=read_only(upper),
        hard_lower=read_only(np.array([joint.lower for joint in joints])),
        hard_upper=read_only(np.array([joint.upper for joint in joints])),
        velocity=read_only(np.array([joint.velocity for joint in joints])),
        effort=read_only(np.array([joint.effort for joint in joints])),
        home=read_only(_home(keys, joints, followers_of(tree, arm + hand), lower, upper)),
        links_on_table=frozenset(keys.links("links_on_table", tree)),
        may_touch=keys.pairs(tree),
    )


def _limits_less_margin(keys: RobotKeys, joints: list[Joint], arm: int) -> tuple[Array, Array]:
    """Lower and upper limits [J] to plan within: revolute joints of the arm keep the margin."""
    margin = keys.number("arm_limit_margin", 0.0, 0.0, 1.0)
    lower = np.array([joint.lower for joint in joints])
    upper = np.array([joint.upper for joint in joints])
    # An angle is no length, and continuous joints have no stops.
    turning = np.array([joint.kind == "revolute" for joint in joints[:arm]])
    lower[:arm] += margin * turning
    upper[:arm] -= margin * turning
    if (lower >= upper).any():
        raise keys.wrong("arm_limit_margin", f"of {margin} leaves no range", "a smaller margin")
    return lower, upper


def _preshape_ranges(
    keys: RobotKeys, hand: tuple[str, ...], movable: Mapping[str, Joint]
) -> dict[str, Array]:
    """Range [2] of each preshape joint, within its limits [rad]."""
    given = keys.mapping("preshape_joints", hand)
    ranges = {name: keys.vector("preshape_joints", given[name], 2) for name in given}
    for name, (low, high) in ranges.items():
        joint = movable[name]
        if not joint.lower - 1e-6 <= low <= high <= joint.upper + 1e-6:
            allowed = f"within its limits [{joint.lower:g}, {joint.upper:g}], lower first"
            raise keys.wrong("preshape_joints", f"gives {name} the range [{low}, {high}]", allowed)
    return ranges


def _closing_speeds(keys: RobotKeys, hand: tuple[str, ...]) -> dict[str, float]:
    """Speed [rad/s] of each closing joint; not 0."""
    given = keys.mapping("closing_joints", hand)
    speeds = {name: float(keys.vector("closing_joints", [given[name]], 1)[0]) for name in given}
    if 0 in speeds.values():
        raise keys.wrong("closing_joints", "has a speed of 0", "speeds in rad/s, not 0")
    return speeds


def _palm(keys: RobotKeys, tree: Tree, hand: tuple[str, ...]) -> tuple[str, Array, float | None]:
    """The palm's link, T_link_palm [4, 4] and reach [m], of a palm that carries all fingers."""
    palm = keys.data["palm"]
    if not isinstance(palm, Mapping) or palm.get("link") not in tree.links:
        raise keys.wrong("palm", "has no such `link`", ", ".join(tree.links))
    if not any(tree.shapes[link] for link in tree.links_moved_by(hand)):
        allowed = "a URDF whose fingers have <collision> geometry, not <visual> alone"
        raise keys.wrong("hand_joints", "move no link with a <collision> shape", allowed)
    pose = keys.pose("palm", palm, ("link", "reach"))
    link, T_link_palm = _carrier(tree, hand, str(palm["link"]), pose)
    for joint in reversed(tree.joints_to_root(link)):
        if joint.name in hand:
            what = f"holds {joint.name!r}, which moves the palm's link {link!r}"
            allowed = "joints beyond the palm; a wrist is one of `arm_joints`"
            raise keys.wrong("hand_joints", what, allowed)
    reach = palm.get("reach")
    return link, T_link_palm, None if reach is None else float(keys.vector("palm", [reach], 1)[0])


def _home(
    keys: RobotKeys, joints: list[Joint], followers: Followers, lower: Array, upper: Array
) -> Array:
    """Waiting configuration [J]: all joints or the arm's as given, the others near 0, or where
    their leaders put them."""
    arm = len(keys.data["arm_joints"])
    home = follow(np.clip(np.zeros(len(lower)), lower, upper), followers)
    if "home" in keys.data:
        given = keys.data["home"]
        count = len(home) if isinstance(given, list) and len(given) > arm else arm
        home[:count] = keys.vector("home", given, count)
    outside = np.flatnonzero((home < lower - 1e-9) | (home > upper + 1e-9))
    if len(outside):
        j = int(outside[0])
        within = "limits less `arm_limit_margin`" if j < arm else "limits"
        allowed = f"{lower[j]:.4g} to {upper[j]:.4g}, its {within}"
        raise keys.wrong("home", f"has {joints[j].name} at {home[j]:.4g}", allowed)
    require_together(home, joints, followers, f"{keys.path}: `home`")
    return home


def _carrier(tree: Tree, hand: tuple[str, ...], link: str, pose: Array) -> tuple[str, Array]:
    """The palm frame in the link from which all fingers branch off.

    Many descriptions end in a link without shape between the fingertips: a palm frame that is
    given there is the same frame, but the fingers are not beyond that link.
    """
    first = {joint.parent for joint in tree.joints if joint.name in hand}
    carrier, T_carrier_palm = link, pose
    while not first <= set(tree.subtree([carrier])):
        joint = tree.parent_joint[carrier]
        if joint.kind != "fixed":
            return link, pose
        carrier, T_carrier_palm = joint.parent, joint.T_parent_joint @ T_carrier_palm
    return carrier, T_carrier_palm
