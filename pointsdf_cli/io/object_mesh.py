"""Generated meshes as PLY files that carry their own description in a header comment."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pointsdf_cli.io.atomic import atomic_path
from pointsdf_cli.io.input_files import open_input
from pointsdf_cli.io.ply import FACE, write_ply

KEY = "rgrasp_object"
MARK = f"comment {KEY} "
_LONGEST_HEADER = 1 << 16
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
    text = json.dumps(about, ensure_ascii=True, sort_keys=True)
    with atomic_path(path) as temporary:
        write_ply(temporary, vertices, comments={"unit": "metre", KEY: text}, faces=faces)


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
        body = counts["vertex"] * _VERTEX_BYTES + counts["face"] * FACE.itemsize
    except (ValueError, KeyError, IndexError):
        return None
    if path.stat().st_size != len(header) + len(end) + body:
        return None
    return about if isinstance(about, dict) else None
