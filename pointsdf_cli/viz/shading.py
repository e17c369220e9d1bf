"""Shaded pictures of meshes by ray casting: no display, no graphics driver."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.geometry.open3d_core import o3d
from pointsdf_cli.geometry.primitives import box

SKY = np.array([1.0, 1.0, 1.0])
LIGHT = np.array([0.35, -0.45, 1.0]) / np.linalg.norm([0.35, -0.45, 1.0])
"""Direction towards the light, in the world (z up)."""


@dataclass(frozen=True)
class Painted:
    """A mesh in the world with one colour.

    Attributes:
        vertices: [V, 3], world, m.
        faces: [F, 3].
        colour: Red, green and blue in [0, 1].
        unlit: Show exactly that colour, without shading.
    """

    vertices: NDArray[np.floating]
    faces: NDArray[np.integer]
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


class Stage:
    """Painted meshes, ready to be looked at from several sides.

    Args:
        meshes: Visible meshes.
        translucent: The first so many let the others show through.
        opacity: Share of these in what is seen, in [0, 1].
    """

    def __init__(
        self, meshes: Sequence[Painted], translucent: int = 0, opacity: float = 1.0
    ) -> None:
        self._scene = o3d.t.geometry.RaycastingScene()
        for mesh in meshes:
            vertices, faces = mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32)
            self._scene.add_triangles(vertices, faces)
        self._colours = np.array([mesh.colour for mesh in meshes], dtype=np.float32)
        self._unlit = np.array([mesh.unlit for mesh in meshes])
        self._translucent, self._opacity = translucent, opacity
        self._without = Stage(meshes[translucent:]) if translucent else None

    def image(
        self,
        T_world_camera: NDArray[np.float64],
        size: tuple[int, int] = (480, 480),
        field_of_view: float = 0.7,
        oversampling: int = 2,
    ) -> NDArray[np.uint8]:
        """A picture [height, width, 3] with diffuse light and hard shadows.

        A ray for every second pixel first; for every pixel, and more, only where neighbours differ:
        at edges and shadows.

        Args:
            T_world_camera: OpenCV camera in the world, from `look_at`.
            size: (width, height) in pixels.
            field_of_view: Vertical [rad].
            oversampling: Rays a pixel along each axis, at edges.
        """
        width, height = size

        def seen(u: NDArray[np.floating], v: NDArray[np.floating]) -> list[NDArray[np.float32]]:
            focal = height / 2 / np.tan(field_of_view / 2)
            x, y = (u - width / 2) / focal, (v - height / 2) / focal
            ways = np.stack([x, y, np.ones_like(x)], axis=-1) @ T_world_camera[:3, :3].T
            ways /= np.sqrt((ways**2).sum(axis=-1, keepdims=True))
            return self._layers(T_world_camera[:3, 3], ways.astype(np.float32))

        layers = _every_second(seen, width, height)
        if oversampling > 1:
            edges = [_edges(layer) for layer in layers]
            rows, columns = np.nonzero(np.logical_or.reduce(edges))
            offsets = (np.arange(oversampling) + 0.5) / oversampling
            across, down = (o.ravel() for o in np.meshgrid(offsets, offsets))
            finer = seen((columns[:, None] + across).ravel(), (rows[:, None] + down).ravel())
            for layer, edge, fine in zip(layers, edges, finer, strict=True):
                own = edge[rows, columns]
                mean = fine.reshape(len(rows), oversampling**2, 3)[own].mean(axis=1)
                layer[rows[own], columns[own]] = mean
        pictures = [(np.clip(layer, 0, 1) * 255).astype(np.uint8) for layer in layers]
        if len(pictures) == 1:
            return pictures[0]
        front, back = (picture.astype(np.float32) for picture in pictures)
        mixed = self._opacity * front + (1 - self._opacity) * back
        return np.asarray(mixed, dtype=np.uint8)

    def _layers(
        self, origin: NDArray[np.float64], directions: NDArray[np.float32]
    ) -> list[NDArray[np.float32]]:
        """Colours [N, 3] along directions [N, 3], and those without what is translucent."""
        colours, hidden = self._seen(origin, directions)
        if self._without is None:
            return [colours]
        behind = colours.copy()
        # Where nothing translucent is hit or throws a shadow, both are the same.
        behind[hidden], _ = self._without._seen(origin, directions[hidden])
        return [colours, behind]

    def _seen(
        self, origin: NDArray[np.float64], directions: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
        """Colours [N, 3] along directions [N, 3] of unit length; and which of them may come of what
        is translucent."""
        colours = np.empty((len(directions), 3), dtype=np.float32)
        colours[:] = SKY
        hits = self._scene.cast_rays(_rays(origin, directions))
        depth = hits["t_hit"].numpy()
        hit = np.flatnonzero(np.isfinite(depth))
        which = hits["geometry_ids"].numpy()[hit]
        normals, toward = hits["primitive_normals"].numpy()[hit], directions[hit]
        facing = np.einsum("ij,ij->i", normals, toward)
        # Light the visible side, also of faces seen from inside.
        normals *= -np.sign(facing)[:, None]
        light = LIGHT.astype(np.float32)
        diffuse = np.clip(normals @ light, 0, 1)
        # Faces turned away from the light are dark without a shadow test.
        bright = np.flatnonzero(diffuse > 0)
        places = origin.astype(np.float32) + depth[hit[bright], None] * toward[bright]
        toward_light = np.broadcast_to(light, places.shape)
        # Whether anything is hit is quicker than what is hit first.
        rays = _rays(places + 1e-4 * normals[bright], toward_light)
        shadow = bright[self._scene.test_occlusions(rays).numpy()]
        diffuse[shadow] *= 0.35
        strength = 0.42 + 0.12 * normals[:, 2] + 0.5 * diffuse + 0.18 * np.abs(facing)
        strength[self._unlit[which]] = 1.0
        colours[hit] = self._colours[which] * strength[:, None]
        hidden = which < self._translucent
        hidden[shadow] = True
        return colours, hit[hidden]


def _every_second(
    seen: Callable[[NDArray[np.floating], NDArray[np.floating]], list[NDArray[np.float32]]],
    width: int,
    height: int,
) -> list[NDArray[np.float32]]:
    """Layers [height, width, 3] of what is `seen` at places u, v [N] of the image.

    Rays are cast at every second column and row. Pixels between equal neighbours get their mean,
    all others a ray of their own.
    """
    columns, rows = np.arange(width), np.arange(height)
    u, v = np.meshgrid(columns[::2] + 0.5, rows[::2] + 0.5)
    coarse = [layer.reshape(*u.shape, 3) for layer in seen(u.ravel(), v.ravel())]
    layers, doubt = [], np.zeros((height, width), dtype=bool)
    left, right = columns // 2, np.minimum((columns + 1) // 2, coarse[0].shape[1] - 1)
    upper, lower = rows // 2, np.minimum((rows + 1) // 2, coarse[0].shape[0] - 1)
    for layer in coarse:
        edge = _edges(layer)
        doubt |= (edge[:, left] | edge[:, right])[upper] | (edge[:, left] | edge[:, right])[lower]
        across = (layer[:, left] + layer[:, right]) / 2
        layers.append((across[upper] + across[lower]) / 2)
    doubt[::2, ::2] = False
    down, along = np.nonzero(doubt)
    for layer, values in zip(layers, seen(along + 0.5, down + 0.5), strict=True):
        layer[down, along] = values
    return layers


EDGE = 0.03
"""Difference of neighbouring pixels, of 1, above which more rays are cast."""


def _edges(image: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Pixels [height, width] that differ from a neighbour."""
    edges = np.zeros(image.shape[:2], dtype=bool)
    across = _differ(image[:, 1:], image[:, :-1])
    down = _differ(image[1:], image[:-1])
    edges[:, 1:] |= across
    edges[:, :-1] |= across
    edges[1:] |= down
    edges[:-1] |= down
    return edges


def _differ(one: NDArray[np.float32], other: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Pixels [height, width] of two images that differ in some colour."""
    # Colour by colour: sums of rows of three are slow.
    red, green, blue = (np.abs(one[..., k] - other[..., k]) > EDGE for k in range(3))
    return red | green | blue


def table_mesh() -> Painted:
    """The table top, a thin slab below z = 0."""
    vertices, faces = box((1.6, 1.5, 0.02))
    return Painted(vertices + (0.45, 0.0, -0.01), faces, (0.86, 0.82, 0.76))


def dots(points: ArrayLike, radius: float, colour: tuple[float, float, float]) -> Painted:
    """Points [N, 3] as octahedra of one radius [m]."""
    corners = radius * np.concatenate([np.eye(3), -np.eye(3)])
    faces = np.array([[i, j, k] for i in (0, 3) for j in (1, 4) for k in (2, 5)])
    vertices = (np.asarray(points, dtype=float)[:, None] + corners).reshape(-1, 3)
    every = (6 * np.arange(len(vertices) // 6)[:, None, None] + faces).reshape(-1, 3)
    return Painted(vertices, every, colour)


def _rays(origins: NDArray[np.floating], directions: NDArray[np.float32]) -> NDArray[np.float32]:
    rays = np.empty((len(directions), 6), dtype=np.float32)
    rays[:, :3], rays[:, 3:] = origins, directions
    return rays
