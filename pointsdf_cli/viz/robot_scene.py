"""The robot, its table and its frames as parts of a scene."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.viz.robot_picture import RobotMeshes
from pointsdf_cli.viz.scene import Part
from pointsdf_cli.viz.shading import table_mesh


class MovingRobot(RobotMeshes):
    """The links of a robot as the first bodies of a scene.

    Args:
        robot: The robot.

    Attributes:
        bodies: Names of all links.
        parts: Their shapes.
    """

    def __init__(self, robot: RobotDescription) -> None:
        super().__init__(robot, sections=24)
        self.bodies = robot.tree.links
        self.parts = tuple(
            Part(self.bodies[i], "robot", "mesh", vertices, faces, colour, i)
            for i, vertices, faces, colour in self.shapes
        )

    def poses(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Poses [F, L, 4, 4] of all links in the world at configurations [F, J]; NaN where q is."""
        poses = self.link_poses(q)
        # Show all links or none: half a robot would mislead.
        poses[~np.isfinite(poses).all(axis=(1, 2, 3))] = np.nan
        return poses


def table_part() -> Part:
    """The table top."""
    table = table_mesh()
    return Part("table", "table", "mesh", table.vertices, table.faces, table.colour)
