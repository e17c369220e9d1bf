"""Rigid transforms as arrays: rotations, wxyz quaternions and 4×4 homogeneous matrices.

`T_world_object` reads "object in world": it takes coordinates in the object frame to the world.
Every function works on leading batch dimensions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array, numbers


def transform(rotation: ArrayLike, translation: ArrayLike) -> Array:
    """The homogeneous matrix [..., 4, 4] of a rotation [..., 3, 3] and a translation [..., 3]."""
    rotation = np.asarray(rotation, dtype=np.float64)
    translation = np.asarray(translation, dtype=np.float64)
    batch = np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1])
    matrix = np.zeros((*batch, 4, 4))
    matrix[..., :3, :3] = rotation
    matrix[..., :3, 3] = translation
    matrix[..., 3, 3] = 1.0
    return matrix


def invert_transform(matrix: ArrayLike) -> Array:
    """The inverse of rigid transforms [..., 4, 4], by transposition (no linear solve)."""
    matrix = np.asarray(matrix, dtype=np.float64)
    rotation = np.swapaxes(matrix[..., :3, :3], -1, -2)
    return transform(rotation, -np.einsum("...ij,...j->...i", rotation, matrix[..., :3, 3]))


def apply_transform(matrix: ArrayLike, points: ArrayLike) -> Array:
    """Points [..., N, 3] taken through transforms [..., 4, 4]."""
    matrix = np.asarray(matrix, dtype=np.float64)
    points = np.asarray(points, dtype=np.float64)
    return points @ np.swapaxes(matrix[..., :3, :3], -1, -2) + matrix[..., None, :3, 3]


def plane_in_camera(plane: ArrayLike, T_world_camera: ArrayLike) -> Array:
    """A plane (normal n, offset d; n·x = d) [4] of the world in the camera's frame."""
    plane, pose = np.asarray(plane, np.float64), np.asarray(T_world_camera, np.float64)
    return np.array([*(pose[:3, :3].T @ plane[:3]), plane[3] - plane[:3] @ pose[:3, 3]])


def is_rigid(matrix: ArrayLike, tolerance: float = 1e-4) -> bool:
    """Whether a 4×4 matrix is a rotation and a translation: no scale, shear, mirror or NaN."""
    matrix = np.asarray(matrix, dtype=np.float64)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        return False
    rotation = matrix[:3, :3]
    return bool(
        np.abs(rotation @ rotation.T - np.eye(3)).max() < tolerance
        and np.linalg.det(rotation) > 0
        and np.abs(matrix[3] - (0, 0, 0, 1)).max() < tolerance
    )


def rigid(pose: ArrayLike, where: str) -> Array:
    """A copy [4, 4] of a rotation and a translation.

    Raises:
        InputError: It is none.
    """
    matrix = numbers(pose, where, "[4, 4], m")
    if not is_rigid(matrix):
        allowed = "[4, 4], a rotation and a translation"
        raise InputError("is not a rigid transform", where=where, allowed=allowed)
    return matrix


def rotation_from_wxyz(wxyz: ArrayLike) -> Array:
    """Rotations [..., 3, 3] of quaternions [..., 4], scalar first; need not be of unit length."""
    wxyz = np.asarray(wxyz, dtype=np.float64)
    w, x, y, z = np.moveaxis(wxyz / np.linalg.norm(wxyz, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return _matrices(rows)


def wxyz_from_rotation(rotation: ArrayLike) -> Array:
    """Unit quaternions [..., 4], scalar first and not negative, of rotations [..., 3, 3].

    Takes the largest of the four candidates of Shepperd's method, so no division is by a small
    number.
    """
    m = np.asarray(rotation, dtype=np.float64)
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    # Row k holds 4·q_k·(w, x, y, z).
    a, b, c = _about_axis(m)
    d, e, f = m[..., 1, 0] + m[..., 0, 1], m[..., 0, 2] + m[..., 2, 0], m[..., 2, 1] + m[..., 1, 2]
    rows = [
        [1 + xx + yy + zz, a, b, c],
        [a, 1 + xx - yy - zz, d, e],
        [b, d, 1 - xx + yy - zz, f],
        [c, e, f, 1 - xx - yy + zz],
    ]
    candidates = _matrices(rows)
    best = np.argmax(np.einsum("...kk->...k", candidates), axis=-1)
    wxyz = np.take_along_axis(candidates, best[..., None, None], axis=-2)[..., 0, :]
    wxyz = wxyz / np.linalg.norm(wxyz, axis=-1, keepdims=True)
    return np.asarray(np.where(wxyz[..., :1] < 0, -wxyz, wxyz))


def rotation_vector(rotation: ArrayLike) -> Array:
    """Axis times angle [..., 3] of rotations [..., 3, 3]; sound up to half a turn, where the axis
    is lost and the vector is zero."""
    m = np.asarray(rotation, dtype=np.float64)
    axis = 0.5 * np.stack(_about_axis(m), axis=-1)
    sine = np.linalg.norm(axis, axis=-1)
    angle = np.arctan2(sine, (np.trace(m, axis1=-2, axis2=-1) - 1) / 2)
    scale = np.where(sine > 1e-6, angle / np.maximum(sine, 1e-12), 1.0)
    return np.asarray(axis * scale[..., None])


def cross_matrix(axis: ArrayLike) -> Array:
    """Matrices K [..., 3, 3] with K v = axis × v, of axes [..., 3]."""
    x, y, z = np.moveaxis(np.asarray(axis, dtype=np.float64), -1, 0)
    zero = np.zeros_like(x)
    return _matrices([[zero, -z, y], [z, zero, -x], [-y, x, zero]])


def _matrices(rows: list[list[Array]]) -> Array:
    """Matrices [..., R, C] from the arrays [...] of their elements, row by row."""
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _about_axis(m: Array) -> tuple[Array, Array, Array]:
    """Components [...] of the axes of rotations [..., 3, 3], times twice the sine of the angle."""
    return m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]


def random_rotation(rng: np.random.Generator, count: int | None = None) -> Array:
    """Rotations [count, 3, 3] (one [3, 3] without a count), uniform over SO(3).

    A normalised four-dimensional Gaussian is uniform on the unit quaternions.
    """
    wxyz = rng.standard_normal((count or 1, 4))
    rotations = rotation_from_wxyz(wxyz)
    return rotations if count is not None else rotations[0]
