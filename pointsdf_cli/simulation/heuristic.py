"""Preshapes around the faces of a partial cloud's bounding box (Lu et al. 2020).

Only the partial cloud and the positions of camera and robot are used, as on the real robot.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pointsdf_cli.choices import SIDE, TOP
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import apply_transform, invert_transform, transform
from pointsdf_cli.robot.arm_chain import ArmChain
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.jaws import Jaws, jaws_of
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.robot.surface import robot_surface
from pointsdf_cli.simulation.faces import Box, Face, graspable_faces, upright_box
from pointsdf_cli.simulation.jaw_palms import jaw_palm, small_rotation, snug_box

TOP_STANDOFF = 0.035
"""Distance from the face to the palm [m]."""
LOW_OBJECT = 0.03
"""Height [m] below which an object is grasped from the top only, by a hand raised until it clears
the table and the object: otherwise a thumb of 0.145 m that points down would be in the table in
every attempt."""
TABLE_GAP = 0.005
"""Clearance [m] below the opened hand whenever the palm is raised (side grasps, and low
objects)."""


@dataclass(frozen=True)
class HeuristicConfig:
    """Numbers of the heuristic planner.

    Attributes:
        side_standoff: Distance from the face to the palm [m].
        standoff_noise: Standard deviation of that distance [m].
        position_noise: Standard deviation of the position along the face [m].
        turn_noise: Standard deviation of the orientation, about each axis [rad].
        finger_reach: Distance along the fingers from the palm's origin to the object's centre [m]:
            between fingers and thumb, not at the fingers' roots. A hand's own `palm: {reach: …}`
            takes precedence.
    """

    side_standoff: float = 0.03
    standoff_noise: float = 0.03
    position_noise: float = 0.005
    turn_noise: float = 0.005
    finger_reach: float = 0.02


@dataclass(frozen=True)
class Preshape:
    """Desired palm pose and hand opening.

    Attributes:
        kind: "side" or "top".
        T_world_palm: [4, 4].
        joints: [K], the robot's preshape joints.
    """

    kind: str
    T_world_palm: Array
    joints: Array


@dataclass(frozen=True)
class Hand:
    """Properties of a hand for the heuristic.

    Attributes:
        ranges: [K, 2], of the preshape joints.
        outline: Points [P, 3] of the hand opened with preshape joints [K], palm frame, m.
        reach: Replaces `HeuristicConfig.finger_reach`, if the robot's description has its own.
        jaws: The space between its jaws, of a hand that pinches.
    """

    ranges: Array
    outline: Callable[[Array], Array]
    reach: float | None = None
    jaws: Jaws | None = None


def hand_of(robot: RobotDescription) -> Hand:
    """The hand of a robot, its outline from the surface points of its links."""
    kinematics, chain = Kinematics(robot), ArmChain(robot)
    surface = robot_surface(robot)
    links = [(link, surface[link]) for link in robot.hand_links if link in surface]

    def outline(joints: Array) -> Array:
        q = robot.configuration(robot.home[robot.arm], joints)
        points = np.concatenate(kinematics.points(q, links))
        return apply_transform(invert_transform(chain.palm(q)), points)

    return Hand(robot.preshape_ranges, outline, robot.palm_reach, jaws_of(robot))


def draw_preshape(
    points: Array,
    camera: Array,
    base: Array,
    hand: Hand,
    config: HeuristicConfig,
    rng: np.random.Generator,
    kind: str | None = None,
) -> Preshape:
    """Draw a random preshape for a cloud.

    Args:
        points: [N, 3], the object's partial cloud, world.
        camera, base: [3], positions of the camera and of the robot's base, world.
        hand: Ranges and outline of the hand.
        config: Stand-offs and noise.
        rng: Random generator.
        kind: "side" or "top"; any face if None.
    """
    if hand.reach is not None:
        config = replace(config, finger_reach=hand.reach)
    box = upright_box(points) if hand.jaws is None else snug_box(points)
    faces = graspable_faces(box, camera, base, LOW_OBJECT)
    wanted = [face for face in faces if kind in (None, face.kind)] or faces
    if hand.jaws is not None:
        face, palm = jaw_palm(box, wanted, hand.jaws, hand.reach or 0.0, _away(box, camera), rng)
    else:
        face = wanted[int(rng.integers(len(wanted)))]
        if face.kind == TOP:
            palm = _top_palm(box, face, base, config, rng)
        else:
            palm = _side_palm(face, config, rng)
    joints = rng.uniform(hand.ranges[:, 0], hand.ranges[:, 1])
    outline = apply_transform(palm, hand.outline(joints))
    if face.kind == SIDE or hand.jaws is not None:
        palm[2, 3] += max(0.0, TABLE_GAP - float(outline[:, 2].min()))
    elif 2 * box.half[2] < LOW_OBJECT:
        palm[2, 3] += _to_clear(outline, box, TABLE_GAP)
    return Preshape(face.kind, palm, joints)


def _to_clear(outline: Array, box: Box, gap: float) -> float:
    """Height by which a hand with points [P, 3] must rise to clear table and box by `gap`."""
    aside = np.abs((outline - box.centre) @ box.axes[:2].T)
    over = (aside <= box.half[:2]).all(axis=1)
    ground = np.where(over, box.centre[2] + box.half[2], 0.0)
    return max(0.0, float((ground + gap - outline[:, 2]).max()))


def _away(box: Box, camera: Array) -> Array:
    """The horizontal direction [3] from the camera to the box, unit."""
    level = (box.centre - camera) * [1.0, 1.0, 0.0]
    return level / max(float(np.linalg.norm(level)), 1e-9)


def _top_palm(
    box: Box, face: Face, base: Array, config: HeuristicConfig, rng: np.random.Generator
) -> Array:
    """Palm pose from above, fingers along a diagonal of the box away from the robot."""
    diagonals = [a * box.axes[0] + b * box.axes[1] for a in (1, -1) for b in (1, -1)]
    away = face.centre - base
    outward = sorted(diagonals, key=lambda d: -float(d[:2] @ away[:2]))[:2]
    fingers = outward[int(rng.integers(2))] / np.sqrt(2)
    inward = -face.normal
    rotation = np.stack([inward, np.cross(fingers, inward), fingers], axis=1)
    return _noisy(face, rotation, TOP_STANDOFF, config, rng)


def _side_palm(face: Face, config: HeuristicConfig, rng: np.random.Generator) -> Array:
    """Palm pose towards the face, thumb up."""
    inward, up = -face.normal, np.array([0.0, 0.0, 1.0])
    rotation = np.stack([inward, up, np.cross(inward, up)], axis=1)
    return _noisy(face, rotation, config.side_standoff, config, rng)


def _noisy(
    face: Face, rotation: Array, standoff: float, config: HeuristicConfig, rng: np.random.Generator
) -> Array:
    """Palm pose at its stand-off from a face, with noise on distance, position and orientation."""
    distance = max(0.0, standoff + config.standoff_noise * rng.standard_normal())
    place = config.position_noise * rng.standard_normal(3)
    place[0] = 0.0  # the stand-off has its own
    turn = config.turn_noise * rng.standard_normal(3)
    local = np.array([-distance, 0.0, -config.finger_reach]) + place
    position = face.centre + rotation @ local
    return transform(rotation @ small_rotation(turn), position)
