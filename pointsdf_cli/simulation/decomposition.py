"""Convex pieces of a mesh for collision, cached by the mesh's content."""

from __future__ import annotations

import hashlib
import os
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from manifold3d import Error, Manifold, Mesh64
from numpy.typing import NDArray
from scipy.spatial import QhullError

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.atomic import atomic_path
from pointsdf_cli.io.meshes import LoadedMesh

VOLUME_OFF = 0.15
"""Largest relative change of volume by simplification."""
SHARES = (0.0005, 0.001, 0.002, 0.004, 0.008, 0.016)
"""Sizes of removable details, as shares of a mesh's longest side, tried in turn."""
VERSION = 4
"""Version of the pieces, to raise when a constant of this module changes; cached pieces of other
versions are ignored."""
Pieces = list[tuple[NDArray[np.float64], NDArray[np.int64]]]


CONVEX_ENOUGH = 0.93
"""Share of its convex hull from which a mesh is replaced by the hull."""
CONCAVITY = 0.06
"""CoACD's threshold: largest concavity of a piece."""
MOST_PIECES = 16
"""Largest number of pieces."""
MOST_CORNERS = 48
"""Largest number of corners of a piece."""
MOST_FACES = 2000
"""Number of faces to which the mesh is simplified first."""


def cache_folder() -> Path:
    """Cache folder of decompositions: `$RGRASP_CACHE`, else `$XDG_CACHE_HOME/rgrasp`."""
    named = os.environ.get("RGRASP_CACHE")
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "rgrasp"


def convex_pieces(mesh: LoadedMesh, cache: Path | None = None) -> Pieces:
    """Decompose a mesh into convex pieces, mesh frame.

    Args:
        mesh: A closed mesh.
        cache: Folder of earlier results; `cache_folder()` if None.

    Returns:
        For each piece its corners [V, 3] and faces [F, 3].

    Raises:
        InputError: The mesh encloses no volume.
    """
    key = hashlib.sha256(f"{mesh.identity} {VERSION}".encode()).hexdigest()
    path = (cache or cache_folder()) / "decompositions" / f"{key[:32]}.npz"
    if path.is_file():
        try:
            return _read(path)
        except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile, zlib.error):
            path.unlink(missing_ok=True)  # cut short by a crash of the machine: make it again
    pieces = decompose(mesh.vertices, mesh.faces)
    with atomic_path(path) as temporary:
        arrays: dict[str, NDArray[Any]] = {f"v{i}": v for i, (v, _) in enumerate(pieces)}
        arrays |= {f"f{i}": f for i, (_, f) in enumerate(pieces)}
        np.savez_compressed(temporary, **arrays)  # type: ignore[arg-type]
    return _read(path)


def decompose(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> Pieces:
    """Cut a closed mesh into convex pieces (Wei et al. 2022, "CoACD"); the same every time.

    Raises:
        InputError: The mesh encloses no volume.
    """
    solid = trimesh.Trimesh(vertices, faces, process=True)
    hull = trimesh.convex.convex_hull(solid.vertices)
    if solid.volume <= 0.0 or hull.volume <= 0.0:
        raise InputError("encloses no volume", allowed="a closed mesh that faces outwards")
    if solid.volume >= CONVEX_ENOUGH * hull.volume:
        return [with_few_corners(hull, MOST_CORNERS)]
    import coacd

    # Quadric simplification may open a mesh. CoACD would then rebuild it from voxels, up to a few
    # millimetres too thick, and take several times as long.
    closed = without_details(solid, MOST_FACES)
    solid = with_few_faces(solid, MOST_FACES) if closed is None else closed
    coacd.set_log_level("error")
    parts = coacd.run_coacd(
        coacd.Mesh(solid.vertices, solid.faces),
        threshold=CONCAVITY,
        max_convex_hull=MOST_PIECES,
        preprocess_mode="auto" if closed is None else "off",
        preprocess_resolution=40,
        resolution=1000,
        mcts_nodes=10,
        mcts_iterations=20,
        mcts_max_depth=2,
        decimate=True,
        max_ch_vertex=MOST_CORNERS,
        seed=1,
    )
    hulls = [hull_of(corners) for corners, _ in parts]
    pieces = [(np.asarray(h.vertices), np.asarray(h.faces)) for h in hulls if h is not None]
    if not pieces:
        raise InputError("has no convex piece of any volume")
    return pieces


def hull_of(points: NDArray[np.floating], sliver: float = 0.0) -> trimesh.Trimesh | None:
    """Convex hull of points [N, 3]; None if its volume is at most `sliver` [m³], as there is then
    nothing to collide with."""
    try:
        hull = trimesh.convex.convex_hull(np.asarray(points, dtype=float))
    except (ValueError, QhullError):
        return None
    return hull if hull.volume > sliver else None


def with_few_faces(mesh: trimesh.Trimesh, most: int) -> trimesh.Trimesh:
    """Simplify a closed mesh to about `most` faces, or to as few as keep its volume.

    Quadric simplification keeps round shapes rounder, but fails at long thin triangles such as
    those of a can's lid; then short edges are collapsed instead.
    """
    if len(mesh.faces) <= most:
        return mesh

    simple = mesh.simplify_quadric_decimation(face_count=most)
    if len(simple.faces) <= 1.2 * most and _same_volume(simple, mesh):
        return simple
    closed = without_details(mesh, most)
    return mesh if closed is None else closed


def without_details(mesh: trimesh.Trimesh, most: int) -> trimesh.Trimesh | None:
    """Collapse the shortest edges of a closed mesh until it has at most `most` faces or would lose
    volume; None if the result is not closed."""
    solid = Manifold(Mesh64(np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.uint64)))
    if solid.status() != Error.NoError:
        return None
    best = mesh
    for share in SHARES:
        if len(best.faces) <= most:
            break
        few = solid.simplify(share * float(mesh.extents.max())).to_mesh64()
        corners, faces = np.asarray(few.vert_properties), np.asarray(few.tri_verts, np.int64)
        simple = trimesh.Trimesh(corners, faces, process=False)
        if not _same_volume(simple, mesh):
            break
        best = simple
    return best


def _same_volume(simple: trimesh.Trimesh, mesh: trimesh.Trimesh) -> bool:
    return bool(abs(simple.volume - mesh.volume) <= VOLUME_OFF * abs(mesh.volume))


def with_few_corners(
    hull: trimesh.Trimesh, most: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Hull of at most `most` corners of a convex one, including its extremes."""
    if len(hull.vertices) > most:
        chosen = _spread(np.asarray(hull.vertices), most)
        hull = trimesh.convex.convex_hull(hull.vertices[chosen])
    return np.asarray(hull.vertices), np.asarray(hull.faces)


def _spread(points: NDArray[np.float64], count: int) -> NDArray[np.int64]:
    """Farthest-point sampling that starts from the six axis extremes."""
    chosen = sorted({int(i) for i in [*points.argmin(axis=0), *points.argmax(axis=0)]})
    distance = np.full(len(points), np.inf)
    for i in chosen:
        distance = np.minimum(distance, ((points - points[i]) ** 2).sum(axis=1))
    while len(chosen) < count:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, ((points - points[chosen[-1]]) ** 2).sum(axis=1))
    return np.array(chosen)


def _read(path: Path) -> Pieces:
    with np.load(path) as arrays:
        count = sum(name.startswith("v") for name in arrays.files)
        return [(arrays[f"v{i}"], arrays[f"f{i}"]) for i in range(count)]
