"""Completion of a partial cloud in one call."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import is_rigid
from pointsdf_cli.geometry.visibility import ViewEvidence
from pointsdf_cli.io.clouds import Cloud, check_object_cloud
from pointsdf_cli.models.meshing import mesh_reconstruction
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.registry import load_model
from pointsdf_cli.models.shape_model import ShapeModel


@dataclass(frozen=True)
class Completion:
    """A completed object, in the frame of its points.

    Attributes:
        vertices: f8 [V, 3], m.
        faces: i4 [F, 3], a closed surface.
        reconstruction: The network's signed distance function.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    reconstruction: Reconstruction

    def sdf(self, x: ArrayLike) -> NDArray[np.float32]:
        """Signed distances [...] m at x [..., 3] m; negative inside."""
        return self.reconstruction.sdf(x)

    def gradient(self, x: ArrayLike) -> NDArray[np.float32]:
        """Gradients [..., 3] of the signed distance at x [..., 3] m."""
        return self.reconstruction.sdf_and_gradient(x)[1]


def complete(
    points: ArrayLike,
    T_frame_camera: ArrayLike | None = None,
    evidence: ViewEvidence | None = None,
    checkpoint: Path | str | None = None,
    resolution: int = 128,
    seed: int = 0,
) -> Completion:
    """Complete the partial cloud of one object.

    Args:
        points: [N, 3], m, cleaned, of the object alone.
        T_frame_camera: [4, 4], the camera (x right, y down, z forward) in the frame of the points;
            None if that is the camera's.
        evidence: Observed space around the object, camera frame.
        checkpoint: Folder of a network; the bundled one if None. It is loaded once.
        resolution: Cells along the mesh's box: 32 times a power of two, up to 512.
        seed: Random seed of the points that the network reads.

    Raises:
        InputError: The points, the pose or the checkpoint cannot be used.
        EmptySurfaceError: The network sees no object in the points.
    """
    pose = np.eye(4) if T_frame_camera is None else np.asarray(T_frame_camera, dtype=np.float64)
    if not is_rigid(pose):
        raise InputError(
            "is not a rigid transform", where="T_frame_camera", allowed="[4, 4], a rotation, m"
        )
    try:
        points = np.asarray(points, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("not an array of numbers", where="points", allowed="[N, 3]") from error
    if points.ndim == 2 and points.shape[1] == 3:
        check_object_cloud(Cloud(points), "points")
    model = _model(None if checkpoint is None else str(checkpoint))
    shape = Reconstruction.from_cloud(model, points, pose[:3, 3], pose[:3, :3], seed, evidence)
    mesh = mesh_reconstruction(shape, resolution)
    return Completion(mesh.vertices, mesh.faces, shape)


@lru_cache(maxsize=2)
def _model(checkpoint: str | None) -> ShapeModel:
    return load_model(checkpoint, "cpu")
