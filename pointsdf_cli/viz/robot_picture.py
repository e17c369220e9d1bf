"""The robot as painted meshes, and a picture of it in several poses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.kinematics import Kinematics, homogeneous
from pointsdf_cli.viz.shading import Painted, look_at, shaded_image, table_mesh

ARM_COLOURS = ((0.93, 0.53, 0.20), (0.72, 0.74, 0.76))
HAND_COLOUR = (0.30, 0.33, 0.40)
TIP_COLOUR = (0.95, 0.93, 0.86)

ColouredShape = tuple[int, NDArray[np.float64], NDArray[np.int64], tuple[float, float, float]]


def coloured_shapes(robot: RobotDescription, sections: int) -> Iterator[ColouredShape]:
    """Shapes of all links: index of the link, vertices [V, 3], faces [F, 3] and colour; cylinders
    have `sections` facets."""
    hand = set(robot.hand_links)
    for i, link in enumerate(robot.tree.links):
        for shape in robot.tree.shapes[link]:
            colour = ARM_COLOURS[i % 2]
            if link in hand:
                colour = TIP_COLOUR if shape.kind == "sphere" else HAND_COLOUR
            yield i, *shape.triangulated(sections), colour


class RobotMeshes:
    """The robot's shapes as meshes, to be painted at any configuration.

    Args:
        robot: The robot.
        sections: Facets of a cylinder.
    """

    def __init__(self, robot: RobotDescription, sections: int = 40) -> None:
        self._kinematics = Kinematics(robot)
        self._parts = list(coloured_shapes(robot, sections))
        self._hand = {i for i, link in enumerate(robot.tree.links) if link in robot.hand_links}

    def at(self, q: NDArray[np.float64], hand_only: bool = False) -> list[Painted]:
        """The robot, or its hand alone, at one configuration [J], in the world."""
        poses = homogeneous(*self._kinematics(q)).numpy()
        return [
            Painted(apply_transform(poses[link], vertices), faces, colour)
            for link, vertices, faces, colour in self._parts
            if not hand_only or link in self._hand
        ]


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
        shaded_image([*meshes.at(q), table_mesh(), *things], camera, (height, height))
        for q in poses
    ]
    return np.concatenate(pictures, axis=1)
