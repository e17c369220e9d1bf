"""An object as the simulator needs it: convex pieces, mass, inertia, and how it can rest."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, cKDTree

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.io.meshes import LoadedMesh
from pointsdf_cli.simulation.decomposition import Pieces, convex_pieces
from pointsdf_cli.simulation.quick_pieces import QuickCutConfig, quick_pieces
from pointsdf_cli.simulation.stable_poses import (
    StablePose,
    foot_height,
    stable_poses,
    standing_poses,
)

DENSITY = 400.0
"""Household things [kg/m³], counted over their volume: between a filled bottle and a toy."""
LIGHTEST, HEAVIEST = 0.05, 0.6
"""Bounds of the mass [kg]: a hollow scan weighs something, a solid one is no brick of lead."""


@dataclass(frozen=True)
class SimObject:
    """One object to simulate.

    Attributes:
        mesh: Its surface, mesh frame.
        pieces: Convex pieces in the body frame: origin at the centre of mass, principal axes.
        T_mesh_body: [4, 4], the body frame in the mesh frame.
        mass: [kg].
        inertia: [3], principal moments [kg m²].
        poses: How it can rest on a table.
    """

    mesh: LoadedMesh
    pieces: Pieces
    T_mesh_body: NDArray[np.float64]
    mass: float
    inertia: NDArray[np.float64]
    poses: list[StablePose]


def prepare_object(
    mesh: LoadedMesh,
    cache: Path | None = None,
    cut: QuickCutConfig | None = None,
    feet: bool = True,
) -> SimObject:
    """Everything that does not change between attempts with a mesh.

    Args:
        mesh: A closed mesh.
        cache: Where CoACD's pieces are kept; see `convex_pieces`.
        cut: Cut in this way instead of by CoACD.
        feet: Give the pieces a flat foot for every pose that it may be made to stand in. Each moves
            corners by a few millimetres; who knows the one pose needs one foot.

    Raises:
        InputError: It encloses no volume or has no resting pose.
    """
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=True)
    if not np.isfinite(solid.volume) or solid.volume <= 1e-9:
        raise InputError(
            f"encloses {solid.volume:.3g} m³",
            where=mesh.name,
            allowed="a closed mesh that faces outwards, above 1e-9 m³",
        )
    mass = float(np.clip(DENSITY * solid.volume, LIGHTEST, HEAVIEST))
    solid.density = mass / solid.volume
    centre = np.asarray(solid.center_mass)
    moments, axes = np.linalg.eigh(np.asarray(solid.moment_inertia))
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    poses = stable_poses(mesh.vertices, centre)
    if cut is None:
        pieces = convex_pieces(mesh, cache=cache)
    else:
        pieces = quick_pieces(mesh.vertices, mesh.faces, cut)
    if feet:
        standing = [poses[i] for i in standing_poses(poses)]
        pieces = with_flat_feet(pieces, mesh.vertices, standing)
    # Flat things have moments near 0 about one axis, which no contact solver likes.
    moments = np.maximum(moments, 1e-6)
    body = [((corners - centre) @ axes, faces) for corners, faces in pieces]
    return SimObject(
        mesh=mesh,
        pieces=body,
        T_mesh_body=transform(axes, centre),
        mass=mass,
        inertia=moments,
        poses=poses,
    )


def with_flat_feet(
    pieces: Pieces, vertices: NDArray[np.float64], standing: list[StablePose]
) -> Pieces:
    """Convex pieces that stand on what the mesh stands on; all in the mesh frame.

    A scan's bottom is a little round, and a hull of few corners leaves most of its rim out: a can
    that stands in the world would rest on three corners here, and fall over. So the rim of the
    mesh's foot is added to the pieces that it belongs to, and all that is foot is put flat.

    Args:
        pieces: Corners [V, 3] and faces [F, 3] of each.
        vertices: [N, 3], of the mesh.
        standing: The poses to do this for.
    """
    for pose in standing:
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
        pieces = shaped
    return pieces
