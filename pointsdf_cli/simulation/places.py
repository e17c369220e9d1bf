"""Places of objects on the table."""

from __future__ import annotations

import numpy as np

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import apply_transform, invert_transform, transform
from pointsdf_cli.simulation.sim_object import SimObject

NEAR = 0.02
"""Points farther from an object's box than this [m] are of something else."""


def placed(resting: Array, item: SimObject, yaw: float, place: Array) -> Array:
    """A settled pose turned about the vertical, the middle of its outline at `place` [2]."""
    c, s = np.cos(yaw), np.sin(yaw)
    turned = transform([[c, -s, 0], [s, c, 0], [0, 0, 1]], [0, 0, 0]) @ resting
    outline = apply_transform(turned, item.mesh.vertices)[:, :2]
    middle = (outline.min(axis=0) + outline.max(axis=0)) / 2
    turned[:2, 3] += place - middle
    return turned


def shows(item: SimObject, T_world_object: Array, points: Array) -> bool:
    """Whether most of the points [N, 3], world, lie on the object: segmentation may confuse a low
    object with a bump of the table."""
    local = apply_transform(invert_transform(T_world_object), points)
    low, high = item.mesh.vertices.min(axis=0) - NEAR, item.mesh.vertices.max(axis=0) + NEAR
    return bool(np.median(((local > low) & (local < high)).all(axis=1)) == 1)
