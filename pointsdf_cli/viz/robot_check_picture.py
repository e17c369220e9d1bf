"""Picture of a robot's description: frames, closing motion, surface samples."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import trimesh
from numpy.typing import NDArray

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.robot.closing import Closing, closing_of, open_hand
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.robot.surface import robot_surface
from pointsdf_cli.viz.robot_picture import RobotMeshes
from pointsdf_cli.viz.robot_scene import MovingRobot, table_part
from pointsdf_cli.viz.scene import AXES, Part, Scene, axes
from pointsdf_cli.viz.shading import Painted, Stage, dots, look_at, table_mesh

PATH_COLOUR, SAMPLE_COLOUR = (0.95, 0.65, 0.05), (1.0, 0.55, 0.25)


def check_picture(robot: RobotDescription, size: int = 620) -> NDArray[np.uint8]:
    """Three pictures side by side [size, 3·size, 3].

    The robot at home on its table with the base's and the palm's frames; the opened hand with the
    palm's frame (x red, out of the palm; z blue) and the paths of the closing fingertips; the
    surface samples.
    """
    closing, q = closing_of(robot), open_hand(robot)
    meshes, palm = RobotMeshes(robot), _palm(robot, q)
    drawn, only = meshes.at(q), meshes.at(q, hand_only=True)
    middle, extent = _middle(np.concatenate([part.vertices for part in drawn]))
    whole = look_at(middle + 1.5 * extent * np.array([0.62, -0.68, 0.4]), middle)
    frames = [*_frame(robot.T_world_base, 0.15), *_frame(palm, 0.15)]
    hand, links = _hand(robot, meshes.link_poses(q))
    centre, scale = _middle(hand)
    side = palm[:3, :3] @ np.array([0.75, 0.35, 0.56]) + [0, 0, 0.25]
    close = look_at(centre + 1.9 * scale * side / np.linalg.norm(side), centre, palm[:3, 2])
    ways = _ways(closing, palm)
    square = (size, size)
    pictures = [
        Stage([*drawn, table_mesh(), *frames]).image(whole, square),
        Stage([*only, *_frame(palm, 0.4 * scale), *ways]).image(close, square),
        Stage([*only, dots(links, 0.0065 * scale, SAMPLE_COLOUR)]).image(close, square),
    ]
    return np.concatenate(pictures, axis=1)


def robot_scene(robot: RobotDescription, name: str) -> Scene:
    """The robot at home, closing its hand frame by frame, with frames and samples as layers."""
    closing = closing_of(robot)
    moving = MovingRobot(robot)
    parts = [*moving.parts, table_part(), axes("world", "axes", 0.2)]
    parts.append(axes("palm", "palm", 0.12, len(moving.bodies)))
    for k, tip in enumerate(closing.tips):
        way = np.repeat(closing.paths[:, k], 2, axis=0)[1:-1]
        body = len(moving.bodies)
        parts.append(Part(tip, "fingertip paths", "lines", way, None, PATH_COLOUR, body))
    for link, points in robot_surface(robot).items():
        body = moving.bodies.index(link)
        parts.append(Part(link, "samples", "points", points, None, SAMPLE_COLOUR, body))
    palm = _palm(robot, closing.q)[:, None]
    poses = np.concatenate([moving.poses(closing.q), palm], axis=1)
    share = np.linspace(0, 100, len(closing.q))
    facts = (
        ("robot", robot.name),
        ("joints", f"{len(robot.arm_joints)} of the arm, {len(robot.hand_joints)} of the hand"),
        ("fingertips", ", ".join(closing.tips)),
    )
    captions = tuple(f"{value:.0f} % closed" for value in share)
    bodies = (*moving.bodies, "palm frame")
    return Scene(name, tuple(parts), bodies, poses, captions, "closing", 12.0, facts)


def _palm(robot: RobotDescription, q: Array) -> Array:
    """T_world_palm [..., 4, 4] at configurations [..., J]."""
    return np.asarray(Kinematics(robot).palm(q).numpy())


def _hand(robot: RobotDescription, poses: Array) -> tuple[Array, Array]:
    """Corners of the hand's shapes, and its surface samples, with all links at poses [L, 4, 4]."""
    surface = robot_surface(robot)
    corners, samples = [], []
    for link in robot.hand_links:
        pose = poses[robot.tree.links.index(link)]
        for shape in robot.tree.shapes[link]:
            corners.append(apply_transform(pose, shape.triangulated()[0]))
        if link in surface:
            samples.append(apply_transform(pose, surface[link]))
    return np.concatenate(corners), np.concatenate(samples)


def _middle(points: Array) -> tuple[Array, float]:
    """Middle [3] and diagonal [m] of the box around points [N, 3]."""
    low, high = points.min(axis=0), points.max(axis=0)
    return (low + high) / 2, float(np.linalg.norm(high - low))


def _frame(pose: Array, length: float) -> list[Painted]:
    """Three rods along the axes."""
    ends = pose[:3, 3] + length * pose[:3, :3].T
    return [_rod(pose[:3, 3], end, length / 35, AXES[k]) for k, end in enumerate(ends)]


def _ways(closing: Closing, palm: Array) -> list[Painted]:
    """Paths of the fingertips as rods from step to step, with a ball at their ends."""
    parts = []
    for k in range(len(closing.tips)):
        way = apply_transform(palm, closing.paths[:, k])
        for a, b in pairwise(way):
            if np.linalg.norm(b - a) > 1e-6:
                parts.append(_rod(a, b, 0.0012, PATH_COLOUR))
        ball = trimesh.creation.icosphere(subdivisions=1, radius=0.004)
        end = np.asarray(ball.vertices) + way[-1]
        parts.append(Painted(end, np.asarray(ball.faces), PATH_COLOUR, unlit=True))
    return parts


def _rod(a: Array, b: Array, radius: float, colour: tuple[float, float, float]) -> Painted:
    mesh = trimesh.creation.cylinder(radius, segment=np.stack([a, b]), sections=10)
    return Painted(np.asarray(mesh.vertices), np.asarray(mesh.faces), colour, unlit=True)
