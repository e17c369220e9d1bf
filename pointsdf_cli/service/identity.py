"""Version, robot and weights of a planner, as digests."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from pointsdf_cli import __version__
from pointsdf_cli.io.provenance import file_sha256
from pointsdf_cli.robot.description import robot_digest

BUNDLED = "bundled"
"""Weights that were not named: those of the method that come with the version."""


def identity(
    robot: Path | None, checkpoint: Path | None, grasp_checkpoint: Path | None
) -> dict[str, str]:
    """Digests by name; equal ones give equal answers.

    Raises:
        InputError: The robot or a checkpoint cannot be read.
    """
    return {
        "version": __version__,
        "robot": _robot(robot),
        "checkpoint": _weights(checkpoint),
        "grasp_checkpoint": _weights(grasp_checkpoint),
    }


@lru_cache(maxsize=8)
def _robot(path: Path | None) -> str:
    return robot_digest(path)


@lru_cache(maxsize=8)
def _weights(path: Path | None) -> str:
    if path is None:
        return BUNDLED
    return file_sha256(path / "config.json") + file_sha256(path / "model.safetensors")
