"""Simulated object: convex pieces, mass, inertia and resting poses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError, as_input_error
from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.geometry.stable_poses import StablePose, stable_poses
from pointsdf_cli.io.meshes import LoadedMesh
from pointsdf_cli.simulation.decomposition import Pieces, convex_pieces
from pointsdf_cli.simulation.mass import mass_of
from pointsdf_cli.simulation.quick_pieces import quick_pieces


@dataclass(frozen=True)
class SimObject:
    """One object to simulate.

    Attributes:
        mesh: The surface, mesh frame.
        pieces: Convex pieces in the body frame: origin at the centre of mass, principal axes.
        T_mesh_body: [4, 4], the body frame in the mesh frame.
        mass: Mass [kg].
        inertia: [3], principal moments of inertia [kg m²].
        poses: Resting poses on a table.
    """

    mesh: LoadedMesh
    pieces: Pieces
    T_mesh_body: NDArray[np.float64]
    mass: float
    inertia: NDArray[np.float64]
    poses: list[StablePose]


def prepare_object(mesh: LoadedMesh, cache: Path | None = None, fine: bool = False) -> SimObject:
    """Prepare a mesh for simulation.

    Args:
        mesh: A closed mesh.
        cache: Cache folder of CoACD's pieces; see `convex_pieces`.
        fine: Cut by `quick_pieces`, finer than CoACD's sixteen pieces.

    Raises:
        InputError: It encloses no volume or has no resting pose.
    """
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=True)
    if not np.isfinite(solid.volume) or solid.volume <= 1e-9:
        allowed = "a closed mesh that faces outwards, above 1e-9 m³"
        raise InputError(f"encloses {solid.volume:.3g} m³", where=mesh.name, allowed=allowed)
    mass = mass_of(mesh.name, solid)
    solid.density = mass / solid.volume
    centre = np.asarray(solid.center_mass)
    moments, axes = np.linalg.eigh(np.asarray(solid.moment_inertia))
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    with as_input_error(mesh.name):
        poses = stable_poses(mesh.vertices, centre)
    pieces = quick_pieces(mesh.vertices, mesh.faces) if fine else convex_pieces(mesh, cache)
    # Bounded below: contact solvers fail at moments near 0, as flat objects have about one axis.
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
