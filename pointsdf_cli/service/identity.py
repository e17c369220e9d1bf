"""Version, robot and weights of a planner, as digests."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from pointsdf_cli import __version__
from pointsdf_cli.assets import asset_path
from pointsdf_cli.io.provenance import file_sha256
from pointsdf_cli.robot.description import robot_digest

BUNDLED = "bundled"
"""Weights that were not named: those of the method that come with the version."""


@dataclass(frozen=True)
class PlannerFiles:
    """Files of a planner; the bundled ones if None.

    Attributes:
        robot: YAML of the robot.
        checkpoint: Reconstruction weights.
        grasp_checkpoint: Success weights; the method's own if None.
    """

    robot: Path | None = None
    checkpoint: Path | None = None
    grasp_checkpoint: Path | None = None

    def identity(self) -> dict[str, str]:
        """Digests by name; equal ones give equal answers.

        Raises:
            InputError: The robot or a checkpoint cannot be read.
        """
        return {
            "version": __version__,
            "robot": robot_digest(self.robot),
            "checkpoint": weights_digest(self.checkpoint),
            "grasp_checkpoint": weights_digest(self.grasp_checkpoint),
        }


@lru_cache(maxsize=1)
def bundled_digest() -> str:
    """Digest of all bundled weights, for files that outlive an update of them."""
    weights = sorted(asset_path("weights").glob("*/model.safetensors"))
    return hashlib.sha256("".join(map(file_sha256, weights)).encode()).hexdigest()


def weights_digest(path: Path | None) -> str:
    """Digest of a checkpoint; `BUNDLED` for None.

    Raises:
        InputError: It cannot be read.
    """
    if path is None:
        return BUNDLED
    return file_sha256(path / "config.json") + file_sha256(path / "model.safetensors")
