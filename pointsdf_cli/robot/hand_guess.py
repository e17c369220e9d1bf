"""Guesses about a hand from its geometry alone: its closing direction and its palm."""

from __future__ import annotations

import numpy as np

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.robot.closing import fingertips
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.robot.surface import robot_surface

CLOSES = 0.005
"""A joint that moves its fingertip nearer by less than this [m] over its range does not close."""
OPEN_SHARE = 0.15
"""Preshapes are drawn from this part of a joint's range, next to its open end."""
PAST_FACE = 0.045
"""From the palm frame's origin to the fingertips of a gripper [m], as in the bundled ones."""
SECONDS = 1.0
"""Closing takes about this long on the real robot [s], within the URDF's velocity limits."""
PARALLEL = 0.7
"""A joint closes if the cosine between its axis and the finger's best closing joint's exceeds
this."""
FASTEST = 0.5
"""Closing joints turn no faster than this on the real robot [rad/s]."""


def closing_speeds(robot: RobotDescription) -> dict[str, float]:
    """The speeds of the hand joints that close, with the sign in which they do.

    Two fingers close towards each other, several towards the palm. In each finger the joint that
    brings its tip nearest closes, as do joints with nearly parallel axes; the others spread or turn
    the finger and belong to the preshape. Followers (`<mimic>`) close as their leader does.
    """
    tips = fingertips(robot)
    rest = robot.home.copy()
    hand = np.arange(len(robot.arm_joints), len(robot.joint_names))
    rest[hand] = (robot.lower[hand] + robot.upper[hand]) / 2
    own = robot_surface(robot).get(robot.palm_link)
    body = np.zeros(3) if own is None else own.mean(axis=0)
    gains: dict[str, float] = {}
    pair = len({_root(robot, tip) for tip in tips}) == 2
    leaders = {column: (leader, ratio) for column, leader, ratio in robot.followers}
    fingers = {
        joint: set(tips) & set(robot.tree.links_moved_by(robot.moved_with(joint)))
        for joint in robot.hand_joints
    }
    for column, joint in zip(hand, robot.hand_joints, strict=True):
        moved = [k for k, tip in enumerate(tips) if tip in fingers[joint]]
        others = [k for k in range(len(tips)) if k not in moved]
        if not moved or column in leaders:
            continue
        q = np.repeat(rest[None], 9, axis=0)
        q[:, column] = np.linspace(robot.lower[column], robot.upper[column], 9)
        paths = _middles(robot, tips, robot.follow(q))
        goal = paths[:, others].mean(axis=1) if pair and others else body
        middle = paths[:, moved].mean(axis=1)
        away = np.linalg.norm(middle - goal, axis=-1)
        if len({_root(robot, tips[k]) for k in moved}) > 1:
            # Fingers coupled with each other: jaws meet, fingers of a fist come to the palm.
            apart = np.linalg.norm(paths[:, moved] - middle[:, None], axis=-1).mean(axis=1)
            away = max(away, apart, key=lambda path: abs(path[-1] - path[0]))
        if abs(away[-1] - away[0]) > 0.7 * np.ptp(away):  # not there and back again
            gains[joint] = float(away[0] - away[-1])
    axes = _axes(robot, rest)
    speeds = {}
    for joint, gain in gains.items():
        finger = [other for other in gains if fingers[other] & fingers[joint]]
        best = max(finger, key=lambda other: abs(gains[other]))
        if abs(gain) > CLOSES and abs(float(axes[joint] @ axes[best])) > PARALLEL:
            k = robot.joint_names.index(joint)
            travel = float(robot.upper[k] - robot.lower[k])
            speed = min(round(min(travel / SECONDS, FASTEST), 3), float(robot.velocity[k]))
            for follower, leader, ratio in robot.followers:
                if leader == k:
                    speed = min(speed, float(robot.velocity[follower]) / abs(ratio))
            speeds[joint] = float(np.copysign(speed, gain))
    names = robot.joint_names
    for follower, (leader, ratio) in leaders.items():
        if names[leader] in speeds:
            speeds[names[follower]] = ratio * speeds[names[leader]]
    return {joint: speeds[joint] for joint in robot.hand_joints if joint in speeds}


def _axes(robot: RobotDescription, q: Array) -> dict[str, Array]:
    """The axes [3] of all joints in the world at a configuration [J]."""
    rotation, _ = Kinematics(robot)(q)
    place = {link: k for k, link in enumerate(robot.tree.links)}
    return {j.name: rotation[place[j.child]].numpy() @ j.axis for j in robot.tree.joints}


def _middles(robot: RobotDescription, links: tuple[str, ...], q: Array) -> Array:
    """Middles [T, F, 3] of links in the frame of the palm's link."""
    surface = robot_surface(robot)
    middles = {link: surface[link].mean(axis=0)[None] for link in links}
    return np.concatenate(_in_palm_link(robot, middles, q), axis=1)


def _in_palm_link(robot: RobotDescription, points: dict[str, Array], q: Array) -> list[Array]:
    """Points [P, 3] of links, in the frame of the palm's link, at configurations q: [T, P, 3]."""
    kinematics = Kinematics(robot)
    rotation, position = kinematics(q)
    at = kinematics.index(robot.palm_link)
    here, turned = position[:, None, at], rotation[:, at]
    return [((p - here) @ turned).numpy() for p in kinematics.points(q, points.items())]


def preshapes(robot: RobotDescription, closing: dict[str, float]) -> dict[str, list[float]]:
    """For each finger its first closing joint, nearly open; followers as their leader is."""
    leaders = {column: (leader, ratio) for column, leader, ratio in robot.followers}
    found = {}
    for joint in robot.tree.joints:
        before = [other.name for other in robot.tree.joints_to_root(joint.parent)]
        if joint.name in closing and not closing.keys() & before:
            column = robot.joint_names.index(joint.name)
            k, ratio = leaders.get(column, (column, 1.0))
            first = robot.joints[k]
            part = OPEN_SHARE * (first.upper - first.lower)
            if closing[first.name] > 0:
                ends = [first.lower, round(first.lower + part, 4)]
            else:
                ends = [round(first.upper - part, 4), first.upper]
            ends = [round(min(max(ratio * end, joint.lower), joint.upper), 9) for end in ends]
            found[joint.name] = sorted(ends)
    return found


def open_home(robot: RobotDescription) -> Array:
    """Configuration with the arm as given and the closing joints at their open ends."""
    q = robot.home.copy()
    columns = robot.closing_columns
    q[columns] = np.where(robot.closing_speeds > 0, robot.lower[columns], robot.upper[columns])
    return robot.follow(q)


def palm_frame(robot: RobotDescription) -> tuple[Array, bool]:
    """The palm frame [4, 4] in its link, and whether the hand is one of jaws.

    Fingers that start to close in one direction form a hand that encloses objects: x is that
    direction, z lies along the fingers. Fingers that move towards each other are jaws: x points to
    where they meet, z from one to the other.
    """
    tips = fingertips(robot)
    q = np.repeat(robot.home[None], 3, axis=0)
    columns = robot.closing_columns
    ends = np.where(robot.closing_speeds > 0, robot.upper[columns], robot.lower[columns])
    q[:, columns] += np.array([[0.0], [0.25], [1.0]]) * (ends - q[0, columns])
    q = robot.follow(q)
    opened, soon, closed = _middles(robot, tips, q)
    together, ways = np.median(soon - opened, axis=0), closed - opened
    # The ways of fingers that close from both sides cancel: 0 is left of two jaws, 0.33 of two
    # fingers against a third (BarrettHand), 0.67 of three and a thumb beside them (Allegro).
    each = float(np.linalg.norm(ways, axis=1).mean())
    few = len({_root(robot, tip) for tip in tips}) <= 2
    jaws = few or float(np.linalg.norm(ways.mean(axis=0))) < 0.5 * each
    surface = robot_surface(robot)
    if jaws:
        x = _unit(closed.mean(axis=0))
        z = _unit(_level(opened[-1] - opened[0], x))
    else:
        x = _unit(together)
        roots = {_root(robot, tip): np.zeros((1, 3)) for tip in tips}
        starts = np.concatenate(_in_palm_link(robot, roots, q[:1]), axis=1)[0]
        along = opened - starts
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
        z = _unit(_level(np.median(along, axis=0), x))
    body = surface.get(robot.palm_link)
    front = 0.0 if body is None else float((body @ x).max())
    origin = front * x
    if jaws:
        # Jaws of a linkage reach farther when they begin to close. Where they meet may lie beside
        # the link's own axis.
        fingers = _in_palm_link(robot, {tip: surface[tip] for tip in tips}, q[:2])
        origin = (max(float((p @ x).max()) for p in fingers) - PAST_FACE) * x
        origin = origin + (closed.mean(axis=0) @ z) * z
    return transform(np.stack([x, np.cross(z, x), z], axis=1), origin), jaws


def _root(robot: RobotDescription, link: str) -> str:
    """The link of a finger that is moved by the finger's first joint."""
    way = reversed(robot.tree.joints_to_root(link))
    return next((joint.child for joint in way if joint.name in robot.hand_joints), link)


def _level(vector: Array, normal: Array) -> Array:
    """Part of a vector [3] perpendicular to `normal`; an arbitrary perpendicular if it vanishes."""
    across = vector - (vector @ normal) * normal
    if np.linalg.norm(across) > 1e-4:
        return np.asarray(across)
    return np.cross(normal, np.eye(3)[int(np.abs(normal).argmin())])


def _unit(vector: Array) -> Array:
    """Unit vector, snapped to an axis of the link if nearly parallel to it."""
    unit = vector / max(float(np.linalg.norm(vector)), 1e-9)
    return np.round(unit) if np.abs(unit).max() > np.cos(0.1) else unit
