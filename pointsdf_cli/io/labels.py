"""The `labels` artifact: points around one mesh with their signed distances."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.hdf5 import attributes_as_input_error, read_artifact, write_artifact
from pointsdf_cli.io.layout import Column

SCHEMA, VERSION = "labels", 1
LAYOUT = {"points": Column("f4 [N, 3]", "m", "mesh"), "sdf": Column("f4 [N]", "m", "mesh")}


@dataclass(frozen=True)
class Labels:
    """N labelled points of one mesh.

    Attributes:
        points: f4 [N, 3], mesh frame, m.
        sdf: f4 [N], m, negative inside.
        mesh_file: Name of the mesh file.
        mesh_hash: SHA-256 of its bytes; the views of the same mesh carry the same.
        unit: The unit that the mesh file was read in.
    """

    points: NDArray[np.float32]
    sdf: NDArray[np.float32]
    mesh_file: str
    mesh_hash: str
    unit: str = "m"


def write_labels(
    path: Path | str, labels: Labels, *, seed: int, config: Mapping[str, Any] | None = None
) -> None:
    """Write `labels` as one HDF5 file."""
    attributes = {"mesh_file": labels.mesh_file, "mesh_hash": labels.mesh_hash}
    write_artifact(
        path, SCHEMA, VERSION, LAYOUT, vars(labels), attributes=attributes, seed=seed, config=config
    )


def read_labels(path: Path | str) -> Labels:
    """Read a labels file.

    Raises:
        InputError: Not a labels file of this version, or one without a label.
    """
    artifact = read_artifact(path, schema=SCHEMA, version=VERSION, names=LAYOUT)
    if not len(artifact.datasets["sdf"]):
        raise InputError("holds no labels", where=path, hint="make it again: rgrasp label-sdf")
    if not all(np.isfinite(artifact.datasets[name]).all() for name in ("points", "sdf")):
        what = "holds labels that are NaN or infinite"
        raise InputError(what, where=path, hint="make it again: rgrasp label-sdf --force")
    with attributes_as_input_error(path):
        return Labels(
            points=artifact.datasets["points"],
            sdf=artifact.datasets["sdf"],
            mesh_file=str(artifact.attributes["mesh_file"]),
            mesh_hash=str(artifact.attributes["mesh_hash"]),
            unit=str(artifact.config.get("unit", "m")),
        )
