"""Description of a file that rgrasp made or reads, in words and numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.clouds import CLOUD_SUFFIXES, read_cloud
from pointsdf_cli.io.hdf5 import flattened, open_hdf5
from pointsdf_cli.io.hdf5_objects import datasets_of
from pointsdf_cli.io.meshes import MESH_SUFFIXES, load_mesh
from pointsdf_cli.io.ply import ply_has_faces

SUFFIXES = tuple(dict.fromkeys([".h5", *CLOUD_SUFFIXES, *MESH_SUFFIXES]))
"""Suffixes of the files that can be described."""


def describe(path: Path | str, unit: str = "m") -> dict[str, Any]:
    """`{"facts": {...}, "datasets": {name: {"dtype", "shape", "units", "frame"}}}` of one artifact.

    Args:
        path: An artifact, a cloud, a mesh, or the directory of a checkpoint.
        unit: Unit of a cloud's or mesh's coordinates; facts are in metres.

    Raises:
        InputError: No such file, damaged, or of no kind that rgrasp knows.
    """
    path = Path(path)
    if not path.exists():
        raise InputError("no such file", where=path)
    if (path / "config.json").is_file():
        return _checkpoint(path)
    suffix = "" if path.is_dir() else path.suffix.lower()
    if suffix in (".h5", ".hdf5"):
        return _hdf5(path)
    if suffix and is_cloud(path):
        return _cloud(path, unit)
    if suffix in MESH_SUFFIXES:
        return _mesh(path, unit)
    raise InputError(
        "is of no kind that rgrasp knows",
        where=path,
        allowed="an artifact, a cloud, a mesh (" + ", ".join(SUFFIXES) + ") or a checkpoint",
    )


def is_cloud(path: Path) -> bool:
    """Whether a file that exists is a cloud by its suffix, and a PLY by its having no faces."""
    suffix = path.suffix.lower()
    return not ply_has_faces(path) if suffix == ".ply" else suffix in CLOUD_SUFFIXES


def _checkpoint(path: Path) -> dict[str, Any]:
    from pointsdf_cli.io.checkpoints import read_checkpoint  # torch takes a second

    checkpoint = read_checkpoint(path)
    datasets = {
        name: _dataset(str(tensor.dtype).removeprefix("torch."), tensor.shape, {})
        for name, tensor in sorted(checkpoint.weights.items())
    }
    facts = flattened(checkpoint.config)
    facts["weights"] = sum(tensor.numel() for tensor in checkpoint.weights.values())
    return {"facts": facts, "datasets": datasets}


def _cloud(path: Path, unit: str) -> dict[str, Any]:
    cloud = read_cloud(path, unit, drop_invalid=True)
    facts = {
        "points": len(cloud.points),
        **_box(cloud.points),
        "normals": cloud.normals is not None,
        "colours": cloud.colours is not None,
        "frame": cloud.frame,
        "T_world_camera": None if cloud.T_world_camera is None else cloud.T_world_camera.tolist(),
    }
    return {"facts": facts, "datasets": {}}


def _box(points: NDArray[np.floating]) -> dict[str, list[float]]:
    low, high = points.min(axis=0), points.max(axis=0)
    return {
        "extents [m]": (high - low).round(5).tolist(),
        "centre [m]": ((low + high) / 2).round(5).tolist(),
    }


def _hdf5(path: Path) -> dict[str, Any]:
    with open_hdf5(path) as file:
        facts = {name: _plain(value) for name, value in file.attrs.items()}
        datasets = {
            name: _dataset(str(item.dtype), item.shape or (), item.attrs)
            for name, item in sorted(datasets_of(path, file).items())
        }
    return {"facts": facts, "datasets": datasets}


def _dataset(dtype: str, shape: Sequence[int], attributes: Mapping[str, Any]) -> dict[str, Any]:
    told = {name: str(attributes.get(name, "")) for name in ("units", "frame")}
    return {"dtype": dtype, "shape": list(shape)} | told


def _mesh(path: Path, unit: str) -> dict[str, Any]:
    mesh = load_mesh(path, unit)
    facts = {
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        **_box(mesh.vertices),
        "repair": mesh.repair,
        "sha256": mesh.sha256,
    }
    return {"facts": facts, "datasets": {}}


def _plain(value: Any) -> Any:
    """An attribute's value as JSON."""
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if isinstance(value, bytes):
        return value.decode(errors="replace")
    return value if isinstance(value, (str, int, float, bool)) else str(value)
