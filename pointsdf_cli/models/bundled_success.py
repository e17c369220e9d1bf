"""Bundled success weights: one for each robot, found by the robot's name."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pointsdf_cli.assets import assets_folder
from pointsdf_cli.io.checkpoints import read_config
from pointsdf_cli.robot.description import RobotDescription

ARCHITECTURE = "grasp-success"


def bundled_success(robot: RobotDescription, inputs: str = "geometry") -> Path | None:
    """The bundled checkpoint that learned with a robot of this name; None if there is none.

    Args:
        robot: The robot.
        inputs: Inputs of its network, a key of `NETWORKS`.
    """
    for folder in sorted((assets_folder() / "weights").iterdir()):
        config = read_config(folder)
        learned = config.get("robot")
        if (
            config.get("architecture") == ARCHITECTURE
            and config.get("inputs") == inputs
            and isinstance(learned, Mapping)
            and learned.get("name") == robot.name
        ):
            return folder
    return None


def grasps_learned_from(config: Mapping[str, Any]) -> int | None:
    """Number of executed grasps that a checkpoint with this config.json was trained on; None if it
    does not say."""
    try:
        return int(config["data"]["train"]["grasps"])
    except (KeyError, TypeError, ValueError):
        return None
