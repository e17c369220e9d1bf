"""Finish of a constructed solid: slightly uneven, standing on z = 0, checked, as arrays."""

from __future__ import annotations

import numpy as np
import scipy
from manifold3d import Error, Manifold

from pointsdf_cli.geometry.volume import enclosed_volume
from pointsdf_cli.objects.family import Draw
from pointsdf_cli.objects.refine import refine

SMALLEST_EXTENT = 0.03
LARGEST_EXTENT = 0.35
MOST_FACES = 8000
# Edges shorter than this are collapsed: they carry no shape and break in single precision.
FINEST_DETAIL = 2e-5


class UnusableShape(Exception):
    """The drawn parameters do not give a valid object; others are drawn."""


def uneven(solid: Manifold, draw: Draw, amount: float) -> Manifold:
    """Taper, bulge and ripple a solid by a smooth map, like a real, imperfect object.

    The displacement is a sum of waves no shorter than a sixth of the object, so the map cannot fold
    the surface or change its topology; walls keep their thickness to within a few percent.

    Args:
        solid: The object.
        draw: Source of the waves.
        amount: Upper bound of the displacement relative to the largest extent.
    """
    low, high = np.reshape(solid.bounding_box(), (2, 3))
    size = float((high - low).max())
    amplitude = draw.uniform("unevenness", 0.0, max(amount, 1e-6)) * size
    if amplitude < 1e-5:
        return solid
    waves = 5
    direction = draw.rng.normal(size=(waves, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    wavelength = size * np.exp(draw.rng.uniform(np.log(0.25), np.log(2.0), waves))
    push = draw.rng.normal(size=(waves, 3))
    # Longer waves are stronger, and the slope of none exceeds one in ten.
    share = np.minimum(wavelength / wavelength.max(), 0.1 * wavelength / (2 * np.pi * amplitude))
    push *= (amplitude * share / waves / np.linalg.norm(push, axis=1))[:, None]
    phase = draw.rng.uniform(0, 2 * np.pi, waves)
    number = direction * (2 * np.pi / wavelength)[:, None]

    def displace(points: np.ndarray) -> np.ndarray:
        return points + np.sin(points @ number.T + phase) @ push

    # The map bends straight edges, so they need points to bend at.
    return refine(solid, max(size / 8, 0.008)).warp_batch(displace)


def stand(solid: Manifold) -> Manifold:
    """Shift a solid so that its lowest point is at z = 0 and its box is centred on the z axis."""
    x0, y0, z0, x1, y1, _ = solid.bounding_box()
    return solid.translate((-(x0 + x1) / 2, -(y0 + y1) / 2, -z0))


def fit_size(solid: Manifold) -> Manifold:
    """Scale a solid to the nearer end of 3–35 cm if its largest extent is outside."""
    low, high = np.reshape(solid.bounding_box(), (2, 3))
    size = float((high - low).max())
    wanted = float(np.clip(size, SMALLEST_EXTENT * 1.001, LARGEST_EXTENT * 0.999))
    return solid if wanted == size else solid.scale((wanted / size,) * 3)


def limit_faces(solid: Manifold) -> Manifold:
    """Drop degenerate edges, then detail below rising tolerances until 8000 faces suffice."""
    solid = solid.simplify(FINEST_DETAIL)
    tolerance = 2 * FINEST_DETAIL
    while solid.num_tri() > MOST_FACES and tolerance < 5e-4:
        solid = solid.simplify(tolerance)
        tolerance *= 2
    return solid


def to_arrays(solid: Manifold) -> tuple[np.ndarray, np.ndarray]:
    """Vertices float32 [V, 3] and faces int32 [F, 3] of a checked solid.

    Raises:
        UnusableShape: Empty, in several pieces, of no volume, with coincident vertices, or an edge
            that is not shared by exactly two faces.
    """
    if solid.status() != Error.NoError or solid.is_empty():
        raise UnusableShape(f"status {solid.status()}, empty {solid.is_empty()}")
    mesh = solid.to_mesh()
    vertices = np.array(mesh.vert_properties[:, :3], dtype=np.float32)
    faces = np.array(mesh.tri_verts, dtype=np.int32)
    vertices, faces = weld(vertices, faces)
    problem = closed_surface_problem(vertices, faces)
    if problem:
        raise UnusableShape(problem)
    return vertices, faces


def weld(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Join vertices that coincide in single precision, and drop the faces this collapses.

    Where two surfaces merely touch, the result is not a closed surface any more: check it.
    """
    kept, first, place = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    if len(kept) == len(vertices):
        return vertices, faces
    order = np.argsort(first)
    renumbered = np.empty(len(kept), dtype=np.int32)
    renumbered[order] = np.arange(len(kept), dtype=np.int32)
    joined = renumbered[place.reshape(-1)][faces]
    whole = (joined != np.roll(joined, 1, axis=1)).all(axis=1)
    return kept[order], joined[whole]


def closed_surface_problem(vertices: np.ndarray, faces: np.ndarray) -> str:
    """Reason why the mesh is not one closed, outward-facing surface with volume; empty if it is
    one."""
    if len(np.unique(vertices, axis=0)) != len(vertices):
        return "two vertices at one place"
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    forward = edges[:, 0] * len(vertices) + edges[:, 1]
    backward = edges[:, 1] * len(vertices) + edges[:, 0]
    paired = np.array_equal(np.sort(forward), np.sort(backward))
    if len(np.unique(forward)) != len(forward) or not paired:
        return "an edge is not shared by two faces"
    joined = np.ones(len(edges), dtype=np.int8)
    graph = scipy.sparse.coo_array((joined, tuple(edges.T)), shape=(len(vertices),) * 2)
    if scipy.sparse.csgraph.connected_components(graph, directed=False)[0] != 1:
        return "more than one piece"
    if enclosed_volume(vertices, faces) <= 1e-9:
        return "no volume"
    return ""
