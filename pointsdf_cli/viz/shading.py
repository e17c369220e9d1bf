"""Shaded pictures of meshes by ray casting: no display, no graphics driver."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.geometry.open3d_core import o3d

SKY = np.array([1.0, 1.0, 1.0])
LIGHT = np.array([0.35, -0.45, 1.0]) / np.linalg.norm([0.35, -0.45, 1.0])
"""Where the light comes from, in the world (z up)."""


@dataclass(frozen=True)
class Painted:
    """A mesh in the world with one colour.

    Attributes:
        vertices: [V, 3], world, m.
        faces: [F, 3].
        colour: Red, green and blue in [0, 1].
        unlit: Shown in that very colour, wherever the light comes from, as signs want to be.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    colour: tuple[float, float, float]
    unlit: bool = False


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0, 0, 1)) -> NDArray[np.float64]:
    """T_world_camera [4, 4] of an OpenCV camera at `eye` that looks at `target`."""
    eye = np.asarray(eye, dtype=float)
    forward = np.asarray(target, dtype=float) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, np.asarray(up, dtype=float))
    if np.linalg.norm(right) < 1e-6:  # straight up or down: any right will do
        right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    return transform(np.stack([right, np.cross(forward, right), forward], axis=1), eye)


def shaded_image(
    meshes: Sequence[Painted],
    T_world_camera: NDArray[np.float64],
    size: tuple[int, int] = (480, 480),
    field_of_view: float = 0.7,
    oversampling: int = 2,
) -> NDArray[np.uint8]:
    """A picture [height, width, 3] of meshes with diffuse light and hard shadows.

    Args:
        meshes: What is seen.
        T_world_camera: OpenCV camera in the world, from `look_at`.
        size: (width, height) in pixels.
        field_of_view: Vertical [rad].
        oversampling: Rays a pixel along each axis.
    """
    scene = o3d.t.geometry.RaycastingScene(1)
    for mesh in meshes:
        scene.add_triangles(
            o3d.core.Tensor.from_numpy(np.ascontiguousarray(mesh.vertices, dtype=np.float32)),
            o3d.core.Tensor.from_numpy(np.ascontiguousarray(mesh.faces, dtype=np.uint32)),
        )
    width, height = (side * oversampling for side in size)
    focal = height / 2 / np.tan(field_of_view / 2)
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    ones = np.ones_like(u)
    directions = np.stack([(u - width / 2) / focal, (v - height / 2) / focal, ones], axis=-1)
    directions = directions @ T_world_camera[:3, :3].T
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    origins = np.broadcast_to(T_world_camera[:3, 3], directions.shape)
    hits = _cast(scene, origins, directions)
    depth, which = hits["t_hit"].numpy(), hits["geometry_ids"].numpy()
    seen = np.isfinite(depth)
    colours = np.array([mesh.colour for mesh in meshes])
    image = np.broadcast_to(SKY, (*depth.shape, 3)).copy()
    normals = hits["primitive_normals"].numpy()[seen].astype(float)
    toward = directions[seen]
    # Seen from inside or with reversed faces: light the side that is looked at.
    normals *= -np.sign((normals * toward).sum(axis=1, keepdims=True))
    points = origins[seen] + depth[seen][:, None] * toward
    shadow_rays = _cast(scene, points + 1e-4 * normals, np.broadcast_to(LIGHT, points.shape))
    lit = ~np.isfinite(shadow_rays["t_hit"].numpy())
    diffuse = np.clip(normals @ LIGHT, 0, 1) * np.where(lit, 1.0, 0.35)
    ambient = 0.42 + 0.12 * normals[:, 2]
    headlight = 0.18 * np.abs((normals * toward).sum(axis=1))
    strength = ambient + 0.5 * diffuse + headlight
    strength[np.array([mesh.unlit for mesh in meshes])[which[seen]]] = 1.0
    image[seen] = colours[which[seen]] * strength[:, None]
    blocks = image.reshape(size[1], oversampling, size[0], oversampling, 3).mean(axis=(1, 3))
    picture: NDArray[np.uint8] = (np.clip(blocks, 0, 1) * 255).astype(np.uint8)
    return picture


def table_mesh(
    low: tuple[float, float] = (-0.35, -0.75), high: tuple[float, float] = (1.25, 0.75)
) -> Painted:
    """The table top, a thin slab below z = 0."""
    import trimesh

    size = (high[0] - low[0], high[1] - low[1], 0.02)
    box = trimesh.creation.box(size)
    box.apply_translation(((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, -0.01))
    return Painted(np.asarray(box.vertices), np.asarray(box.faces), (0.86, 0.82, 0.76))


def _cast(
    scene: Any,
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
) -> dict[str, Any]:
    rays = np.concatenate([origins, directions], axis=-1).astype(np.float32)
    found: dict[str, Any] = scene.cast_rays(o3d.core.Tensor.from_numpy(rays), 1)
    return found
