"""Attempts of a robot's hand with a can."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from pointsdf_cli.io.meshes import LoadedMesh
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.simulation.attempter import Attempter
from pointsdf_cli.simulation.sim_object import prepare_object


def causes_with_a_can(robot: RobotDescription, height: float, folder: Path) -> list[str]:
    """How sixteen attempts of the heuristic end with a can 6 cm wide and `height` m high."""
    mesh = trimesh.creation.cylinder(0.03, height)
    can = LoadedMesh(
        "can", np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32), "can", "none"
    )
    attempter, item = Attempter(robot, seed=1), prepare_object(can, folder)
    try:
        return [attempter.attempt(item, index).cause for index in range(16)]
    finally:
        attempter.close()
