"""The robot as painted meshes, and a picture of it in several poses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.kinematics import Kinematics, homogeneous
from pointsdf_cli.viz.shading import Painted, Stage, look_at, table_mesh

ARM_COLOURS = ((0.93, 0.53, 0.20), (0.72, 0.74, 0.76))
HAND_COLOUR = (0.30, 0.33, 0.40)
TIP_COLOUR = (0.95, 0.93, 0.86)

ColouredShape = tuple[int, NDArray[np.float64], NDArray[np.int64], tuple[float, float, float]]


class RobotMeshes:
    """The robot's shapes as meshes, to be painted at any configuration.

    Args:
        robot: The robot.
        sections: Facets of a cylinder.

    Attributes:
        shapes: Shapes of all links: index of the link, vertices [V, 3] in its frame, m, faces
            [F, 3] and colour.
    """

    def __init__(self, robot: RobotDescription, sections: int = 40) -> None:
        self._kinematics = Kinematics(robot)
        self._hand = {i for i, link in enumerate(robot.tree.links) if link in robot.hand_links}
        self.shapes: list[ColouredShape] = [
            (i, *shape.triangulated(sections), self._colour(i, shape.kind))
            for i, link in enumerate(robot.tree.links)
            for shape in robot.tree.shapes[link]
        ]

    def link_poses(self, q: ArrayLike) -> NDArray[np.float64]:
        """Poses [..., L, 4, 4] of all links in the world at configurations [..., J]."""
        links = self._kinematics(np.asarray(q, dtype=np.float64))
        return np.asarray(homogeneous(*links).numpy())

    def at(self, q: NDArray[np.float64], hand_only: bool = False) -> list[Painted]:
        """The robot, or its hand alone, at one configuration [J], in the world."""
        poses = self.link_poses(q)
        return [
            Painted(apply_transform(poses[link], vertices), faces, colour)
            for link, vertices, faces, colour in self.shapes
            if not hand_only or link in self._hand
        ]

    def _colour(self, link: int, kind: str) -> tuple[float, float, float]:
        if link not in self._hand:
            return ARM_COLOURS[link % 2]
        return TIP_COLOUR if kind == "sphere" else HAND_COLOUR


def robot_poses_picture(
    robot: RobotDescription,
    poses: Sequence[NDArray[np.float64]],
    height: int = 520,
    things: Sequence[Painted] = (),
) -> NDArray[np.uint8]:
    """Draw the robot on its table at several configurations [J], side by side, with other
    meshes."""
    meshes = RobotMeshes(robot)
    camera = look_at((1.9, -2.0, 1.25), (0.25, 0.0, 0.55))
    pictures = [
        Stage([*meshes.at(q), table_mesh(), *things]).image(camera, (height, height)) for q in poses
    ]
    return np.concatenate(pictures, axis=1)
