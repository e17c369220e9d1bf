"""Collision shapes of a link: box, cylinder, sphere and convex hull, with exact geometry.

torch and trimesh are imported where they compute: whether a robot's file can be used is known
without them, seconds earlier.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry import primitives
from pointsdf_cli.geometry.arrays import Array, Indices
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.geometry.inside import face_planes
from pointsdf_cli.geometry.primitives import Triangles
from pointsdf_cli.io.meshes import read_triangles

if TYPE_CHECKING:
    import trimesh
    from torch import Tensor

KINDS = ("box", "cylinder", "sphere", "hull")
WIDEST = 5.0
"""Largest size of a robot's link [m]: larger ones were drawn in millimetres."""
NARROWEST = 1e-3
"""Smallest size of a link's mesh [m]: smaller ones were scaled to metres twice."""


@dataclass(frozen=True)
class Shape:
    """One convex shape.

    Attributes:
        kind: One of `KINDS`.
        size: [m]: box (x, y, z), cylinder (radius, length along z), sphere (radius,), hull ().
        pose: [4, 4], the shape's own frame in the link's.
        vertices: [V, 3], corners of a hull in its own frame; None for the others.
        faces: [F, 3], triangles of a hull, seen counter-clockwise from outside.
    """

    kind: str
    size: tuple[float, ...]
    pose: Array
    vertices: Array | None = None
    faces: Indices | None = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"no shape {self.kind!r}", allowed=", ".join(KINDS))
        if any(value <= 0 for value in self.size):
            size = ", ".join(f"{value:g}" for value in self.size)
            raise InputError(f"a {self.kind} of size {size}", allowed="sizes above 0 m")

    def triangles(self) -> tuple[Array, Indices]:
        """Corners and faces of a hull, in its own frame.

        Raises:
            ValueError: The shape is no hull.
        """
        if self.vertices is None or self.faces is None:
            raise ValueError(f"a {self.kind} has no triangles of its own")
        return self.vertices, self.faces

    def bounds(self) -> Array:
        """The corners (low, high) [2, 3] of the tightest box around the shape, link frame."""
        rotation, position = self.pose[:3, :3], self.pose[:3, 3]
        if self.kind == "hull":
            corners = apply_transform(self.pose, self.triangles()[0])
            return np.stack([corners.min(axis=0), corners.max(axis=0)])
        if self.kind == "box":
            half = np.abs(rotation) @ np.array(self.size) / 2
        elif self.kind == "cylinder":
            disc = np.sqrt(np.maximum(1 - rotation[:, 2] ** 2, 0.0))
            half = self.size[0] * disc + self.size[1] / 2 * np.abs(rotation[:, 2])
        else:
            half = np.full(3, self.size[0])
        return np.stack([position - half, position + half])

    def triangulated(self, sections: int = 48) -> Triangles:
        """The shape's surface in the link's frame; curves have `sections` facets."""
        if self.kind == "box":
            vertices, faces = primitives.box(self.size)
        elif self.kind == "cylinder":
            vertices, faces = primitives.cylinder(self.size[0], self.size[1], sections)
        elif self.kind == "sphere":
            vertices, faces = primitives.sphere(self.size[0], sections)
        else:
            vertices, faces = self.triangles()
        return apply_transform(self.pose, vertices), faces

    def as_mesh(self, sections: int = 48) -> trimesh.Trimesh:
        """`triangulated` as a mesh of trimesh."""
        import trimesh

        return trimesh.Trimesh(*self.triangulated(sections), process=False)

    def signed_distance(self, points: Tensor) -> Tensor:
        """Signed distance [...] of points [..., 3] in the link's frame, negative inside.

        Exact for box, cylinder and sphere, and differentiable where the distance is. For a hull
        it is the largest distance to a face's plane: the exact sign, exact inside, and never
        more than the distance outside.
        """
        import torch

        pose = points.new_tensor(self.pose)
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        if self.kind == "sphere":
            return _norm(local) - self.size[0]
        if self.kind == "cylinder":
            radial = _norm(local[..., :2]) - self.size[0]
            q = torch.stack([radial, local[..., 2].abs() - self.size[1] / 2], dim=-1)
            return _outside_inside(q)
        if self.kind == "box":
            half = points.new_tensor(self.size) / 2
            return _outside_inside(local.abs() - half)
        normals, offsets = map(points.new_tensor, face_planes(*self.triangles()))
        return (local @ normals.T - offsets).amax(dim=-1)

    def lowest(self, rotation: Tensor, position: Tensor) -> Tensor:
        """Height [...] of the lowest point of the shape, exact, for links at (R [..., 3, 3], p)."""
        # The world's z axis in the shape's frame; the support function of the shape along it.
        pose = rotation.new_tensor(self.pose)
        centre = position[..., 2] + rotation[..., 2, :] @ pose[:3, 3]
        up = rotation[..., 2, :] @ pose[:3, :3]
        if self.kind == "sphere":
            return centre - self.size[0]
        if self.kind == "cylinder":
            reach = self.size[0] * _norm(up[..., :2]) + self.size[1] / 2 * up[..., 2].abs()
            return centre - reach
        if self.kind == "box":
            return centre - (up.abs() @ (up.new_tensor(self.size) / 2))
        return centre + (up @ up.new_tensor(self.triangles()[0]).T).amin(dim=-1)


def mesh_file(name: str, urdf: Path) -> Path:
    """The file that a URDF's mesh name means: relative to the URDF, or below its package.

    Raises:
        InputError: It is not there.
    """
    scheme, _, bare = name.rpartition("://")
    candidates = [parent / bare for parent in urdf.parents[:4]]
    if scheme == "package":  # the URDF may lie in a copy of the package under another name
        inside = bare.partition("/")[2]
        candidates += [parent / inside for parent in urdf.parents[:3]]
    for candidate in candidates:
        if os.path.isfile(candidate):  # unlike Path's, it takes names of any length
            return candidate
    raise InputError(
        f"names the mesh {name!r}, which is not there",
        where=urdf,
        allowed="a file relative to the URDF, or below a folder of the package's name above it",
    )


def mesh_shape(path: Path, scale: Array, pose: Array) -> Shape:
    """The convex hull of a mesh file, as physics engines take a link's mesh.

    Raises:
        InputError: The mesh cannot be read, has not the size of a link, or has no inside.
    """
    import trimesh
    from scipy.spatial import QhullError

    # A hull needs neither a closed surface nor metres: drawings in millimetres come with a scale.
    vertices, faces = read_triangles(path)
    corners = vertices[np.unique(faces)] * scale
    smaller, larger = (" ".join(f"{one:g}" for one in scale * by) for by in (0.001, 1000))
    require_metres(corners, "the mesh", path, f'in millimetres? Then scale="{smaller}"')
    across = float(np.ptp(corners, axis=0).max())
    if across < NARROWEST:
        what, least = f"the mesh is {across:.2g} m across", f"at least {NARROWEST:g} m"
        hint = f'drawn in metres? Then scale="{larger}"'
        raise InputError(what, where=path, allowed=least, hint=hint)
    try:
        hull = trimesh.convex.convex_hull(corners)
    except QhullError as error:
        raise InputError("is flat: it has no convex hull", where=path) from error
    return Shape("hull", (), pose, np.asarray(hull.vertices), np.asarray(hull.faces))


def require_metres(points: Array, what: str, where: object, hint: str) -> None:
    """Refuse a shape larger than `WIDEST`, whose samples would fill the memory.

    Args:
        points: [N, 3], its corners or those of a box around it, m.
        what: The shape, for the message.
        where: Its file.
        hint: Suggestion.

    Raises:
        InputError: It is larger.
    """
    across = float(np.ptp(points, axis=0).max())
    if not across <= WIDEST:
        size = f"{across:.4g} m across"
        raise InputError(f"{what} is {size}", where=where, allowed=f"up to {WIDEST:g} m", hint=hint)


def bounding_box(shapes: tuple[Shape, ...]) -> Array:
    """The corners (low, high) [2, 3] of a box around shapes, link frame."""
    corners = np.stack([shape.bounds() for shape in shapes])
    return np.stack([corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)])


def cover_points(shape: Shape, step: float) -> Array:
    """Points [N, 3] on a shape, link frame, such that no surface point is farther than `step`.

    Regular patches whose half diagonal (along the surface, so also through space) is below
    `step`.
    """
    if shape.kind == "box":
        local = _cover_box(np.array(shape.size), step)
    elif shape.kind == "cylinder":
        local = _cover_cylinder(shape.size[0], shape.size[1], step)
    elif shape.kind == "sphere":
        local = _cover_sphere(shape.size[0], step)
    else:
        import trimesh

        # Subdivided until no edge is longer: every point of a triangle is then within
        # edge / √3 of a corner. Corners of a finely drawn hull stand far denser than needed, so
        # they are thinned; both distances together stay below the step.
        fine, _ = trimesh.remesh.subdivide_to_size(
            *shape.triangles(), max_edge=0.4 * step * np.sqrt(3) * 0.999, max_iter=20
        )
        local = _thinned(fine, 0.6 * step)
    return apply_transform(shape.pose, local)


def _thinned(points: Array, radius: float) -> Array:
    """A subset of the points [N, 3] such that each point is within `radius` of a kept one."""
    from scipy.spatial import cKDTree

    near = cKDTree(points)
    left = np.ones(len(points), dtype=bool)
    kept = []
    for i in range(len(points)):
        if left[i]:
            kept.append(i)
            left[near.query_ball_point(points[i], radius)] = False
    return points[kept]


def _line(length: float, step: float) -> Array:
    """Middles of equal cells of [-length/2, length/2], each at most √2·step wide."""
    count = max(1, int(np.ceil(length / (np.sqrt(2) * step))))
    return (np.arange(count) + 0.5) / count * length - length / 2


def _cover_box(size: Array, step: float) -> Array:
    faces = []
    for axis in range(3):
        u, v = (k for k in range(3) if k != axis)
        grid = np.stack(np.meshgrid(_line(size[u], step), _line(size[v], step)), -1).reshape(-1, 2)
        for side in (-0.5, 0.5):
            face = np.empty((len(grid), 3))
            face[:, u], face[:, v], face[:, axis] = grid[:, 0], grid[:, 1], side * size[axis]
            faces.append(face)
    return np.concatenate(faces)


def _cover_cylinder(radius: float, length: float, step: float) -> Array:
    angles = _line(2 * np.pi * radius, step) / radius
    heights = _line(length, step)
    angle, height = (g.ravel() for g in np.meshgrid(angles, heights))
    side = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)
    rings = _line(radius, step) + radius / 2
    disc = []
    for ring in rings:
        # The outer edge of the ring's cells is the longest arc; it must be narrow enough too.
        edge = ring + radius / len(rings) / 2
        around = _line(2 * np.pi * edge, step) / edge
        disc.append(np.stack([ring * np.cos(around), ring * np.sin(around)], axis=1))
    flat = np.concatenate(disc)
    caps = [np.column_stack([flat, np.full(len(flat), z)]) for z in (-length / 2, length / 2)]
    return np.concatenate([side, *caps])


def _cover_sphere(radius: float, step: float) -> Array:
    rows = []
    latitudes = _line(np.pi * radius, step) / radius
    half_row = np.pi / len(latitudes) / 2
    for latitude in latitudes:
        widest = np.cos(max(0.0, abs(latitude) - half_row)) * radius
        around = _line(2 * np.pi * widest, step) / widest
        ring = radius * np.cos(latitude)
        level = np.full(len(around), radius * np.sin(latitude))
        rows.append(np.column_stack([ring * np.cos(around), ring * np.sin(around), level]))
    return np.concatenate(rows)


def _norm(vectors: Tensor) -> Tensor:
    """Euclidean length with a finite gradient at 0."""
    return (vectors.square().sum(dim=-1) + 1e-20).sqrt()


def _outside_inside(q: Tensor) -> Tensor:
    """Distance from per-axis excesses [..., K]: Euclidean outside, the nearest side inside."""
    return _norm(q.clamp(min=0)) + q.amax(dim=-1).clamp(max=0)
