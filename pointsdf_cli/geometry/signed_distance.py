"""Exact signed distances to a triangle mesh, negative inside, and points on its surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pointsdf_cli.geometry.arrays import Array, Indices, Mask
from pointsdf_cli.geometry.open3d_core import o3d

_RAY_DIRECTIONS = np.array(
    # Irrational-looking directions: a ray along an axis would run inside the faces of boxes.
    [[0.8017, 0.4127, 0.4325], [-0.3511, 0.8662, -0.3556], [0.1123, -0.5402, 0.8340]],
    dtype=np.float32,
)


class SignedDistance:
    """Signed distance to a closed mesh, in the mesh's own frame and units.

    The distance is that to the nearest triangle. The sign is taken from two cheap witnesses, the
    parity of one ray and the side of the nearest triangle; where they disagree (near edges, rays
    that graze, surfaces that touch themselves), the winding number decides, counted with
    orientation along three rays.

    Args:
        vertices: [V, 3], any length unit.
        faces: [F, 3], counter-clockwise seen from outside.
        threads: Threads of the ray tracer; 0 takes all cores.
    """

    def __init__(self, vertices: ArrayLike, faces: ArrayLike, threads: int = 0) -> None:
        vertices = np.asarray(vertices, dtype=np.float64)
        self._faces = np.ascontiguousarray(faces, dtype=np.uint32)
        # float32 resolves 1e-7 of the largest coordinate: keep coordinates small.
        self._centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        local = np.ascontiguousarray(vertices - self._centre, dtype=np.float32)
        corners = local[self._faces]
        self._normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._scene = o3d.t.geometry.RaycastingScene(threads)
        self._scene.add_triangles(local, self._faces)
        self._threads = threads

    def __call__(self, points: ArrayLike) -> NDArray[np.float32]:
        """Signed distances [N] of points [N, 3]; negative inside."""
        local = self._local(points)
        if len(local) == 0:
            return np.zeros(0, dtype=np.float32)
        nearest = self._scene.compute_closest_points(local, self._threads)
        offset = local - nearest["points"].numpy()
        distance = np.sqrt(np.einsum("ij,ij->i", offset, offset))
        normal = self._normals[nearest["primitive_ids"].numpy()]
        behind = np.einsum("ij,ij->i", offset, normal) < 0
        rays = _rays(local, _RAY_DIRECTIONS[0])
        inside = self._scene.count_intersections(rays, self._threads).numpy() % 2 == 1
        doubtful = np.flatnonzero(inside != behind)
        if len(doubtful):
            inside[doubtful] = self._winding_number(local[doubtful]) > 0
        return np.where(inside, -distance, distance).astype(np.float32, copy=False)

    def inside(self, points: ArrayLike) -> Mask:
        """Whether points [N, 3] lie inside, by the winding number alone: [N]."""
        return self._winding_number(self._local(points)) > 0

    def _local(self, points: ArrayLike) -> NDArray[np.float32]:
        local = np.asarray(points, dtype=np.float64) - self._centre
        return np.ascontiguousarray(local, dtype=np.float32)

    def _winding_number(self, local: NDArray[np.float32]) -> Indices:
        """Winding number of the surface around each point: the median of three rays.

        A ray that leaves through a face crosses with its normal (+1), one that enters against it
        (−1); the sum does not care how often closed pieces touch or overlap.
        """
        if len(local) == 0:
            # Open3D's list_intersections crashes on no rays at all.
            return np.zeros(0, dtype=np.int64)
        numbers = np.empty((len(_RAY_DIRECTIONS), len(local)), dtype=np.int64)
        for k, direction in enumerate(_RAY_DIRECTIONS):
            hits = self._scene.list_intersections(_rays(local, direction), self._threads)
            crossing = np.sign(self._normals[hits["primitive_ids"].numpy()] @ direction)
            ray = hits["ray_ids"].numpy().astype(np.int64)
            numbers[k] = np.rint(np.bincount(ray, crossing, minlength=len(local)))
        return np.median(numbers, axis=0).astype(np.int64)


def sample_surface(
    vertices: ArrayLike, faces: ArrayLike, count: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Points [count, 3] uniform by area over a mesh, and the unit normals [count, 3] there."""
    vertices = np.asarray(vertices, dtype=np.float64)
    a, b, c = vertices[np.asarray(faces)].swapaxes(0, 1)
    one_side, other_side = b - a, c - a
    normals = np.cross(one_side, other_side)
    areas = np.linalg.norm(normals, axis=1)
    # How many points each face gets, then shuffled: any part of a sample is a sample.
    shares = rng.multinomial(count, areas / areas.sum())
    chosen = rng.permutation(np.repeat(np.arange(len(areas)), shares))
    u, v = rng.random((2, count))
    # Fold the unit square onto the triangle.
    flip = u + v > 1
    u[flip], v[flip] = 1 - u[flip], 1 - v[flip]
    points = a[chosen]
    points += u[:, None] * one_side[chosen]
    points += v[:, None] * other_side[chosen]
    unit = normals / np.maximum(areas, np.finfo(float).tiny)[:, None]
    return points, unit[chosen]


def _rays(origins: NDArray[np.float32], direction: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.hstack([origins, np.broadcast_to(direction, origins.shape)])
