"""Generated meshes as PLY files that carry their own description in a header comment."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pointsdf_cli.io.atomic import atomic_path
from pointsdf_cli.io.input_files import open_input

MARK = "comment rgrasp_object "
_LONGEST_HEADER = 1 << 16
_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
_VERTEX_BYTES = 12


def write_object_mesh(
    path: Path, vertices: np.ndarray, faces: np.ndarray, about: Mapping[str, Any]
) -> None:
    """Write a binary PLY [m] with `about` as one line of JSON in its header, whole or not at all.

    Args:
        path: Ends in `.ply`.
        vertices: [V, 3], m.
        faces: [F, 3].
        about: JSON data; `read_object_about` gives it back.
    """
    header = "\n".join(
        [
            "ply",
            "format binary_little_endian 1.0",
            "comment unit metre",
            MARK + json.dumps(about, ensure_ascii=True, sort_keys=True),
            f"element vertex {len(vertices)}",
            *(f"property float {axis}" for axis in "xyz"),
            f"element face {len(faces)}",
            "property list uchar int vertex_indices",
            "end_header\n",
        ]
    )
    rows = np.empty(len(faces), dtype=_FACE)
    rows["count"], rows["corners"] = 3, faces
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        file.write(header.encode("ascii"))
        file.write(np.ascontiguousarray(vertices, dtype="<f4").tobytes())
        file.write(rows.tobytes())


def read_object_about(path: Path) -> dict[str, Any] | None:
    """The description in a file's header; None if it has none or is shorter than it says."""
    with open_input(path, "mesh") as file:
        start = file.read(_LONGEST_HEADER)
    header, end, _ = start.partition(b"end_header\n")
    lines = header.decode("ascii", errors="replace").splitlines()
    described = [line for line in lines if line.startswith(MARK)]
    if not end or not described:
        return None
    try:
        about = json.loads(described[0][len(MARK) :])
        counts = {line.split()[1]: int(line.split()[2]) for line in lines if "element " in line}
        body = counts["vertex"] * _VERTEX_BYTES + counts["face"] * _FACE.itemsize
    except (ValueError, KeyError, IndexError):
        return None
    if path.stat().st_size != len(header) + len(end) + body:
        return None
    return about if isinstance(about, dict) else None
