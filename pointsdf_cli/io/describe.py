"""What is in a file that rgrasp made or reads, in words and numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.hdf5 import open_hdf5, unreadable
from pointsdf_cli.io.meshes import MESH_SUFFIXES, load_mesh


def describe(path: Path | str) -> dict[str, Any]:
    """`{"facts": {...}, "datasets": {name: {"dtype", "shape", "units", "frame"}}}` of one file.

    Raises:
        InputError: No such file, damaged, or of no kind that rgrasp knows.
    """
    path = Path(path)
    if not path.exists():
        raise InputError("no such file", where=path)
    if path.suffix.lower() in (".h5", ".hdf5"):
        return _hdf5(path)
    if path.suffix.lower() in MESH_SUFFIXES:
        return _mesh(path)
    raise InputError(
        "is of no kind that rgrasp knows",
        where=path,
        allowed="an artifact (.h5) or a mesh (" + ", ".join(MESH_SUFFIXES) + ")",
    )


def _hdf5(path: Path) -> dict[str, Any]:
    try:
        return _contents(path)
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise unreadable(path, error) from error


def _contents(path: Path) -> dict[str, Any]:
    with open_hdf5(path) as file:
        facts = {name: _plain(value) for name, value in file.attrs.items()}
        datasets: dict[str, Any] = {}

        def visit(name: str, item: h5py.HLObject) -> None:
            if isinstance(item, h5py.Dataset):
                datasets[name] = {
                    "dtype": str(item.dtype),
                    "shape": list(item.shape or ()),
                    "units": str(item.attrs.get("units", "")),
                    "frame": str(item.attrs.get("frame", "")),
                }

        file.visititems(visit)
    return {"facts": facts, "datasets": datasets}


def _mesh(path: Path) -> dict[str, Any]:
    mesh = load_mesh(path)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    facts = {
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "extents [m]": (high - low).round(5).tolist(),
        "centre [m]": ((low + high) / 2).round(5).tolist(),
        "repair": mesh.repair,
        "sha256": mesh.sha256,
    }
    return {"facts": facts, "datasets": {}}


def _plain(value: Any) -> Any:
    """What JSON can hold, of whatever an attribute may be."""
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if isinstance(value, bytes):
        return value.decode(errors="replace")
    return value if isinstance(value, (str, int, float, bool)) else str(value)
