"""View of an object: its points, the camera's pose, and the observed space around it."""

from __future__ import annotations

from dataclasses import dataclass

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.geometry.visibility import ViewEvidence


@dataclass(frozen=True)
class View:
    """One camera's view of an object.

    Attributes:
        points: [N, 3], camera frame, m.
        T_world_camera: [4, 4].
        evidence: Observed space around the object; None for a bare cloud.
    """

    points: Array
    T_world_camera: Array
    evidence: ViewEvidence | None = None

    @property
    def in_world(self) -> Array:
        """The points [N, 3] in the world."""
        return apply_transform(self.T_world_camera, self.points)
