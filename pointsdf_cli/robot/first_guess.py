"""First description of a robot, guessed from its URDF alone, for review.

Which joints are the arm's and which the hand's follows from where the fingers branch off. How each
finger joint closes, the palm frame, a place to wait and the pairs that may touch are measured on
the geometry. `rgrasp robot check` draws the result.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import rotation_from_wxyz, transform, wxyz_from_rotation
from pointsdf_cli.robot.closing import closing_of
from pointsdf_cli.robot.collision import SelfCollision, table_clearance
from pointsdf_cli.robot.description import RobotDescription, robot_of
from pointsdf_cli.robot.hand_guess import closing_speeds, open_home, palm_frame, preshapes
from pointsdf_cli.robot.inverse_kinematics import IkConfig, InverseKinematics
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.robot.urdf import MOVING, Tree, read_urdf

MARGIN = 0.0873
"""5 degrees from the arm's hard stops [rad]."""
CANDIDATES = 24
"""Places to wait that are looked at."""
PLACES = ((0.45, 0.5), (0.4, 0.4), (0.35, 0.6), (0.5, 0.6), (0.3, 0.3))
"""Candidate positions of the waiting palm: in front of the base and above the table [m]."""


def first_guess(urdf: Path, beside: Path, palm: str | None = None) -> dict[str, Any]:
    """The contents of a robot's YAML file.

    Args:
        urdf: The URDF file.
        beside: The YAML file to be; the URDF is named relative to it.
        palm: The link from which the fingers branch off; found if None.

    Raises:
        InputError: The URDF cannot be used, or nothing branches and `palm` is needed.
    """
    tree = read_urdf(urdf)
    palm, arm, hand = _split(tree, urdf, palm)
    first = next(joint for joint in tree.joints if joint.name == hand[0])
    data: dict[str, Any] = {
        "name": beside.stem,
        "urdf": os.path.relpath(urdf, beside.parent),
        "links_on_table": list(tree.fixed_to_root()),
        "arm_joints": arm,
        "arm_limit_margin": MARGIN,
        "hand_joints": hand,
        "preshape_joints": {hand[0]: [first.lower, first.upper]},
        "closing_joints": dict.fromkeys(hand, 1.0),
        "palm": {"link": palm, "xyz": [0, 0, 0], "wxyz": [1, 0, 0, 0]},
    }
    robot = robot_of(data, beside)
    speeds = closing_speeds(robot) or data["closing_joints"]
    ranges = preshapes(robot, speeds)
    robot = replace(
        robot,
        closing_joints=tuple(speeds),
        closing_speeds=np.array(list(speeds.values())),
        preshape_joints=tuple(ranges),
        preshape_ranges=np.array(list(ranges.values())),
    )
    robot = replace(robot, home=open_home(robot))
    frame, jaws = palm_frame(robot)
    wxyz = wxyz_from_rotation(frame[:3, :3])
    placed = {"xyz": _rounded(frame[:3, 3], 4), "wxyz": _rounded(wxyz, 4)}
    robot = replace(robot, T_link_palm=frame, palm_reach=0.0 if jaws else 0.02)
    touching = _always_touching(robot)
    robot = replace(robot, may_touch=frozenset(frozenset(pair) for pair in touching))
    robot = replace(robot, home=_home(robot))
    if jaws:
        touching += _touching_closed(robot)
    return data | {
        "home": _rounded(
            robot.follow(np.array(_rounded_within(robot.home, robot.lower, robot.upper, 3))), 6
        ),
        "preshape_joints": ranges,
        "closing_joints": speeds,
        "palm": {"link": palm, **placed, "reach": robot.palm_reach},
        "may_touch": touching,
    }


def _split(tree: Tree, urdf: Path, palm: str | None) -> tuple[str, list[str], list[str]]:
    """The palm's link, the arm's joints from the root to it, and the joints beyond it."""

    def moved_below(link: str) -> list[str]:
        inside = set(tree.subtree([link]))
        return [j.name for j in tree.joints if j.parent in inside and j.kind in MOVING]

    if palm is None:
        palm = tree.links[0]
        while True:
            ways = [j for j in tree.joints if j.parent == palm]
            ways = [j for j in ways if j.kind in MOVING or moved_below(j.child)]
            if len(ways) != 1:
                break
            palm = ways[0].child
    elif palm not in tree.links:
        raise InputError(f"no link {palm!r}", where=urdf, allowed=", ".join(tree.links))
    hand = moved_below(palm)
    way = [joint.name for joint in reversed(tree.joints_to_root(palm)) if joint.kind in MOVING]
    if not hand or not way:
        what = "no fingers branch off" if not hand else f"no joint leads to {palm!r}"
        raise InputError(
            f"{what}, so that arm and hand cannot be told apart",
            where=urdf,
            allowed="a URDF of an arm with a hand",
            hint="--palm LINK, the link that carries the fingers: one of " + ", ".join(tree.links),
        )
    return palm, way, hand


def _rounded(values: Array, digits: int) -> list[float]:
    return [round(float(v), digits) + 0.0 for v in values]


def _rounded_within(values: Array, low: Array, high: Array, digits: int) -> list[float]:
    """Rounded, but not past limits that themselves have more digits."""
    unit = 10.0**-digits
    least, most = np.ceil(low / unit) * unit, np.floor(high / unit) * unit
    return _rounded(np.clip(np.round(values, digits), least, most), digits)


def _always_touching(robot: RobotDescription) -> list[list[str]]:
    """Pairs that overlap wherever the joints are: their shapes do, not the links."""
    coarse = SelfCollision(Kinematics(robot), 0.02, 0.0)
    q = np.random.default_rng(0).uniform(robot.lower, robot.upper, (32, len(robot.lower)))
    share = (coarse(*Kinematics(robot)(robot.follow(q))).numpy() < 0).mean(axis=0)
    return [list(pair) for pair, often in zip(coarse.pairs, share, strict=True) if often > 0.95]


def _touching_closed(robot: RobotDescription) -> list[list[str]]:
    """Pairs of the hand's links that meet when it closes on nothing."""
    fine = SelfCollision(Kinematics(robot))
    hand = set(robot.hand_links)
    least = fine(*Kinematics(robot)(closing_of(robot).q)).numpy().min(axis=0)
    return [
        list(pair)
        for pair, distance in zip(fine.pairs, least, strict=True)
        if distance < 1e-3 and set(pair) <= hand
    ]


def _home(robot: RobotDescription) -> Array:
    """Configuration [J] with the open hand in front of the base, pointing forwards and down, clear
    of everything.

    The middle of the arm's limits, or 0, where inverse kinematics finds no such place.
    """
    looks = rotation_from_wxyz([np.cos(np.pi / 8), 0, np.sin(np.pi / 8), 0])  # 45 degrees down
    base = robot.T_world_base[:3, 3]
    goals = []
    for forwards, up in PLACES:
        for about in (0.0, np.pi / 2, -np.pi / 2, np.pi):
            turn = rotation_from_wxyz([np.cos(about / 2), np.sin(about / 2), 0, 0])
            goals.append(transform(looks @ turn, [base[0] + forwards, base[1], up]))
    found = InverseKinematics(robot, IkConfig(pool=4000)).solve(np.array(goals))
    # A joint at its middle has room both ways; turns by whole circles look alike but are not.
    middle = (robot.lower + robot.upper)[robot.arm] / 2
    arms = found.arm[found.reached]
    arms = arms[np.argsort(np.abs(arms - middle).sum(axis=1), kind="stable")][:CANDIDATES]
    q = np.repeat(robot.home[None], len(arms) + 2, axis=0)
    q[: len(arms), robot.arm], q[-2, robot.arm] = arms, middle
    q = np.clip(np.round(q, 3), robot.lower, robot.upper)
    kinematics = Kinematics(robot)
    poses = kinematics(q)
    distances = [table_clearance(robot, *poses)[1], SelfCollision(kinematics)(*poses)]
    slack = np.concatenate(distances, axis=1).min(axis=1)
    free = np.flatnonzero(slack > 0.01)
    return q[int(free[0]) if len(free) else int(slack.argmax())]


def as_yaml(data: dict[str, Any]) -> str:
    """Text of the file, with a comment for the reviewer beside each key."""

    def flow(value: Any) -> str:
        text = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10_000)
        return text.removesuffix("\n").removesuffix("\n...")

    def mapping(key: str) -> str:
        return "\n".join(f"  {flow(name)}: {flow(value)}" for name, value in data[key].items())

    return f"""\
# A first guess by `rgrasp robot init`. Units: m, rad, rad/s (prismatic joints: m/s).
# Look at it with `rgrasp robot check`; what each key means: docs/your-robot.md.
name: {flow(data["name"])}
urdf: {flow(data["urdf"])}

# Where the URDF's root link stands in the world. The table top is z = 0 of the world.
mount: {{xyz: [0, 0, 0], wxyz: [1, 0, 0, 0]}}
links_on_table: {flow(data["links_on_table"])}

arm_joints: {flow(data["arm_joints"])}
arm_limit_margin: {data["arm_limit_margin"]}  # plans keep 5 degrees from the hard stops
# Where the robot waits: the arm, then the hand. GUESSED: enter where yours waits.
home: {flow(data["home"])}

hand_joints: {flow(data["hand_joints"])}
# Joints that each grasp sets before the hand closes, and their ranges. GUESSED: each finger's first
# closing joint, nearly open. Add joints that spread or turn fingers; all others stay at 0.
preshape_joints:
{mapping("preshape_joints")}
# What closes, and how fast on the real robot. GUESSED: about a second from open to closed.
# A mimic joint stands here too, at its leader's speed times its multiplier.
closing_joints:
{mapping("closing_joints")}

# GUESSED: x out of the palm, z along the fingers (across the jaws of a gripper), y up when it
# grasps from the side; the origin on the palm's surface, of a gripper 4.5 cm behind its fingertips.
palm: {flow(data["palm"])}

# Pairs of links that may touch, beside neighbours.
may_touch: {flow(data["may_touch"])}
"""
