"""Features of a shape network for the grasps of one file, cached because they are slow to
compute."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.io.hdf5 import read_artifact, write_artifact
from pointsdf_cli.io.layout import Column

SCHEMA, VERSION = "grasp-evidence", 1

LAYOUT = {
    "embedding": Column("f4 [G, E]"),
    "centre": Column("f8 [G, 3]", "m", "world"),
    "scale": Column("f8 [G]", "1/m"),
    "size": Column("f4 [G, 3]", "m", "camera"),
    "distance": Column("f4 [G, P]", "m", "world"),
    "body": Column("f4 [G, S]", "m", "world"),
}


@dataclass(frozen=True)
class Evidence:
    """One row for each executed grasp of a grasps file, in its order.

    Attributes:
        embedding: f4 [G, E], of the cloud.
        centre: f8 [G, 3], origin of the network's frame in the world, m.
        scale: f8 [G], network units per metre.
        size: f4 [G, 3], extents of the cloud along the camera's axes, m.
        distance: f4 [G, P], signed distances where the hand passes, m; P = 0 if not asked for.
        body: f4 [G, 6 + S], centre, centre of volume [m] and size of the reconstructed object.
    """

    embedding: NDArray[np.float32]
    centre: NDArray[np.float64]
    scale: NDArray[np.float64]
    size: NDArray[np.float32]
    distance: NDArray[np.float32]
    body: NDArray[np.float32]


def write_evidence(path: Path | str, evidence: Evidence, key: str) -> None:
    """Write one file's evidence.

    Args:
        path: The file.
        evidence: The rows.
        key: Hash of everything that it was computed from.
    """
    write_artifact(path, SCHEMA, VERSION, LAYOUT, vars(evidence), attributes={"key": key})


def read_evidence(path: Path | str) -> Evidence:
    """Read one file's evidence.

    Raises:
        InputError: Not such a file, or damaged.
    """
    return Evidence(**read_artifact(path, schema=SCHEMA, version=VERSION, names=LAYOUT).datasets)


def join_evidence(parts: list[Evidence]) -> Evidence:
    """Several files' evidence as one."""
    return Evidence(
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in LAYOUT}
    )
