"""The `views` artifact: partial clouds of one mesh from many orientations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.frames import is_rigid
from pointsdf_cli.geometry.visibility import ViewEvidence
from pointsdf_cli.io.hdf5 import Artifact, attributes_as_input_error, read_artifact, write_artifact
from pointsdf_cli.io.layout import Column, Layout
from pointsdf_cli.io.view_evidence import evidence_arrays, evidence_layout, read_view_evidence

SCHEMA, VERSION = "views", 2
LAYOUT = {
    "cloud": Column("f4 [V, P, 3]", "m", "camera"),
    "T_camera_object": Column("f8 [V, 4, 4]", "1, m", "camera"),
}
EVIDENCE = evidence_layout("V")
ATTRIBUTES = ("K", "image_size", "noise", "mesh_file", "mesh_hash", "mesh_repair")
DEPTH = {"depth": Column("f4 [V, H, W]", "m", "camera", compress=True)}


@dataclass(frozen=True)
class Views:
    """V views of one mesh.

    Attributes:
        cloud: f4 [V, 1000, 3], camera frame (OpenCV), m.
        T_camera_object: f8 [V, 4, 4], the mesh frame in each camera.
        K: f8 [3, 3], pixels.
        image_size: (width, height), pixels.
        noise: Standard deviation of the depth noise at 1.5 m [m].
        mesh_file: Name of the mesh file.
        mesh_hash: SHA-256 of its bytes.
        mesh_repair: Repair that closed it.
        depth: f4 [V, height, width], m along z, 0 where nothing was hit; only with --keep-depth.
        evidence: V entries, what each view knows of the space around the object.
    """

    cloud: NDArray[np.float32]
    T_camera_object: NDArray[np.float64]
    K: NDArray[np.float64]
    image_size: tuple[int, int]
    noise: float
    mesh_file: str
    mesh_hash: str
    mesh_repair: str = "none"
    depth: NDArray[np.float32] | None = None
    evidence: tuple[ViewEvidence, ...] = ()


def write_views(
    path: Path | str, views: Views, *, seed: int, config: Mapping[str, Any] | None = None
) -> None:
    """Write `views` as one HDF5 file."""
    layout = LAYOUT | EVIDENCE | ({} if views.depth is None else DEPTH)
    arrays = vars(views) | evidence_arrays(views.evidence, len(views.cloud))
    attributes = {name: getattr(views, name) for name in ATTRIBUTES}
    write_artifact(
        path, SCHEMA, VERSION, layout, arrays, attributes=attributes, seed=seed, config=config
    )


def read_views(path: Path | str, with_depth: bool = False) -> Views:
    """Read a views file; the depth images only where asked for (they are large).

    Raises:
        InputError: Not a views file of this version.
    """
    artifact = _read(path, LAYOUT | EVIDENCE | (DEPTH if with_depth else {}))
    attributes, datasets = artifact.attributes, artifact.datasets
    evidence = read_view_evidence(path, datasets)
    with attributes_as_input_error(path):
        if not all(map(is_rigid, datasets["T_camera_object"])):
            raise ValueError("a pose that is not a rigid transform")
        width, height = (int(n) for n in attributes["image_size"])
        return Views(
            cloud=datasets["cloud"],
            T_camera_object=datasets["T_camera_object"],
            K=np.asarray(attributes["K"], np.float64).reshape(3, 3),
            image_size=(width, height),
            noise=float(attributes["noise"]),
            mesh_file=str(attributes["mesh_file"]),
            mesh_hash=str(attributes["mesh_hash"]),
            mesh_repair=str(attributes["mesh_repair"]),
            depth=datasets.get("depth"),
            evidence=evidence,
        )


@dataclass(frozen=True)
class ViewsHeader:
    """Facts about the mesh of a views file, read without its arrays.

    Attributes:
        mesh_hash: SHA-256 of the mesh file's bytes.
        unit: The unit that the mesh file was read in.
    """

    mesh_hash: str
    unit: str


def read_views_header(path: Path | str) -> ViewsHeader:
    """The mesh that a views file shows.

    Raises:
        InputError: Not a views file of this version.
    """
    artifact = _read(path, {})
    with attributes_as_input_error(path):
        digest, unit = artifact.attributes["mesh_hash"], artifact.config.get("unit", "m")
        return ViewsHeader(str(digest), str(unit))


def _read(path: Path | str, names: Layout) -> Artifact:
    return read_artifact(path, schema=SCHEMA, version=VERSION, names=names)
