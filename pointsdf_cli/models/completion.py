"""Completion of a partial cloud in one call."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from pointsdf_cli.camera.view import as_points, require_in_front
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import apply_transform, invert_transform, rigid
from pointsdf_cli.geometry.visibility import ViewEvidence
from pointsdf_cli.io.clouds import Cloud, check_object_cloud
from pointsdf_cli.models.meshing import mesh_reconstruction
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.registry import load_model
from pointsdf_cli.models.shape_model import ShapeModel

MARGIN = 0.01
"""Nearer to the surface than this [m] the network's distances are kept (docs/planning.md)."""


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
        """Signed distances [...] m at finite places x [..., 3] m; negative inside.

        The network's, but outside at most the distance to the nearest vertex, and at least that
        less `MARGIN`: far away, and where nothing was seen, the network's values mean little.
        """
        places = _finite(x)
        values = self.reconstruction.sdf(places)
        distance, _, outside = self._away(places, values)
        bounded = np.clip(values, distance - MARGIN, distance)
        return np.where(outside, bounded, values).astype(np.float32)

    def gradient(self, x: ArrayLike) -> NDArray[np.float32]:
        """Gradients [..., 3] of the signed distance at finite places x [..., 3] m."""
        places = _finite(x)
        values, gradients = self.reconstruction.sdf_and_gradient(places)
        distance, away, outside = self._away(places, values)
        bounded = outside & ((values < distance - MARGIN) | (values > distance))
        return np.where(bounded[..., None], away, gradients).astype(np.float32)

    def _away(
        self, places: NDArray[np.float64], values: NDArray[np.float32]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
        """Distances [...] to the nearest vertex, unit vectors [..., 3] away from it, and which
        places are outside by the network's values [...]."""
        distance, nearest = map(np.asarray, self._tree.query(places))
        away = (places - self.vertices[nearest]) / np.maximum(distance, 1e-9)[..., None]
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        outside = (values > 0) | ((places < low) | (places > high)).any(axis=-1)
        return distance, away, outside

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.vertices)


def _finite(x: ArrayLike) -> NDArray[np.float64]:
    places = np.asarray(x, dtype=np.float64)
    if places.shape[-1:] != (3,):
        raise InputError(f"is of shape {places.shape}", where="x", allowed="[..., 3], m")
    if not np.isfinite(places).all():
        raise InputError("holds values that are NaN or infinite", where="x", allowed="[..., 3], m")
    return places


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
    pose = np.eye(4) if T_frame_camera is None else rigid(T_frame_camera, "T_frame_camera")
    points = as_points(points, "points")
    check_object_cloud(Cloud(points), "points")
    require_in_front(apply_transform(invert_transform(pose), points), "points")
    model = _model(None if checkpoint is None else str(checkpoint))
    shape = Reconstruction.from_cloud(model, points, pose[:3, 3], pose[:3, :3], seed, evidence)
    mesh = mesh_reconstruction(shape, resolution)
    return Completion(mesh.vertices, mesh.faces, shape)


@lru_cache(maxsize=2)
def _model(checkpoint: str | None) -> ShapeModel:
    return load_model(checkpoint, "cpu")
