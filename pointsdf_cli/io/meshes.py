"""Triangle meshes from any format that trimesh reads, checked, in metres, closed."""

from __future__ import annotations

import io
import logging
import re
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pointsdf_cli.choices import Unit, require_choice
from pointsdf_cli.errors import InputError, as_input_error, require_near
from pointsdf_cli.geometry.repair import close_mesh
from pointsdf_cli.io.atomic import atomic_path
from pointsdf_cli.io.input_files import (
    check_input,
    is_hidden,
    largest_input,
    read_input,
    require_suffix,
)
from pointsdf_cli.io.ply import write_ply
from pointsdf_cli.io.provenance import file_sha256

MESH_SUFFIXES = (".ply", ".obj", ".stl", ".off", ".glb", ".gltf", ".dae", ".3mf")
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}
AWAY = 100.0
"""Largest distance [m] of a thing to grasp from its origin: float32 is exact there to 4 µm."""
SMALLEST, LARGEST = 0.005, 2.0
"""Bounds [m] of the longest side of a thing to grasp: beyond them the unit is wrong."""

NARROWEST, FARTHEST = 1e-5, 1e4
"""Bounds [m] of a body that stands in the way."""

# trimesh warns on its logger of what the checks below say better. It is imported where a mesh is
# read or written: a third of a second that a cloud's reader need not wait.
logging.getLogger("trimesh").setLevel(logging.ERROR)


@dataclass(frozen=True)
class LoadedMesh:
    """A closed mesh with where it came from.

    Attributes:
        name: The file's stem.
        vertices: [V, 3], m, mesh frame.
        faces: [F, 3], counter-clockwise seen from outside.
        sha256: Hash of the file's bytes.
        repair: Repair that closed it ("none" without any).
        unit: Unit of the file.
    """

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    sha256: str
    repair: str
    unit: str = "m"

    @property
    def identity(self) -> str:
        """Hash of the file, and its unit: the same file in another unit is another object."""
        return self.sha256 if self.unit == "m" else f"{self.sha256} {self.unit}"

    @property
    def size(self) -> float:
        """The longest side of the bounding box [m]."""
        return float(np.ptp(self.vertices, axis=0).max())


def find_meshes(folder: Path | str, pattern: str = "*") -> list[Path]:
    """The mesh files at or below `folder`, sorted; `folder` may be one mesh file itself.

    Raises:
        InputError: No such folder, no meshes in it, or two that would share an artifact's name.
    """
    folder = Path(folder)
    if not folder.exists():
        raise InputError("no such folder", where=folder)
    if folder.is_file():
        if folder.suffix.lower() not in MESH_SUFFIXES:
            what = "is not a mesh file"
            raise InputError(what, where=folder, allowed="a folder, or " + ", ".join(MESH_SUFFIXES))
        return [folder]
    try:
        if Path(pattern).is_absolute():
            raise ValueError("it starts at the root")
        matching_files = list(folder.rglob(pattern))
    except ValueError as error:  # such as a**b
        what = f"{pattern!r} is not a pattern of names below the folder"
        raise InputError(what, where="--pattern", allowed="such as '*.ply'") from error
    meshes = [path for path in matching_files if path.suffix.lower() in MESH_SUFFIXES]
    found = sorted(path for path in meshes if not is_hidden(path, folder))
    if not found:
        matching = "" if pattern == "*" else f" that match {pattern}"
        raise InputError(
            f"holds no meshes{matching}", where=folder, allowed=", ".join(MESH_SUFFIXES)
        )
    by_name: dict[Path, Path] = {}
    for path in found:
        namesake = by_name.setdefault(path.with_suffix(""), path)
        if namesake is not path:
            raise InputError(
                f"two meshes of one name: {namesake.name} and {path.name}",
                where=path.parent,
                hint=f"move one of them away; or --pattern '*{path.suffix}', where there is one",
            )
    return found


def artifact_path(mesh: Path, meshes: Path | str, out: Path | str) -> Path:
    """Path of the HDF5 file that a stage writes for `mesh`: the same place below `out`."""
    meshes = Path(meshes)
    relative = mesh.relative_to(meshes) if meshes.is_dir() else Path(mesh.name)
    return Path(out) / relative.with_suffix(".h5")


def named_artifacts(found: Iterable[Path], meshes: Path, out: Path) -> dict[str, tuple[Path, Path]]:
    """Each mesh and the path of its artifact, by the artifact's name below `out`."""
    paths = {mesh: artifact_path(mesh, meshes, out) for mesh in found}
    return {p.relative_to(out).with_suffix("").as_posix(): (m, p) for m, p in paths.items()}


def load_mesh(path: Path | str, unit: str = "m") -> LoadedMesh:
    """Read one mesh file; scenes are joined, the surface is closed, the scale is checked.

    Args:
        path: The file.
        unit: The unit of its numbers, a key of `UNITS`.

    Raises:
        InputError: The file cannot be read, holds no faces or numbers that are not finite, is of
            an unlikely size (a wrong unit), or cannot be closed.
    """
    path = Path(path)
    require_choice(unit, Unit, "--unit")
    try:
        path.name.encode("utf-8")
    except UnicodeEncodeError as error:
        raise InputError("has a name that is not UTF-8", where=path, hint="rename it") from error
    vertices, faces = _surface(path)
    vertices = vertices * UNITS[unit]
    _check_size(path, vertices[np.unique(faces)], unit)
    return replace(_closed(path, vertices, faces), unit=unit)


def load_body(path: Path | str, scale: float = 1.0) -> LoadedMesh:
    """Load a mesh of any size as an obstacle, otherwise as `load_mesh`.

    Args:
        path: The file.
        scale: Metres for each of its numbers.

    Raises:
        InputError: As `load_mesh`, but for sizes from a hundredth of a millimetre to kilometres.
    """
    path = Path(path)
    vertices, faces = _surface(path)
    _check_extent(vertices, faces, scale, path)
    return _closed(path, vertices * scale, faces)


def closed_body(
    vertices: NDArray[np.float64], faces: NDArray[np.integer], where: object
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Vertices [V, 3] m and faces [F, 3] of a closed body from those of an obstacle.

    Raises:
        InputError: As `load_body`.
    """
    if not len(faces):
        raise InputError("holds no faces", where=where, allowed="a triangle mesh")
    _check_extent(vertices, faces, 1.0, where)
    with as_input_error(where):
        closed = close_mesh(vertices, np.asarray(faces, dtype=np.int64))
    return closed.vertices, closed.faces


def _check_extent(
    vertices: NDArray[np.float64], faces: NDArray[np.integer], scale: float, where: object
) -> None:
    """Refuse sizes and places on which collision libraries crash."""
    used = vertices[np.unique(faces)]
    with np.errstate(over="ignore"):
        farthest = float(np.abs(used).max()) * scale
        size = float(np.ptp(used, axis=0).max()) * scale
    if not (farthest < FARTHEST and size > NARROWEST):
        what = f"is {size:.3g} m across and up to {farthest:.3g} m away, scaled by {scale:g}"
        raise InputError(what, where=where, allowed=f"{NARROWEST:g} to {FARTHEST:g} m")


def _surface(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    vertices, faces = _read(path)
    if not len(faces):
        raise InputError("holds no faces", where=path, allowed="a triangle mesh")
    if not np.isfinite(vertices[np.unique(faces)]).all():
        raise InputError("holds vertices that are NaN or infinite", where=path)
    return vertices, faces


def _closed(path: Path, vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> LoadedMesh:
    with as_input_error(path):
        closed = close_mesh(vertices, faces)
    return LoadedMesh(path.stem, closed.vertices, closed.faces, file_sha256(path), closed.repair)


def read_triangles(path: Path | str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Corners [V, 3] and faces [F, 3] as the file has them: any scale, open or closed.

    Raises:
        InputError: The file cannot be read, or holds fewer than four finite corners of faces.
    """
    path = Path(path)
    vertices, faces = _read(path)
    used = vertices[np.unique(faces)] if len(faces) else vertices[:0]
    if len(used) < 4 or not np.isfinite(used).all():
        raise InputError("holds no solid: fewer than four finite corners", where=path)
    return vertices, faces


def save_mesh(
    path: Path | str, vertices: ArrayLike, faces: ArrayLike, comments: dict[str, str] | None = None
) -> None:
    """Write a mesh [m], as a whole or not at all, in the format of the path's suffix; only PLY has
    `comments` in its header, such as `frame_comments`."""
    import trimesh

    corners, triangles = np.asarray(vertices), np.asarray(faces)
    with atomic_path(path) as temporary:
        if comments and Path(path).suffix.lower() == ".ply":
            write_ply(temporary, corners, comments=comments, faces=triangles)
        else:
            trimesh.Trimesh(corners, triangles, process=False).export(temporary)


def _read(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    check_input(path, "mesh")
    require_suffix(path, MESH_SUFFIXES, "mesh format")
    data = read_input(path, "mesh")
    kind = path.suffix.lower()
    import trimesh

    try:
        if kind == ".3mf":  # an archive may unpack to more than a mesh file may hold
            with zipfile.ZipFile(io.BytesIO(data)) as archive:
                size, most = sum(p.file_size for p in archive.infolist()), largest_input("mesh")
            if size > most:
                raise ValueError(f"unpacks to {size >> 20} MiB, more than {most >> 20}")
        # From bytes, and without materials: a mesh file must not make us open other files.
        loaded = trimesh.load_scene(
            io.BytesIO(data), file_type=kind[1:], process=False, skip_materials=True
        )
        mesh = loaded.to_mesh()
        unit = rb"<unit\b[^>]*\bmeter\s*=\s*[\"']([^\"']+)"  # of COLLADA; others state none
        stated = re.search(unit, data) if kind == ".dae" else None
        vertices = np.asarray(mesh.vertices, dtype=np.float64) * float(stated[1] if stated else 1)
        faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
        if vertices.shape[1:] != (3,):
            raise ValueError(f"vertices of {vertices.shape[1:]} numbers")
    except MemoryError:
        raise
    except Exception as error:  # trimesh's readers raise whatever the bytes provoke
        hint = "other files that it names are not opened: export it as .glb"
        raise InputError(
            f"cannot be read as {kind[1:].upper()}: damaged or cut short "
            f"({type(error).__name__}: {str(error)[:100]})",
            where=path,
            allowed="a triangle mesh: " + ", ".join(MESH_SUFFIXES),
            hint=hint if kind == ".gltf" else None,
        ) from error
    if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise InputError("has faces that name vertices it does not hold", where=path)
    return vertices, faces


def _check_size(path: Path, vertices: NDArray[np.float64], unit: str) -> None:
    size, farthest = float(np.ptp(vertices, axis=0).max()), float(np.abs(vertices).max())
    if SMALLEST <= size <= LARGEST:
        require_near(farthest, AWAY, "lies", path, "move it to the origin")
        return
    fitting = [u for u, m in UNITS.items() if SMALLEST <= size / UNITS[unit] * m <= LARGEST]
    likeliest = next((unit for unit in ("mm", "cm", *fitting) if unit in fitting), "")
    looks = f"; in {' or '.join(fitting)} it would be a thing to grasp" if fitting else ""
    raise InputError(
        f"is {size:.4g} m across when read in {unit}{looks}",
        where=path,
        allowed=f"{SMALLEST:g} to {LARGEST:g} m",
        hint=f"add --unit {likeliest}" if fitting else "scale the mesh to metres",
    )
