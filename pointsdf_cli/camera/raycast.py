"""Depth images of meshes by ray casting, limited to the mesh's box in the image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.geometry.frames import apply_transform, invert_transform
from pointsdf_cli.geometry.open3d_core import o3d

_BEHIND = 1e-3
"""Least distance [m] of vertices from the camera's plane; if any is nearer, the whole image is
cast."""


@dataclass(frozen=True)
class DepthPatch:
    """The pixels of an image that saw the mesh.

    Attributes:
        u, v: i8 [H], pixel coordinates, row by row.
        depth: f4 [H], m along z.
        covered: Fraction of the whole image that they cover.
    """

    u: NDArray[np.int64]
    v: NDArray[np.int64]
    depth: NDArray[np.float32]
    covered: float


@dataclass(frozen=True)
class DepthWindow:
    """A rectangle of an image.

    Attributes:
        origin: Column and row of its first pixel in the whole image.
        depth: f4 [h, w], m along z; inf where nothing was hit.
        cosine: f4 [h, w], |cos| of the angle between ray and surface normal; 1 where nothing was
            hit.
    """

    origin: tuple[int, int]
    depth: NDArray[np.float32]
    cosine: NDArray[np.float32]


THREADS = 1
"""Threads of the ray tracer: commands run a process on each core."""


class MeshCaster:
    """Ray caster of a pinhole camera for one mesh.

    Args:
        vertices: [V, 3], mesh frame, m.
        faces: [F, 3].
        camera: The intrinsics.
    """

    def __init__(self, vertices: ArrayLike, faces: ArrayLike, camera: Camera) -> None:
        self._vertices = np.asarray(vertices, dtype=np.float64)
        self._camera = camera
        self._scene = o3d.t.geometry.RaycastingScene(THREADS)
        self._scene.add_triangles(
            o3d.core.Tensor.from_numpy(np.ascontiguousarray(self._vertices, dtype=np.float32)),
            o3d.core.Tensor.from_numpy(np.ascontiguousarray(faces, dtype=np.uint32)),
        )
        low, high = self._vertices.min(axis=0), self._vertices.max(axis=0)
        self._box = np.array(np.meshgrid(*np.stack([low, high], axis=1))).reshape(3, -1).T

    def cast(self, T_camera_object: NDArray[np.float64]) -> DepthPatch:
        """Exact depths of the mesh at the pose `T_camera_object` [4, 4] in the camera's frame."""
        window = self.window_around(T_camera_object)
        hits, _ = self._cast(T_camera_object, window)
        depth = hits["t_hit"].numpy()
        v, u = np.nonzero(np.isfinite(depth))
        area = self._camera.width * self._camera.height
        return DepthPatch(u + window[0], v + window[2], depth[v, u], len(u) / area)

    def cast_window(
        self,
        T_camera_object: NDArray[np.float64],
        margin: float = 0.0,
        window: tuple[int, int, int, int] | None = None,
    ) -> DepthWindow:
        """Exact depths and incidence around the mesh.

        Args:
            T_camera_object: [4, 4], the mesh frame in the camera's.
            margin: Margin on each side, as a share of the longer side of the mesh's box.
            window: Columns [left, right) and rows [top, bottom) to cast instead.
        """
        if window is None:
            window = self.window_around(T_camera_object, margin)
        hits, rays = self._cast(T_camera_object, window)
        depth, direction = hits["t_hit"].numpy(), rays[..., 3:]
        # Sums over a short last axis take several times as long.
        along = np.abs(np.einsum("hwk,hwk->hw", hits["primitive_normals"].numpy(), direction))
        cosine = along / np.sqrt(np.einsum("hwk,hwk->hw", direction, direction))
        cosine[~np.isfinite(depth)] = 1.0
        return DepthWindow((window[0], window[2]), depth, cosine.astype(np.float32))

    def window_around(
        self, T_camera_object: NDArray[np.float64], margin: float = 0.0
    ) -> tuple[int, int, int, int]:
        """Columns [left, right) and rows [top, bottom) that can see the mesh's bounding box, grown
        by `margin` times its longer side, within the image."""
        width, height = self._camera.width, self._camera.height
        corners = apply_transform(T_camera_object, self._box)
        if corners[:, 2].min() < _BEHIND:
            return 0, width, 0, height
        pixels = self._camera.project(corners)
        low, high = np.floor(pixels.min(axis=0)), np.ceil(pixels.max(axis=0)) + 1
        left, top = np.clip(low, 0, [width - 1, height - 1]).astype(int).tolist()
        right, bottom = np.clip(high, 1, [width, height]).astype(int).tolist()
        more = round(margin * max(right - left, bottom - top))
        left, top = max(0, left - more), max(0, top - more)
        return left, min(width, right + more), top, min(height, bottom + more)

    def _cast(
        self, T_camera_object: NDArray[np.float64], window: tuple[int, int, int, int]
    ) -> tuple[dict[str, Any], NDArray[np.float32]]:
        """Hits, and rays [h, w, 6], mesh frame, of directions with z = 1 in the camera frame."""
        camera = self._camera
        left, right, top, bottom = window
        columns, rows = np.arange(left, right), np.arange(top, bottom)
        # Directions with z = 1 make the ray parameter the depth itself.
        rotation = T_camera_object[:3, :3]
        x = ((columns - camera.cx) / camera.fx)[:, None] * rotation[0]
        y = ((rows - camera.cy) / camera.fy)[:, None] * rotation[1]
        rays = np.empty((len(rows), len(columns), 6), dtype=np.float32)
        rays[..., :3] = invert_transform(T_camera_object)[:3, 3]
        for k in range(3):  # one by one: sums of many short rows take three times as long
            rays[..., 3 + k] = x[:, k] + y[:, None, k] + rotation[2, k]
        return self._scene.cast_rays(o3d.core.Tensor.from_numpy(rays), THREADS), rays


def depth_window(patch: DepthPatch, margin: int) -> tuple[NDArray[np.float32], tuple[int, int]]:
    """The depth image of the patch's rectangle grown by `margin` pixels, 0 where nothing was hit.

    Returns:
        f4 [h, w], and the column and row of its first pixel, which may lie outside the image.
    """
    left, top = int(patch.u.min()) - margin, int(patch.v.min()) - margin
    size = int(patch.v.max()) - top + margin + 1, int(patch.u.max()) - left + margin + 1
    window = np.zeros(size, dtype=np.float32)
    window[patch.v - top, patch.u - left] = patch.depth
    return window, (left, top)


def depth_image(patch: DepthPatch, camera: Camera) -> NDArray[np.float32]:
    """The whole depth image [height, width] of a patch, 0 where nothing was hit."""
    image = np.zeros((camera.height, camera.width), dtype=np.float32)
    image[patch.v, patch.u] = patch.depth
    return image
