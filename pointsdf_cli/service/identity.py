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


def bundled_digest() -> str:
    """Digest of all bundled weights, for files that outlive an update of them."""
    weights = sorted(asset_path("weights").glob("*/model.safetensors"))
    told = ((path, path.stat()) for path in weights)
    return _digest(tuple((path, about.st_size, about.st_mtime_ns) for path, about in told))


@lru_cache(maxsize=1)
def _digest(files: tuple[tuple[Path, int, int], ...]) -> str:
    """Digest of files, read again where size or time has changed."""
    return hashlib.sha256("".join(file_sha256(path) for path, *_ in files).encode()).hexdigest()


def weights_digest(path: Path | None) -> str:
    """Digest of a checkpoint; of all bundled weights for None.

    Raises:
        InputError: It cannot be read.
    """
    if path is None:
        return bundled_digest()
    return file_sha256(path / "config.json") + file_sha256(path / "model.safetensors")
