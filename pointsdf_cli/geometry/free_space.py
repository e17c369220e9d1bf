"""Space that a camera saw through: in front of what it measured."""

from __future__ import annotations

import numpy as np
import scipy

from pointsdf_cli.geometry.arrays import Array, Mask
from pointsdf_cli.geometry.frames import apply_transform, invert_transform

BESIDE = 0.01
"""Largest angle [rad] between the ray to a place and a measured one that tells about it."""
BEHIND = 0.03
"""Distance [m] behind a place from which what was measured there shows it to be free: more than the
errors of depth and of `BESIDE`."""


class FreeSpace:
    """Places that one camera saw to be free.

    Args:
        points: [M, 3], what it measured, camera frame, m.
        T_world_camera: [4, 4].
    """

    def __init__(self, points: Array, T_world_camera: Array) -> None:
        points = points[points[:, 2] > 0]
        self._depth = points[:, 2]
        self._rays = scipy.spatial.cKDTree(
            points[:, :2] / points[:, 2:], compact_nodes=False, balanced_tree=False
        )
        self._T_camera_world = invert_transform(T_world_camera)

    def holds(self, places: Array) -> Mask:
        """Mask of the places [N, 3], world, m, that were seen to be free.

        Unseen places, and those near or behind what was measured, are not.
        """
        at = apply_transform(self._T_camera_world, places)
        before = at[:, 2] > 0
        tangents = at[before, :2] / at[before, 2:]
        away, nearest = self._rays.query(tangents, distance_upper_bound=BESIDE)
        depth = np.append(self._depth, 0.0)[nearest]
        free = np.zeros(len(places), dtype=bool)
        free[before] = np.isfinite(away) & (depth > at[before, 2] + BEHIND)
        return free
