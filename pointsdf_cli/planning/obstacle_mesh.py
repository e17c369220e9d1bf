"""Obstacles as triangles in the world, for pictures."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.planning.environment import Obstacle


def obstacle_mesh(obstacle: Obstacle) -> tuple[Array, NDArray[np.int64]]:
    """Vertices [V, 3] m in the world and faces [F, 3]."""
    if obstacle.vertices is not None and obstacle.faces is not None:
        vertices, faces = obstacle.vertices, obstacle.faces
    else:
        make = {
            "box": lambda size: trimesh.creation.box(size),
            "cylinder": lambda size: trimesh.creation.cylinder(*size),
            "sphere": lambda size: trimesh.creation.icosphere(radius=size[0]),
        }
        mesh = make[obstacle.kind](obstacle.size)
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    return apply_transform(obstacle.pose, vertices), np.asarray(faces, dtype=np.int64)
