"""Ray casting by embreex where Open3D is not installed, as on machines that only compute."""

from __future__ import annotations

import importlib.util
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np


class _Tensor:
    """The part of Open3D's tensor that the package uses: to and from NumPy."""

    def __init__(self, array: np.ndarray) -> None:
        self._array = array

    from_numpy = classmethod(lambda cls, array: cls(array))

    def numpy(self) -> np.ndarray:
        return self._array


class EmbreeScene:
    """Open3D's `RaycastingScene` for `MeshCaster`: one mesh, nearest hits."""

    def __init__(self, threads: int = 0) -> None:
        from embreex.rtcore_scene import EmbreeScene as Scene

        self._scene = Scene()

    def add_triangles(self, vertices: _Tensor, faces: _Tensor) -> None:
        """Add the mesh: f4 [V, 3] and u4 [F, 3]."""
        from embreex.mesh_construction import TriangleMesh

        places, corners = vertices.numpy(), faces.numpy().astype(np.int32)
        self._mesh = TriangleMesh(self._scene, places, corners)
        a, b, c = places[corners].swapaxes(0, 1)
        normals = np.cross(b - a, c - a)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        self._normals = normals / np.maximum(length, 1e-30)

    def cast_rays(self, rays: _Tensor, threads: int = 0) -> dict[str, _Tensor]:
        """`t_hit` and `primitive_normals` of rays [..., 6], as Open3D gives them."""
        every = rays.numpy().reshape(-1, 6)
        starts, directions = np.ascontiguousarray(every[:, :3]), np.ascontiguousarray(every[:, 3:])
        hits = self._scene.run(starts, directions, output=True)
        met = np.asarray(hits["primID"]) >= 0
        along = np.where(met, hits["tfar"], np.inf).astype(np.float32)
        normals = np.zeros((len(every), 3), np.float32)
        normals[met] = self._normals[np.asarray(hits["primID"])[met]]
        shape = rays.numpy().shape[:-1]
        return {
            "t_hit": _Tensor(along.reshape(shape)),
            "primitive_normals": _Tensor(normals.reshape(*shape, 3)),
        }


def stand_in() -> Any:
    """The part of the module `open3d` that `MeshCaster` uses."""
    return SimpleNamespace(
        t=SimpleNamespace(geometry=SimpleNamespace(RaycastingScene=EmbreeScene)),
        core=SimpleNamespace(Tensor=_Tensor),
    )


def use_embree_without_open3d() -> None:
    """Let the package cast rays by embreex if there is no Open3D."""
    if "open3d" not in sys.modules and importlib.util.find_spec("open3d") is None:
        sys.modules["open3d"] = stand_in()
