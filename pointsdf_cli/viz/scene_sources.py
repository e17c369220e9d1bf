"""Shared parts of artifact scenes: options, meshes by their hash, selection of frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.assets import bundled_robots
from pointsdf_cli.errors import InputError
from pointsdf_cli.io.clouds import CLOUD_SUFFIXES
from pointsdf_cli.io.describe import is_cloud
from pointsdf_cli.io.hdf5 import mesh_unit, open_hdf5, schema_of
from pointsdf_cli.io.meshes import MESH_SUFFIXES, LoadedMesh, load_mesh
from pointsdf_cli.io.provenance import file_sha256
from pointsdf_cli.robot.description import RobotDescription, load_robot
from pointsdf_cli.viz.scene import Part

MESH_COLOUR = (0.55, 0.66, 0.78)


@dataclass(frozen=True)
class SceneOptions:
    """Facts that artifacts do not contain.

    Attributes:
        robot: The robot of plans and grasps; None for the bundled one that has their joints.
        meshes: Folder with the artifacts' meshes, identified by their hash.
        most: Largest number of frames of views and grasps, spread evenly over all.
        unit: Unit of clouds and meshes.
    """

    robot: RobotDescription | None = None
    meshes: Path | None = None
    most: int = 200
    unit: str = "m"

    def __post_init__(self) -> None:
        if not 1 <= self.most <= 5000:
            raise InputError(f"{self.most} frames", where="--most", allowed="1 to 5000")

    def robot_of(self, path: Path, names: Sequence[str]) -> RobotDescription:
        """The robot of an artifact with joints of these names.

        Raises:
            InputError: The given robot, or all bundled ones, have others.
        """
        for robot in self._robots():
            if robot.joint_names == tuple(names):
                return robot
        what = f"is of a robot with the joints {_listed(names)}"
        if self.robot is not None:
            what += f", and {self.robot.name} has {_listed(self.robot.joint_names)}"
        raise InputError(what, where=path, hint=WHICH)

    def robot_with(self, path: Path, joints: int) -> RobotDescription:
        """The robot of an artifact that holds no names: the first with so many joints.

        Raises:
            InputError: None has so many.
        """
        for robot in self._robots():
            if len(robot.joint_names) == joints:
                return robot
        raise InputError(f"is of a robot with {joints} joints", where=path, hint=WHICH)

    def _robots(self) -> list[RobotDescription]:
        return [*map(load_robot, bundled_robots())] if self.robot is None else [self.robot]


WHICH = "give the robot that it was made for by --robot"
ARTIFACTS = ("views", "labels", "grasps", "plan", "trial")
"""Schemas of artifacts that have a scene."""


def kind_of(path: Path) -> str:
    """Kind of a file that can be shown: "cloud", "mesh", "robot" or one of `ARTIFACTS`.

    Raises:
        InputError: The file does not exist, or is of a kind that cannot be shown.
    """
    suffix = path.suffix.lower()
    if not path.exists():
        raise InputError("no such file", where=path)
    if path.is_dir():
        raise InputError("is a folder", where=path, allowed="one file: a cloud, mesh or artifact")
    if is_cloud(path):
        return "cloud"
    if suffix in MESH_SUFFIXES:
        return "mesh"
    if suffix in (".yaml", ".yml"):
        return "robot"
    if suffix in (".h5", ".hdf5"):
        schema = schema_of(path)
        if schema in ARTIFACTS:
            return schema
        what = f"holds {schema}, which has no picture"
        raise InputError(what, where=path, allowed=", ".join(ARTIFACTS))
    known = dict.fromkeys([*CLOUD_SUFFIXES, *MESH_SUFFIXES, ".h5", ".yaml"])
    what = f"{suffix or 'a file without suffix'} cannot be shown"
    raise InputError(what, where=path, allowed=", ".join(known))


def _listed(names: Sequence[str]) -> str:
    return f"{', '.join(names[:3])}, … ({len(names)})"


def spread(count: int, most: int) -> NDArray[np.int64]:
    """At most `most` evenly spread indices below `count`."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))


def named_mesh(artifact: Path, options: SceneOptions) -> list[Part]:
    """Mesh of an artifact as parts; empty if it is not found beside it, or in meshes/ beside its
    folder.

    Raises:
        InputError: The given folder of meshes does not hold it.
    """
    folders = [options.meshes] if options.meshes else mesh_folders(artifact)
    name, mesh = mesh_of(artifact, meshes_below(*folders), options.unit)
    if mesh is not None:
        return [Part(name, "mesh", "mesh", mesh.vertices, mesh.faces, MESH_COLOUR, opacity=0.35)]
    if options.meshes:
        raise InputError(f"does not hold {name} of {artifact}", where=f"--meshes {options.meshes}")
    return []


def mesh_folders(artifact: Path) -> list[Path]:
    """Folders in which the mesh of an artifact is looked for: its own, and meshes/ beside it."""
    here = artifact.resolve().parent
    return [here, here.parent / "meshes"]


def meshes_below(*folders: Path | None) -> Iterator[Path]:
    """Paths with a suffix of meshes below folders, of which some may be None or not exist."""
    for folder in folders:
        for path in sorted(folder.rglob("*")) if folder else ():
            if path.suffix.lower() in MESH_SUFFIXES:
                yield path


def mesh_of(
    artifact: Path, files: Iterable[Path], unit: str = "m"
) -> tuple[str, LoadedMesh | None]:
    """Name of an artifact's mesh, and that mesh if one of the files is it, by name and hash.

    Args:
        artifact: Views, labels or grasps.
        files: Paths that may be mesh files.
        unit: Unit of the mesh if the artifact's is metres.
    """
    with open_hdf5(artifact) as file:
        name, digest = str(file.attrs["mesh_file"]), str(file.attrs["mesh_hash"])
        stored = mesh_unit(file)
    for path in files:
        if path.name == name and path.is_file() and file_sha256(path) == digest:
            return name, load_mesh(path, unit if stored == "m" else stored)
    return name, None
