"""Obstacles as triangles in the world, for pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.planning.environment import Obstacle
from pointsdf_cli.robot.shapes import Shape


def obstacle_mesh(obstacle: Obstacle) -> tuple[Array, NDArray[np.int64]]:
    """Vertices [V, 3] m in the world and faces [F, 3]."""
    if obstacle.vertices is None or obstacle.faces is None:
        return Shape(obstacle.kind, obstacle.size, obstacle.pose).triangulated()
    vertices = apply_transform(obstacle.pose, obstacle.vertices)
    return vertices, np.asarray(obstacle.faces, dtype=np.int64)
