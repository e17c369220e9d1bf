"""Objects stable in simulation as in the world: convex pieces with a flat foot for one pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError, cKDTree

from pointsdf_cli.geometry.stable_poses import StablePose, foot_height
from pointsdf_cli.simulation.decomposition import Pieces
from pointsdf_cli.simulation.sim_object import SimObject

FOOT = 5e-4
"""Corners that are higher than this [m] above the lowest do not carry an object."""


def nearest_pose(item: SimObject, T_world_object: NDArray[np.float64]) -> int:
    """Index of the object's resting pose that a pose in the world [4, 4] is, whatever its yaw."""
    ups = np.array([pose.T_table_object[2, :3] for pose in item.poses])
    return int((ups @ T_world_object[2, :3]).argmax())


def on_its_foot(item: SimObject, pose: StablePose) -> SimObject:
    """The object with pieces that stand in this pose: unchanged if they do, else with a flat foot.

    A can's scanned bottom gives it many resting poses that lean a little this way and that, and a
    hull made flat for all of them is flat for none.
    """
    to_mesh, up, height = item.T_mesh_body, pose.T_table_object[2, :3], pose.T_table_object[2, 3]
    pieces = [
        (corners @ to_mesh[:3, :3].T + to_mesh[:3, 3], faces) for corners, faces in item.pieces
    ]
    corners = np.concatenate([corners for corners, _ in pieces])
    above = corners @ up + height
    level = pose.T_table_object[:2, :3]
    low = corners[above < above.min() + FOOT] @ level.T
    # It stands if its centre of mass is over the polygon of these corners.
    if np.linalg.matrix_rank(low - low[0]) == 2:
        sides = ConvexHull(low).equations
        if (sides @ np.append(level @ to_mesh[:3, 3], 1.0) < 0).all():
            return item
    try:
        flat = with_flat_foot(pieces, item.mesh.vertices, pose)
    except QhullError:  # it rests on an edge or a corner: there is no foot
        return item
    body = [((corners - to_mesh[:3, 3]) @ to_mesh[:3, :3], faces) for corners, faces in flat]
    return replace(item, pieces=body)


def with_flat_foot(pieces: Pieces, vertices: NDArray[np.float64], pose: StablePose) -> Pieces:
    """Convex pieces that stand on the same points as the mesh; all in the mesh frame.

    A scan's bottom is a little round, and a hull of few corners leaves most of its rim out: a can
    that stands in the world would rest on three corners here, and fall over. So the rim of the
    mesh's foot is added to the pieces that it belongs to, and all that is foot is put flat.

    Args:
        pieces: Corners [V, 3] and faces [F, 3] of each.
        vertices: [N, 3], of the mesh.
        pose: Resting pose. Flattened for several, pieces outgrow the mesh: a ball by 9% of its
            volume.
    """
    up, height = pose.T_table_object[2, :3], pose.T_table_object[2, 3]
    lowest = min(float((corners @ up).min()) for corners, _ in pieces) + height
    foot = max(lowest, 0.0) + foot_height(pose.height)
    rim = vertices[vertices @ up + height < foot_height(pose.height)]
    rim = rim[ConvexHull(rim @ pose.T_table_object[:2, :3].T).vertices]
    away = [cKDTree(corners).query(rim)[0] for corners, _ in pieces]
    owner = np.argmin(away, axis=0)
    shaped = []
    for k, (corners, _) in enumerate(pieces):
        corners = np.concatenate([corners, rim[owner == k]])
        above = corners @ up + height
        corners = corners - np.where(above < foot, above, 0.0)[:, None] * up
        hull = trimesh.convex.convex_hull(corners)
        shaped.append((np.asarray(hull.vertices), np.asarray(hull.faces)))
    return shaped
