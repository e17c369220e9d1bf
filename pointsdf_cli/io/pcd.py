"""The PCD format of the Point Cloud Library: ascii, binary and binary_compressed, version 0.7.

No package reads it here: pypcd4 returns uninitialised memory as points where a file is cut short
(tests/test_cloud_file_damage.py).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import rotation_from_wxyz, transform
from pointsdf_cli.io.input_files import open_input, read_input
from pointsdf_cli.io.ply import RawCloud, cut_short, stacked

_HEADER_LIMIT = 1 << 14
_NO_VIEWPOINT = ["0", "0", "0", "1", "0", "0", "0"]
_NORMAL = ("normal_x", "normal_y", "normal_z")
SINGLE = ("x", "y", "z", "rgb", "rgba", *_NORMAL)
"""Fields of one number a point."""
_KINDS = {"F": "f", "I": "i", "U": "u"}


class _Header(NamedTuple):
    record: np.dtype[Any]
    length: int
    comments: dict[str, str]
    form: str
    size: int


def read_pcd(path: Path) -> RawCloud:
    """The points of a PCD file.

    A viewpoint other than the origin means that the points are in a world frame in which the
    camera stands there; the file's own default (the origin) says nothing, and the points are
    taken to be in the camera's frame.

    Raises:
        InputError: Not PCD, a damaged header, no x, y and z, or fewer points than it promises.
    """
    header = _read_header(path)
    names = header.record.names or ()
    if not {"x", "y", "z"} <= set(names):
        raise InputError(f"the points have no x, y and z, but {', '.join(names)}", where=path)
    body = read_input(path, "cloud")[header.size :]
    if header.form == "ascii":
        columns = _ascii_columns(body, header, path)
    elif header.form == "binary":
        if len(body) < header.length * header.record.itemsize:
            raise cut_short(path, header.length)
        columns = np.frombuffer(body, header.record, header.length)
    else:
        columns = _compressed_columns(body, header, path)
    points, normals = stacked(columns, "x", "y", "z", path), None
    if set(_NORMAL) <= set(names):
        normals = stacked(columns, *_NORMAL, path)
    return RawCloud(points, normals, _colours(columns, names), header.comments)


def lzf_decompress(data: bytes, size: int) -> bytes:
    """LZF (Lehmann), the compression of PCL: literals, and copies of earlier bytes.

    Args:
        data: Compressed bytes.
        size: Size of the result.

    Raises:
        ValueError: The data do not unpack to that size.
    """
    out = bytearray()
    at, end = 0, len(data)
    while at < end:
        control = data[at]
        at += 1
        if control < 32:  # a run of literals
            out += data[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        if at + 1 + (length == 7) > end:
            raise ValueError("ends inside a copy")
        if length == 7:
            length += data[at]
            at += 1
        start = len(out) - ((control & 31) << 8 | data[at]) - 1
        at += 1
        length += 2
        if start < 0 or len(out) + length > size:
            raise ValueError("copies from outside")
        # The copy may overlap what it writes: it then repeats.
        piece = out[start : start + length]
        out += (piece * (length // len(piece) + 1))[:length]
    if len(out) != size:
        raise ValueError("is of another size")
    return bytes(out)


def _read_header(path: Path) -> _Header:
    with open_input(path, "cloud") as handle:
        head = handle.read(_HEADER_LIMIT)
    fields: dict[str, list[str]] = {}
    at = 0
    while "DATA" not in fields:
        newline = head.find(b"\n", at)
        if newline < 0:
            raise InputError("is not a PCD file (its header has no DATA line)", where=path)
        line = head[at:newline].decode("ascii", errors="replace").strip()
        at = newline + 1
        if line and not line.startswith("#"):
            key, *words = line.split()
            fields[key] = words
    try:
        record = _record(fields)
        counted = ("POINTS",) if "POINTS" in fields else ("WIDTH", "HEIGHT")
        count = math.prod(int(fields[name][0]) for name in counted)
        viewpoint = [float(word) for word in fields.get("VIEWPOINT", _NO_VIEWPOINT)]
        form = fields["DATA"][0]
        comments = _viewpoint_comments(viewpoint)
    except (KeyError, IndexError, ValueError, TypeError) as error:
        raise InputError(f"the PCD header is damaged ({error})", where=path) from error
    if form not in ("ascii", "binary", "binary_compressed") or count < 0:
        what = f"unknown PCD data {form!r}, {count} points"
        raise InputError(what, where=path, allowed="ascii, binary, binary_compressed")
    return _Header(record, count, comments, form, at)


def _record(fields: dict[str, list[str]]) -> np.dtype[Any]:
    names = fields["FIELDS"]
    counts = fields.get("COUNT", ["1"] * len(names))
    columns: list[Any] = []
    for k, (name, size, kind, repeat) in enumerate(
        zip(names, fields["SIZE"], fields["TYPE"], counts, strict=True)
    ):
        # Padding fields are all called "_".
        unique = name if name not in names[:k] and name != "_" else f"{name}#{k}"
        scalar = f"<{_KINDS[kind]}{int(size)}"
        times = int(repeat)
        if times < 1 or (times > 1 and name in SINGLE):
            raise ValueError(f"COUNT {times} of {name}")
        columns.append((unique, scalar) if times == 1 else (unique, scalar, (times,)))
    return np.dtype(columns)


def _viewpoint_comments(viewpoint: list[float]) -> dict[str, str]:
    place, wxyz = np.array(viewpoint[:3]), np.array(viewpoint[3:])
    if len(viewpoint) != 7 or not np.isfinite(viewpoint).all() or not np.linalg.norm(wxyz):
        raise ValueError("VIEWPOINT is not x y z qw qx qy qz")
    if np.array_equal(place, (0, 0, 0)) and not wxyz[1:].any():
        return {}
    pose = transform(rotation_from_wxyz(wxyz), place)
    return {"frame": "world", "T_world_camera": " ".join(repr(float(v)) for v in pose.ravel())}


def _ascii_columns(body: bytes, header: _Header, path: Path) -> Any:
    names = header.record.names or ()
    widths = [int(np.prod(header.record[name].shape)) for name in names]
    # Two bytes a number at least: a promise beyond the file's size is not worth allocating for.
    if len(body) < 2 * header.length * sum(widths) - 1:
        raise cut_short(path, header.length)
    try:
        words = body.decode("ascii").split()[: header.length * sum(widths)]
        table = np.array(words, np.float64).reshape(header.length, sum(widths))
    except ValueError as error:
        raise InputError(
            f"the points are not {header.length} rows of numbers: damaged or cut short", where=path
        ) from error
    starts = np.cumsum(widths) - widths
    columns = {name: table[:, start] for name, start in zip(names, starts, strict=True)}
    for name, column in columns.items():
        kind = header.record[name].base
        # Of a packed colour that is written as a whole number, the number's bits count.
        if kind.kind in "iu" and kind.itemsize <= 4 and np.isfinite(column).all():
            limits = np.iinfo(kind)
            columns[name] = np.clip(column, limits.min, limits.max).astype(kind)
    return columns


def _compressed_columns(body: bytes, header: _Header, path: Path) -> Any:
    packed, unpacked = np.frombuffer(body[:8].ljust(8, b"\0"), "<u4")
    if unpacked != header.length * header.record.itemsize or len(body) < 8 + int(packed):
        raise cut_short(path, header.length)
    try:
        data = lzf_decompress(body[8 : 8 + int(packed)], int(unpacked))
    except ValueError as error:
        raise InputError(f"the compressed points are damaged ({error})", where=path) from error
    columns, at = {}, 0
    for name in header.record.names or ():  # field after field, not point after point
        kind = header.record[name]
        columns[name] = np.frombuffer(data, kind, header.length, offset=at)
        at += kind.itemsize * header.length
    return columns


def _colours(columns: Any, names: tuple[str, ...]) -> NDArray[np.uint8] | None:
    """Packed 0xRRGGBB of PCL: bits that matter, whether the type says float or unsigned."""
    name = next((n for n in ("rgb", "rgba") if n in names), None)
    if name is None:
        return None
    packed = np.asarray(columns[name])
    bits = packed.astype(np.float32).view(np.uint32) if packed.dtype.kind == "f" else packed
    return np.stack([(bits >> shift) & 255 for shift in (16, 8, 0)], axis=-1).astype(np.uint8)
