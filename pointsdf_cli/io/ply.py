"""The PLY format, as far as point clouds need it: ASCII and binary of both byte orders.

No package reads it here: plyfile reads the faces, too, and allocates what a damaged header promises
(tests/test_cloud_file_damage.py).
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.input_files import open_input

_HEADER_LIMIT = 1 << 16
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
"""A triangle of a written file, with its number of corners."""
_BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class RawCloud:
    """Contents of a file before any check.

    Attributes:
        points: f8 [N, 3].
        normals: f8 [N, 3], or None.
        colours: u1 [N, 3], or None.
        comments: The header's `comment KEY VALUE…` lines.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64] | None = None
    colours: NDArray[np.uint8] | None = None
    comments: dict[str, str] = field(default_factory=dict)


class _Element(NamedTuple):
    name: str
    length: int
    properties: list[tuple[str, str | None]]
    """Name and NumPy type of each; None for a list."""


class _Header(NamedTuple):
    form: str
    elements: list[_Element]
    comments: dict[str, str]
    size: int


def read_ply(path: Path) -> RawCloud:
    """The vertices of a PLY file (of a mesh too: its faces are left out).

    Raises:
        InputError: Not PLY, a damaged header, no x, y and z, or fewer vertices than it promises.
    """
    header = _read_header(path)
    names = [element.name for element in header.elements]
    if "vertex" not in names:
        raise InputError("the PLY file has no element `vertex`", where=path)
    before = header.elements[: names.index("vertex")]
    vertex = header.elements[names.index("vertex")]
    kinds = dict(vertex.properties)
    if len(kinds) != len(vertex.properties) or None in kinds.values():
        raise InputError("vertices with lists or repeated properties are not read", where=path)
    if not {"x", "y", "z"} <= kinds.keys():
        raise InputError(
            f"the vertices have no x, y and z, but {', '.join(kinds) or 'nothing'}", where=path
        )
    read = _read_ascii if header.form == "ascii" else _read_binary
    columns = read(path, header, before, vertex)
    points = stacked(columns, "x", "y", "z", path)
    normals = stacked(columns, "nx", "ny", "nz", path) if "nx" in kinds else None
    colours = None
    if {"red", "green", "blue"} <= kinds.keys():
        scale = 255.0 if str(kinds["red"]).startswith("f") else 1.0  # floats run from 0 to 1
        values = np.nan_to_num(stacked(columns, "red", "green", "blue", path) * scale)
        colours = np.clip(values, 0, 255).round().astype(np.uint8)
    return RawCloud(points, normals, colours, header.comments)


def ply_has_faces(path: Path) -> bool:
    """Whether a PLY file is a mesh and no cloud.

    Raises:
        InputError: Not PLY, or a damaged header.
    """
    return any(e.name == "face" and e.length > 0 for e in _read_header(path).elements)


def ply_comments(path: Path) -> dict[str, str]:
    """The header's `comment KEY VALUE…` lines; raises as `ply_has_faces`."""
    return _read_header(path).comments


def write_ply(
    path: Path,
    points: NDArray[np.floating],
    normals: NDArray[np.floating] | None = None,
    colours: NDArray[np.uint8] | None = None,
    comments: Mapping[str, str] | None = None,
    faces: NDArray[np.integer] | None = None,
) -> None:
    """Write vertices as binary little-endian PLY with float32 coordinates.

    Args:
        path: The file.
        points: [N, 3], m.
        normals: [N, 3], of unit length; None for none.
        colours: u1 [N, 3]; None for none.
        comments: Lines `comment KEY VALUE` of the header.
        faces: [F, 3], triangles; None for a cloud.
    """
    groups: list[tuple[str, str, Any]] = [("x y z", "<f4", points)]
    if normals is not None:
        groups.append(("nx ny nz", "<f4", normals))
    if colours is not None:
        groups.append(("red green blue", "u1", colours))
    spoken = {"<f4": "float", "u1": "uchar"}
    lines = ["ply", "format binary_little_endian 1.0"]
    lines += [f"comment {key} {value}" for key, value in (comments or {}).items()]
    lines.append(f"element vertex {len(points)}")
    lines += [f"property {spoken[t]} {name}" for names, t, _ in groups for name in names.split()]
    table = np.empty(len(points), [(name, t) for names, t, _ in groups for name in names.split()])
    for names, _, values in groups:
        for k, name in enumerate(names.split()):
            table[name] = values[:, k]
    triangles = np.empty(0 if faces is None else len(faces), FACE)
    if faces is not None:
        lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        triangles["count"], triangles["corners"] = 3, faces
    with open(path, "wb") as handle:
        handle.write(("\n".join([*lines, "end_header"]) + "\n").encode("ascii"))
        handle.write(table.tobytes() + triangles.tobytes())


def stacked(columns: Any, a: str, b: str, c: str, path: Path) -> NDArray[np.float64]:
    """Three columns as f8 [N, 3].

    Raises:
        InputError: A property is missing.
    """
    try:
        with np.errstate(invalid="ignore"):  # damaged bytes may be signalling NaNs
            return np.stack([np.asarray(columns[k], np.float64) for k in (a, b, c)], axis=1)
    except (KeyError, ValueError) as error:
        raise InputError(f"{a}, {b} and {c} are not all there", where=path) from error


def cut_short(path: Path, promised: int) -> InputError:
    """The error for a file that ends before the points it promises."""
    what = f"is damaged or cut short: the header promises {promised} points"
    return InputError(what, where=path, hint="copy or export the file again")


def _read_header(path: Path) -> _Header:
    with open_input(path, "cloud") as handle:
        head = handle.read(_HEADER_LIMIT)
    if not head.startswith(b"ply"):
        raise InputError("is not a PLY file", where=path, allowed="a file that begins with `ply`")
    end = head.find(b"end_header")
    newline = head.find(b"\n", end)
    if end < 0 or newline < 0:
        raise InputError("the PLY header has no end", where=path)
    form, comments = "", {}
    elements: list[_Element] = []
    try:
        for line in head[:end].decode("ascii", errors="replace").splitlines():
            words = line.split()
            if not words:
                continue
            if words[0] == "format":
                form = words[1]
            elif words[0] == "comment" and len(words) > 2:
                comments[words[1]] = " ".join(words[2:])
            elif words[0] == "element":
                elements.append(_Element(words[1], int(words[2]), []))
            elif words[0] == "property" and words[1] == "list":
                elements[-1].properties.append((words[4], None))
            elif words[0] == "property":
                elements[-1].properties.append((words[2], _TYPES[words[1]]))
    except (IndexError, ValueError, KeyError) as error:
        raise InputError(f"the PLY header is damaged: {line[:60]!r}", where=path) from error
    if form != "ascii" and form not in _BYTE_ORDERS:
        raise InputError(
            f"unknown PLY format {form!r}", where=path, allowed="ascii, " + ", ".join(_BYTE_ORDERS)
        )
    if any(element.length < 0 for element in elements):
        raise InputError("the PLY header promises a negative number of points", where=path)
    return _Header(form, elements, comments, newline + 1)


def _read_binary(path: Path, header: _Header, before: list[_Element], vertex: _Element) -> Any:
    order = _BYTE_ORDERS[header.form]
    offset = header.size
    for element in before:
        kinds = [kind for _, kind in element.properties]
        if None in kinds:
            raise InputError(f"lists (in {element.name}) before the vertices", where=path)
        offset += element.length * sum(np.dtype(kind).itemsize for kind in kinds if kind)
    record = np.dtype([(name, f"{order}{kind}") for name, kind in vertex.properties])
    with open_input(path, "cloud") as handle:
        if os.fstat(handle.fileno()).st_size < offset + vertex.length * record.itemsize:
            raise cut_short(path, vertex.length)
        return np.fromfile(handle, record, vertex.length, offset=offset)


def _read_ascii(path: Path, header: _Header, before: list[_Element], vertex: _Element) -> Any:
    skipped = sum(element.length for element in before)
    names = [name for name, _ in vertex.properties]
    # Two bytes a number at least: a promise beyond the file's size is not worth allocating for.
    if path.stat().st_size < 2 * len(names) * vertex.length - 1:
        raise cut_short(path, vertex.length)
    if vertex.length == 0:
        return {name: np.zeros(0) for name in names}
    with open_input(path, "cloud") as handle:
        handle.seek(header.size)
        try:
            table = np.loadtxt(
                handle, comments=None, skiprows=skipped, max_rows=vertex.length, ndmin=2
            )
        except ValueError as error:
            raise InputError("the points are not all numbers", where=path) from error
    if len(table) < vertex.length or table.shape[1] < len(names):
        raise cut_short(path, vertex.length)
    return {name: table[:, k] for k, name in enumerate(names)}
