"""Description of a robot for grasping: a YAML file beside its URDF. Another robot needs no code."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.assets import asset_path
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import rotation_from_wxyz, transform
from pointsdf_cli.io.input_files import read_input
from pointsdf_cli.io.untrusted import read_yaml
from pointsdf_cli.robot.urdf import MOVING, Joint, Tree, read_urdf

BUNDLED = "robots/lbr4_allegro.yaml"
REQUIRED = ("urdf", "arm_joints", "hand_joints", "preshape_joints", "closing_joints", "palm")
OPTIONAL = ("name", "mount", "links_on_table", "arm_limit_margin", "home", "may_touch")


@dataclass(frozen=True)
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

    @property
    def arm(self) -> slice:
        """The arm's part of q."""
        return slice(0, len(self.arm_joints))

    @cached_property
    def preshape_columns(self) -> NDArray[np.int64]:
        """Columns of the preshape joints in q."""
        return np.array([self.joint_names.index(name) for name in self.preshape_joints])

    @cached_property
    def closing_columns(self) -> NDArray[np.int64]:
        """Columns of the closing joints in q."""
        return np.array([self.joint_names.index(name) for name in self.closing_joints])

    @cached_property
    def hand_links(self) -> tuple[str, ...]:
        """Hand links: the palm's link, all links fixed to it and all links beyond."""
        inside = {self.palm_link}
        for joint in self.tree.joints:
            if joint.parent in inside:
                inside.add(joint.child)
        return tuple(link for link in self.tree.links if link in inside)

    @cached_property
    def checked_pairs(self) -> tuple[tuple[str, str], ...]:
        """Pairs of links with shapes that must not touch each other."""
        free = self.may_touch | self.tree.neighbours()
        links = [link for link in self.tree.links if self.tree.shapes[link]]
        return tuple(
            (a, b)
            for i, a in enumerate(links)
            for b in links[i + 1 :]
            if frozenset((a, b)) not in free
        )

    def configuration(self, arm: Array, preshape: Array) -> Array:
        """Whole configurations [..., J] from arm [..., A] and preshape [..., K] joints."""
        arm, preshape = np.asarray(arm, dtype=float), np.asarray(preshape, dtype=float)
        q = np.zeros((*arm.shape[:-1], len(self.joint_names)))
        q = np.clip(q, self.lower, self.upper)  # a joint whose range leaves out 0 rests at its end
        q[..., self.arm] = arm
        q[..., self.preshape_columns] = preshape
        return q


def load_robot(path: Path | str | None = None) -> RobotDescription:
    """The robot of a YAML file; without a path, the bundled LBR4 with Allegro hand.

    Raises:
        InputError: The file or its URDF cannot be used; the message names the key.
    """
    path = asset_path(BUNDLED) if path is None else Path(path)
    if not path.is_file():
        raise InputError("no such robot file", where=path, allowed="a YAML file beside its URDF")
    return robot_of(read_yaml(path), path)


def robot_digest(path: Path | str | None = None) -> str:
    """SHA-256 of all that describes a robot: its YAML, its URDF and the shapes that this names.

    Raises:
        InputError: As `load_robot`.
    """
    path = asset_path(BUNDLED) if path is None else Path(path)
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
    return _Reader(path, data).robot()


class _Reader:
    """Turns the YAML mapping into a description, or into an error that names the key."""

    def __init__(self, path: Path, data: Any) -> None:
        self.path = path
        if not isinstance(data, Mapping):
            raise InputError("is no mapping of keys", where=path, allowed=", ".join(REQUIRED))
        self.data = data
        missing = [key for key in REQUIRED if key not in data]
        if missing:
            raise InputError(
                f"lacks {', '.join(missing)}", where=path, allowed=f"needed: {', '.join(REQUIRED)}"
            )
        unknown = [str(key) for key in data if key not in REQUIRED + OPTIONAL]
        if unknown:
            raise self.wrong(unknown[0], "is no key", ", ".join(REQUIRED + OPTIONAL))

    def wrong(self, key: str, what: str, allowed: str) -> InputError:
        return InputError(f"`{key}` {what}", where=self.path, allowed=allowed)

    def robot(self) -> RobotDescription:
        # The YAML's folder may not exist yet; `newdir/../robot.urdf` does.
        urdf = Path(os.path.realpath(self.path.parent / str(self.data["urdf"])))
        tree = read_urdf(urdf)
        movable = {joint.name: joint for joint in tree.joints if joint.kind in MOVING}
        arm = self.names("arm_joints", movable)
        hand = self.names("hand_joints", movable)
        both = [name for name in hand if name in arm]
        if both:
            raise self.wrong("hand_joints", f"names {both[0]!r} of the arm", "joints of the hand")
        joints = [movable[name] for name in arm + hand]
        hard_lower = np.array([joint.lower for joint in joints])
        hard_upper = np.array([joint.upper for joint in joints])
        velocity = np.array([joint.velocity for joint in joints])
        effort = np.array([joint.effort for joint in joints])
        self.check_limits(joints)
        margin = self.number("arm_limit_margin", 0.0, 0.0, 1.0)
        lower, upper = hard_lower.copy(), hard_upper.copy()
        # An angle is no length: sliding joints may go to their ends.
        turning = np.array([movable[name].kind != "prismatic" for name in arm])
        lower[: len(arm)] += margin * turning
        upper[: len(arm)] -= margin * turning
        if (lower >= upper).any():
            raise self.wrong("arm_limit_margin", f"of {margin} leaves no range", "a smaller margin")
        preshape = self.mapping("preshape_joints", hand)
        ranges = np.array([self.vector("preshape_joints", r, 2) for r in preshape.values()])
        for name, (low, high) in zip(preshape, ranges, strict=True):
            joint = movable[name]
            if not joint.lower - 1e-6 <= low <= high <= joint.upper + 1e-6:
                raise self.wrong(
                    "preshape_joints",
                    f"gives {name} the range [{low}, {high}]",
                    f"within its limits [{joint.lower:g}, {joint.upper:g}], lower first",
                )
        closing = self.mapping("closing_joints", hand)
        speeds = np.array([self.vector("closing_joints", [s], 1)[0] for s in closing.values()])
        if (speeds == 0).any():
            raise self.wrong("closing_joints", "has a speed of 0", "speeds in rad/s, not 0")
        palm = self.data["palm"]
        if not isinstance(palm, Mapping) or palm.get("link") not in tree.links:
            raise self.wrong("palm", "has no such `link`", ", ".join(tree.links))
        reach = palm.get("reach")
        moved = {link for link in tree.links if tree.shapes[link]} & tree.beyond(hand)
        if not moved:
            raise self.wrong(
                "hand_joints",
                "move no link with a <collision> shape",
                "a URDF whose fingers have <collision> geometry, not <visual> alone",
            )
        palm_link, T_link_palm = _carrier(
            tree, hand, str(palm["link"]), self.pose("palm", palm, ("link", "reach"))
        )
        above = tree.way_up(palm_link)
        for joint in tree.joints:
            if joint.name in hand and joint.child in above:
                raise self.wrong(
                    "hand_joints",
                    f"holds {joint.name!r}, which moves the palm's link {palm_link!r}",
                    "joints beyond the palm; a wrist is one of `arm_joints`",
                )
        home = np.clip(np.zeros(len(joints)), lower, upper)
        if "home" in self.data:
            given = self.data["home"]
            count = len(joints) if isinstance(given, list) and len(given) > len(arm) else len(arm)
            home[:count] = self.vector("home", given, count)
        if ((home < lower - 1e-9) | (home > upper + 1e-9)).any():
            raise self.wrong("home", "is outside the joint limits", "within arm limits less margin")
        return RobotDescription(
            name=str(self.data.get("name", self.path.stem)),
            urdf=urdf,
            tree=tree,
            T_world_base=self.pose("mount", self.data.get("mount", {})),
            arm_joints=arm,
            hand_joints=hand,
            preshape_joints=tuple(preshape),
            preshape_ranges=_read_only(ranges),
            closing_joints=tuple(closing),
            closing_speeds=_read_only(speeds),
            palm_link=palm_link,
            T_link_palm=_read_only(T_link_palm),
            palm_reach=None if reach is None else float(self.vector("palm", [reach], 1)[0]),
            lower=_read_only(lower),
            upper=_read_only(upper),
            hard_lower=_read_only(hard_lower),
            hard_upper=_read_only(hard_upper),
            velocity=_read_only(velocity),
            effort=_read_only(effort),
            home=_read_only(home),
            links_on_table=frozenset(self.links("links_on_table", tree)),
            may_touch=self.pairs(tree),
        )

    def names(self, key: str, known: Mapping[str, Joint]) -> tuple[str, ...]:
        names = self.data[key]
        if not isinstance(names, list) or not names:
            raise self.wrong(key, "is no list of joints", ", ".join(known))
        for name in names:
            if not isinstance(name, str) or name not in known:
                raise self.wrong(key, f"names {name!r}", "moving joints: " + ", ".join(known))
        if len(set(names)) != len(names):
            raise self.wrong(key, "names a joint twice", "each joint once")
        return tuple(names)

    def check_limits(self, joints: list[Joint]) -> None:
        for joint in joints:
            if joint.lower >= joint.upper or joint.velocity <= 0 or joint.effort <= 0:
                raise InputError(
                    f"joint {joint.name!r} has lower {joint.lower:g}, upper {joint.upper:g}, "
                    f"velocity {joint.velocity:g}, effort {joint.effort:g}",
                    where=self.path.parent / str(self.data["urdf"]),
                    allowed="lower below upper, velocity and effort above 0",
                )

    def mapping(self, key: str, hand: tuple[str, ...]) -> dict[str, Any]:
        value = self.data[key]
        if not isinstance(value, Mapping) or not value:
            raise self.wrong(key, "is no mapping of joints", ", ".join(hand))
        for name in value:
            if name not in hand:
                raise self.wrong(key, f"names {name!r}", "hand joints: " + ", ".join(hand))
        return dict(value)

    def vector(self, key: str, value: Any, count: int) -> Array:
        try:
            numbers = np.array([float(v) for v in value])
        except (TypeError, ValueError):
            numbers = np.empty(0)
        if len(numbers) != count or not np.isfinite(numbers).all():
            raise self.wrong(key, f"holds {value!r}", f"{count} finite number(s)")
        return numbers

    def number(self, key: str, default: float, low: float, high: float) -> float:
        value = float(self.vector(key, [self.data.get(key, default)], 1)[0])
        if not low <= value <= high:
            raise self.wrong(key, f"is {value}", f"{low:g} to {high:g}")
        return value

    def pose(self, key: str, value: Any, beside: tuple[str, ...] = ()) -> Array:
        if not isinstance(value, Mapping):
            raise self.wrong(key, f"is {value!r}", "{xyz: [x, y, z], wxyz: [w, x, y, z]}")
        known = ("xyz", "wxyz", *beside)
        unknown = [one for one in value if one not in known]
        if unknown:
            raise self.wrong(key, f"has {unknown[0]!r}, which is no key", ", ".join(known))
        wxyz = self.vector(key, value.get("wxyz", [1, 0, 0, 0]), 4)
        if abs(np.linalg.norm(wxyz) - 1) > 1e-3:
            raise self.wrong(key, f"has wxyz {wxyz.tolist()}", "a unit quaternion, w first")
        xyz = self.vector(key, value.get("xyz", [0, 0, 0]), 3)
        return _read_only(transform(rotation_from_wxyz(wxyz), xyz))

    def links(self, key: str, tree: Tree) -> list[str]:
        value = self.data.get(key) or []
        if not isinstance(value, list):
            raise self.wrong(key, f"is {value!r}", "a list of links")
        for link in value:
            if link not in tree.links:
                raise self.wrong(key, f"names {link!r}", ", ".join(tree.links))
        return list(value)

    def pairs(self, tree: Tree) -> frozenset[frozenset[str]]:
        pairs = set()
        value = self.data.get("may_touch") or []
        if not isinstance(value, list):
            raise self.wrong("may_touch", f"is {value!r}", "a list of pairs of links")
        for pair in value:
            if (
                not isinstance(pair, list)
                or not all(isinstance(link, str) for link in pair)
                or len(set(pair)) != 2
                or not set(pair) <= set(tree.links)
            ):
                raise self.wrong("may_touch", f"holds {pair!r}", "pairs of two different links")
            pairs.add(frozenset(pair))
        return frozenset(pairs)


def _carrier(tree: Tree, hand: tuple[str, ...], link: str, pose: Array) -> tuple[str, Array]:
    """The palm frame in the link from which all fingers branch off.

    Many descriptions end in a link without shape between the fingertips: a palm frame that is
    given there is the same frame, but the fingers are not beyond that link.
    """
    above = {joint.child: joint for joint in tree.joints}
    first = {joint.parent for joint in tree.joints if joint.name in hand}
    shared = set.intersection(*(set(tree.way_up(parent)) for parent in first | {link}))
    carrier, T_carrier_palm = link, pose
    while carrier not in shared:
        joint = above[carrier]
        if joint.kind != "fixed":
            return link, pose
        carrier, T_carrier_palm = joint.parent, joint.T_parent_joint @ T_carrier_palm
    return carrier, T_carrier_palm


def _read_only(array: Array) -> Array:
    array.flags.writeable = False
    return array
