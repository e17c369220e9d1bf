"""The robot, its table and its frames as parts of a scene."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.kinematics import Kinematics, homogeneous
from pointsdf_cli.viz.robot_picture import coloured_shapes
from pointsdf_cli.viz.scene import Part
from pointsdf_cli.viz.shading import table_mesh


class MovingRobot:
    """The links of a robot as the first bodies of a scene.

    Args:
        robot: The robot.

    Attributes:
        bodies: Names of all links.
        parts: Their shapes.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self._kinematics = Kinematics(robot)
        self.bodies = robot.tree.links
        self.parts = tuple(
            Part(self.bodies[i], "robot", "mesh", v.astype(np.float32), f.astype(np.int32), c, i)
            for i, v, f, c in coloured_shapes(robot, sections=24)
        )

    def poses(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Poses [F, L, 4, 4] of all links in the world at configurations [F, J]; NaN where q is."""
        rotation, position = self._kinematics(np.asarray(q, dtype=np.float64))
        poses: NDArray[np.float64] = homogeneous(rotation, position).numpy()
        # Show all links or none: half a robot would mislead.
        poses[~np.isfinite(poses).all(axis=(1, 2, 3))] = np.nan
        return poses


def table_part() -> Part:
    """The table top."""
    table = table_mesh()
    vertices, faces = table.vertices.astype(np.float32), table.faces.astype(np.int32)
    return Part("table", "table", "mesh", vertices, faces, table.colour)
