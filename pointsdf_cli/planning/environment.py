"""Surroundings of the object: the table and further obstacles, from a YAML file or by hand.

table: true                      # the half space below z = 0; true if left out
obstacles:
  - {name: shelf, box: [0.6, 0.3, 0.02], xyz: [0.6, 0, 0.4]}          # m; wxyz optional
  - {name: post, cylinder: [0.03, 0.5], xyz: [0.4, 0.3, 0.25]}        # radius, length along z
  - {name: lamp, sphere: [0.1], xyz: [0.5, -0.3, 0.6]}
  - {name: bin, mesh: bin.stl, scale: 1.0, xyz: [0.5, 0.3, 0]}        # beside the YAML file
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.box import thin_directions
from pointsdf_cli.geometry.frames import apply_transform, rigid, rotation_from_wxyz, transform
from pointsdf_cli.geometry.volume import enclosed_volume
from pointsdf_cli.io.meshes import load_body
from pointsdf_cli.io.untrusted import read_yaml
from pointsdf_cli.robot.shapes import Shape

if TYPE_CHECKING:
    from pointsdf_cli.planning.robot_geometry import CollisionMesh

SIZES = {"box": 3, "cylinder": 2, "sphere": 1}
SHAPES = (*SIZES, "mesh")
FLAT = 1e-5
"""Thickness [m] below which a mesh is flat: collision libraries crash on those."""
KEYS = ("name", *SHAPES, "scale", "xyz", "wxyz")


@dataclass(frozen=True)
class Obstacle:
    """One body that does not move.

    Attributes:
        name: Name used in messages.
        kind: "box", "cylinder", "sphere" or "mesh".
        size: [m]: box (x, y, z), cylinder (radius, length along z), sphere (radius,), mesh ().
        pose: [4, 4], in the world.
        vertices: [V, 3], m, of a mesh in its own frame.
        faces: [F, 3], its triangles; turned outwards where they look inwards.
        prepared: The mesh prepared for distances; made where it is needed if None.
    """

    name: str
    kind: str
    size: tuple[float, ...]
    pose: Array
    vertices: Array | None = None
    faces: NDArray[np.integer] | None = None
    prepared: CollisionMesh | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.kind not in SHAPES:
            raise InputError(f"no obstacle {self.kind!r}", allowed=", ".join(SHAPES))
        object.__setattr__(self, "pose", rigid(self.pose, f"pose of {self.name}"))
        count = SIZES.get(self.kind, 0)
        sound = all(0 < v < math.inf for v in self.size)  # False for NaN
        if len(self.size) != count or not sound:
            allowed = f"{count} sizes above 0 m"
            raise InputError(f"a {self.kind} of size {self.size}", where=self.name, allowed=allowed)
        if (self.kind == "mesh") == (self.vertices is None or self.faces is None):
            raise InputError("only a mesh, and every mesh, has triangles", where=self.name)
        if self.vertices is not None and self.faces is not None and self.prepared is None:
            self._check_triangles(np.asarray(self.vertices), np.asarray(self.faces))

    def _check_triangles(self, vertices: Array, faces: NDArray[np.integer]) -> None:
        shaped = vertices.ndim == faces.ndim == 2 and vertices.shape[1] == faces.shape[1] == 3
        if not (shaped and len(faces) and np.isfinite(vertices).all()):
            allowed = "finite vertices [V, 3] and faces [F, 3], F ≥ 1"
            raise InputError("no mesh", where=self.name, allowed=allowed)
        if not (faces.min() >= 0 and faces.max() < len(vertices)):
            what, allowed = "a face has no such vertex", f"0 to {len(vertices) - 1}"
            raise InputError(what, where=self.name, allowed=allowed)
        if len(thin_directions(vertices[np.unique(faces)], FLAT)):
            raise InputError("a flat mesh", where=self.name, allowed="one that encloses a volume")
        if enclosed_volume(vertices, faces) < 0:
            object.__setattr__(self, "faces", faces[:, ::-1])


def obstacle_mesh(obstacle: Obstacle) -> tuple[Array, NDArray[np.int64]]:
    """Vertices [V, 3] m in the world and faces [F, 3], for pictures."""
    if obstacle.vertices is None or obstacle.faces is None:
        return Shape(obstacle.kind, obstacle.size, obstacle.pose).triangulated()
    vertices = apply_transform(obstacle.pose, obstacle.vertices)
    return vertices, np.asarray(obstacle.faces, dtype=np.int64)


@dataclass(frozen=True)
class Environment:
    """Known surroundings of robot and object.

    Attributes:
        obstacles: Bodies that the robot may not touch.
        table: Whether the half space below the table is one of them.
        table_height: Height of the table [m].
    """

    obstacles: tuple[Obstacle, ...] = ()
    table: bool = True
    table_height: float = 0.0

    def __post_init__(self) -> None:
        if not math.isfinite(self.table_height):
            what = f"a table at the height {self.table_height} m"
            raise InputError(what, where="table_height", allowed="a finite number")
        names = [obstacle.name for obstacle in self.obstacles]
        if len(set(names)) != len(names) or "table" in names:
            wrong = "two obstacles share a name, or one is named table"
            raise InputError(wrong, where=", ".join(names), allowed="one name each")


def read_environment(path: Path | str) -> Environment:
    """Read an environment file.

    Raises:
        InputError: The file is missing, is not YAML, or has an invalid entry, which is named.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError("no such environment file", where=path, allowed="a YAML file")
    data = read_yaml(path) or {}
    if not isinstance(data, Mapping) or set(data) - {"table", "obstacles"}:
        raise InputError("has unknown keys", where=path, allowed="table, obstacles")
    table, entries = data.get("table", True), data.get("obstacles") or []
    if not isinstance(table, bool):
        raise InputError(f"`table` is {table!r}", where=path, allowed="true, false")
    if not isinstance(entries, list):
        raise InputError("`obstacles` is not a list", where=path, allowed="a list of obstacles")
    return Environment(tuple(_obstacle(e, i, path) for i, e in enumerate(entries)), table)


def _obstacle(entry: Any, place: int, path: Path) -> Obstacle:
    where = f"{path}: obstacles[{place}]"
    if not isinstance(entry, Mapping) or set(entry) - set(KEYS):
        raise InputError("is not an obstacle", where=where, allowed="keys " + ", ".join(KEYS))
    kinds = [kind for kind in SHAPES if kind in entry]
    if len(kinds) != 1:
        allowed = "one of " + ", ".join(SHAPES)
        raise InputError(f"has {len(kinds)} shapes", where=where, allowed=allowed)
    kind, name = kinds[0], str(entry.get("name", f"obstacle_{place}"))
    wxyz = _vector(entry, "wxyz", (1.0, 0.0, 0.0, 0.0), where)
    if abs(np.linalg.norm(wxyz) - 1) > 1e-3:
        raise InputError(f"has wxyz {wxyz.tolist()}", where=where, allowed="a unit quaternion")
    pose = transform(rotation_from_wxyz(wxyz), _vector(entry, "xyz", (0.0, 0.0, 0.0), where))
    if kind != "mesh":
        if "scale" in entry:
            raise InputError(f"a {kind} with a scale", where=where, allowed="scale with mesh only")
        size = _vector(entry, kind, (1.0,) * SIZES[kind], where)
        return Obstacle(name, kind, tuple(float(v) for v in size), pose)
    scale = _vector({"scale": [entry.get("scale", 1.0)]}, "scale", (1.0,), where)[0]
    if scale <= 0:
        raise InputError(f"has the scale {scale}", where=where, allowed="above 0")
    mesh = load_body(path.parent / str(entry["mesh"]), scale)
    return Obstacle(name, "mesh", (), pose, np.asarray(mesh.vertices), mesh.faces)


def _vector(entry: Mapping[str, Any], key: str, default: tuple[float, ...], where: str) -> Array:
    value = entry.get(key, default)
    try:
        numbers = np.array([float(v) for v in ([] if isinstance(value, str) else value)])
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if len(numbers) != len(default) or not np.isfinite(numbers).all():
        allowed = f"{len(default)} finite number(s)"
        raise InputError(f"`{key}` is {value!r}", where=where, allowed=allowed)
    return numbers
