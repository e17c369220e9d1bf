"""Protocols of a success network, which planning asks and `models/grasp_score.py` implements."""

from __future__ import annotations

from typing import Protocol

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.planning.objective import GraspScore
from pointsdf_cli.planning.seeds import GraspSampler


class ObjectGrasps(GraspScore, GraspSampler, Protocol):
    """Score and prior of the grasps of one object (models/grasp_score.py)."""


class SuccessModel(Protocol):
    """Protocol of a loaded success network."""

    def on(
        self, points: Array, T_world_camera: Array, field: Field | None = None, seed: int = 0
    ) -> ObjectGrasps:
        """The score of one object: points [N, 3] in the camera's frame, its pose in the world, and
        the object's field in the world for features of its geometry."""
