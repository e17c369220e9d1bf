"""Any triangle soup to one closed, oriented, non-overlapping surface, or the reason why not."""

from __future__ import annotations

from dataclasses import dataclass

import manifold3d
import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array, Indices

REMESH_RESOLUTION = 96
"""Cells along the longest side when a surface is rebuilt from its winding numbers."""
OUTSIDE = 0.5
"""Share of an inward-facing piece's volume outside all bodies above which it is a reversed body.
Below, it is a cavity, which may break through its body's surface."""


@dataclass(frozen=True)
class ClosedMesh:
    """A closed surface that does not overlap itself.

    Attributes:
        vertices: [V, 3].
        faces: [F, 3], counter-clockwise seen from outside.
        repair: Repairs made; "none" without any.
    """

    vertices: Array
    faces: NDArray[np.int32]
    repair: str


def close_mesh(vertices: Array, faces: Indices) -> ClosedMesh:
    """Close, orient and unite a triangle soup.

    In order: as it is, where it is a manifold already; with vertices merged and doubled faces
    removed; with holes filled; with faces turned outward, piece by piece; else re-meshed where its
    generalised winding number (Jacobson et al. 2013) passes one half. Pieces that overlap or touch
    are united, cavities kept.

    Raises:
        InputError: The soup encloses no volume.
    """
    import trimesh

    whole = _as_manifold(vertices, faces)
    steps: list[str] = []
    if whole is None:
        # What no face uses would count in the size, and may be NaN.
        used, faces = np.unique(faces, return_inverse=True)
        vertices, faces = vertices[used], faces.reshape(-1, 3)
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        # Vertices first: the copies of a face in a soup have corners of their own.
        mesh.merge_vertices()
        mesh.update_faces(mesh.unique_faces() & mesh.nondegenerate_faces())
        # Turned last, since pieces that bound cavities are turned too.
        for step, mend in (
            ("vertices merged", None),
            ("holes filled", trimesh.repair.fill_holes),
            ("holes filled, faces turned outward", trimesh.repair.fix_normals),
        ):
            if mend is not None:
                mend(mesh)
            whole = _as_manifold(mesh.vertices, mesh.faces)
            if whole is not None:
                steps.append(step)
                break
    if whole is None:
        whole = _remesh(vertices, faces)
        steps.append(f"re-meshed from winding numbers at {REMESH_RESOLUTION}")
    whole, note = _unite(whole)
    if note:
        steps.append(note)
    extent = np.ptp(vertices[np.unique(faces)], axis=0).max()
    if whole.is_empty() or whole.volume() < 1e-7 * extent**3:
        raise InputError(
            "encloses no volume (a flat, empty or inside-out surface)",
            allowed="a closed surface, or one with small holes",
            hint="close it in a mesh editor, or leave it out",
        )
    mesh_out = whole.to_mesh()
    return ClosedMesh(
        np.asarray(mesh_out.vert_properties[:, :3], dtype=np.float64),
        np.asarray(mesh_out.tri_verts, dtype=np.int32),
        ", ".join(steps) or "none",
    )


def _as_manifold(vertices: Array, faces: Indices) -> manifold3d.Manifold | None:
    """The solid of an oriented manifold surface, or None where it is not one."""
    if len(faces) == 0:
        return None
    solid = _solid(vertices, faces)
    if solid.status() != manifold3d.Error.NoError or solid.is_empty():
        return None
    # An inside-out surface: turn it, rather than treat the world as solid.
    return _solid(vertices, faces[:, ::-1]) if solid.volume() < 0 else solid


def _solid(vertices: Array, faces: Indices) -> manifold3d.Manifold:
    """The solid of a surface as it is."""
    # Copies, because manifold3d takes no read-only arrays, which its own meshes are.
    corners = np.array(vertices, dtype=np.float64, order="C")
    triangles = np.array(faces, dtype=np.uint64, order="C")
    return manifold3d.Manifold(manifold3d.Mesh64(corners, triangles))


def _unite(solid: manifold3d.Manifold) -> tuple[manifold3d.Manifold, str]:
    """Overlapping pieces made one; pieces turned inward inside others stay as cavities, and what
    lies in a cavity stays, too.

    A piece turned inward outside all others is a body with reversed faces. If it were treated as a
    cavity, a mug would lose its handle.
    """
    pieces = solid.decompose()
    if len(pieces) < 2:
        return solid, ""
    bodies = [piece for piece in pieces if piece.volume() > 0]
    inward = [piece for piece in pieces if piece.volume() < 0]
    turned = [_turned(piece) for piece in inward]
    united = manifold3d.Manifold.batch_boolean(bodies, manifold3d.OpType.Add)
    outside = [(piece - united).volume() > OUTSIDE * piece.volume() for piece in turned]
    wrong = [piece for piece, is_outside in zip(turned, outside, strict=True) if is_outside]
    cavities = [piece for piece, is_outside in zip(turned, outside, strict=True) if not is_outside]
    if wrong or cavities:
        united = _hollow([*bodies, *wrong], cavities)
    count = len(bodies) + len(wrong)
    notes = [f"{len(wrong)} of {len(pieces)} pieces turned outward"] if wrong else []
    if count > 1:
        notes.append(f"{count} pieces united")
    return united, ", ".join(notes)


def _hollow(
    bodies: list[manifold3d.Manifold], cavities: list[manifold3d.Manifold]
) -> manifold3d.Manifold:
    """The union of bodies, each without the cavities inside it."""
    parts, left = list(bodies), []
    for cavity in cavities:
        around = [k for k, body in enumerate(bodies) if _is_inside(cavity, body)]
        for k in around:
            parts[k] = parts[k] - cavity
        if not around:
            left.append(cavity)
    united = manifold3d.Manifold.batch_boolean(parts, manifold3d.OpType.Add)
    for cavity in left:  # inside several overlapping bodies together
        united = united - cavity
    return united


def _is_inside(inner: manifold3d.Manifold, outer: manifold3d.Manifold) -> bool:
    """Whether a solid lies in a larger one; a cavity may break through its body's surface."""
    if outer.volume() <= inner.volume():
        return False
    box, around = np.array(inner.bounding_box()), np.array(outer.bounding_box())
    if (box[3:] < around[:3]).any() or (box[:3] > around[3:]).any():
        return False
    return bool((inner - outer).volume() <= OUTSIDE * inner.volume())


def _turned(solid: manifold3d.Manifold) -> manifold3d.Manifold:
    """A solid with every face turned over."""
    mesh = solid.to_mesh64()
    return _solid(mesh.vert_properties[:, :3], mesh.tri_verts[:, ::-1])


def _remesh(vertices: Array, faces: Indices) -> manifold3d.Manifold:
    """The level set of the winding number at one half, on a regular grid."""
    import igl
    from skimage.measure import marching_cubes

    low, high = vertices.min(axis=0), vertices.max(axis=0)
    cell = (high - low).max() / REMESH_RESOLUTION
    counts = np.ceil((high - low) / cell).astype(int) + 5
    # The half cell keeps grid points off the faces of axis-aligned boxes.
    axes = [low[k] + (np.arange(counts[k]) - 2.5) * cell for k in range(3)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    soup = np.ascontiguousarray(vertices), np.ascontiguousarray(faces, dtype=np.int64)
    winding = np.asarray(igl.fast_winding_number(*soup, grid)).reshape(counts)
    # A soup turned inward winds around its inside the other way.
    if winding.min() < -0.5 and winding.max() < 0.5:
        winding = -winding
    if winding.max() <= 0.5:
        return manifold3d.Manifold()
    points, triangles, _, _ = marching_cubes(winding, 0.5, spacing=(cell, cell, cell))
    points = points + low - 2.5 * cell
    # skimage's winding order follows the gradient; the sign of the volume says which it is.
    return _as_manifold(points, triangles) or manifold3d.Manifold()
