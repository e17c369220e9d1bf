"""Flat feet for convex pieces, so that objects stand in simulation as they do in the world."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError, cKDTree

from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.geometry.stable_poses import StablePose, foot_height
from pointsdf_cli.simulation.decomposition import Pieces
from pointsdf_cli.simulation.sim_object import SimObject

FOOT = 5e-4
"""Height [m] above the lowest corner up to which corners carry an object."""


def nearest_pose(item: SimObject, T_world_object: NDArray[np.float64]) -> int:
    """Index of the object's resting pose nearest to a pose in the world [4, 4], for any yaw."""
    ups = np.array([pose.T_table_object[2, :3] for pose in item.poses])
    return int((ups @ T_world_object[2, :3]).argmax())


def on_its_foot(item: SimObject, pose: StablePose) -> SimObject:
    """The object with pieces that stand in this pose, with a flat foot if they need one.

    A can's scanned bottom has many slightly leaning resting poses, and a hull flattened for all of
    them is flat for none.
    """
    to_mesh, up, height = item.T_mesh_body, pose.T_table_object[2, :3], pose.T_table_object[2, 3]
    pieces = [(apply_transform(to_mesh, corners), faces) for corners, faces in item.pieces]
    corners = np.concatenate([corners for corners, _ in pieces])
    above = corners @ up + height
    level = pose.T_table_object[:2, :3]
    low = corners[above < above.min() + FOOT] @ level.T
    # It stands if its centre of mass is above the polygon of these corners.
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
    """Give convex pieces the foot of the mesh; all in the mesh frame.

    A scan's bottom is slightly round, and a hull of few corners omits most of its rim: a standing
    can would rest on three corners in simulation and fall over. So the rim of the mesh's foot is
    added to the pieces, and the foot is flattened.

    Args:
        pieces: Corners [V, 3] and faces [F, 3] of each.
        vertices: [N, 3], vertices of the mesh.
        pose: Resting pose. Only one, because pieces flattened for several poses would be larger
            than the mesh: a ball by 9% of its volume.
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
