"""Clouds as plain tables: text (XYZ, TXT, CSV) and NumPy arrays.

Titles say which columns are x, y and z, normals (nx ny nz) and colours (r g b, or red green blue).
Without them three columns are x y z; six are x y z and a normal where every row's last three have
unit length, or a colour where they are whole numbers from 0 to 255. Further columns are left out.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from io import TextIOWrapper
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.input_files import open_input
from pointsdf_cli.io.ply import RawCloud
from pointsdf_cli.io.untrusted import read_npy_array

MOST_COLUMNS = 16
"""A row of more numbers is a row of an image, and no point."""

MOST_BESIDE, A_ROW = 6, 50
"""An array of at most so many numbers on one side and at least so many on the other holds points:
no depth image is that narrow."""

_HEAD_LINES = 100
"""Largest number of comment and title lines."""
_LONGEST_LINE = 1 << 20
"""Characters; a row of a depth image, which is told apart, is shorter."""


def read_xyz(path: Path) -> RawCloud:
    """Numbers in columns, separated by blanks, commas or semicolons; `#` begins a comment.

    Raises:
        InputError: Not text, no numbers, or rows of different lengths.
    """
    try:
        with TextIOWrapper(open_input(path, "cloud"), encoding="utf-8-sig") as handle:
            head = list(itertools.islice(_lines(handle, path), _HEAD_LINES))
        first = next((i for i, row in enumerate(head) if _is_numbers(row)), None)
        if first is None:
            raise InputError("holds no rows of numbers", where=path, allowed="x y z in each row")
        with TextIOWrapper(open_input(path, "cloud"), encoding="utf-8-sig") as handle:
            table = np.loadtxt(
                _lines(handle, path),
                delimiter=next((s for s in ",;" if s in _before_comment(head[first])), None),
                skiprows=first,
                ndmin=2,
                comments=("#", "//"),
            )
    except UnicodeDecodeError as error:
        raise InputError("is not text", where=path, allowed="x y z in each row") from error
    except ValueError as error:
        raise InputError(
            f"cannot be read as a table: {str(error)[:80]}",
            where=path,
            allowed="as many numbers in every row, at least three",
        ) from error
    comments = {}
    for line in head[:first]:
        key, _, value = line.lstrip("#/ ").partition(" ")
        comments[key.rstrip(":")] = value.strip()
    titles = _words(head[first - 1].lstrip("#/ ")) if first else []
    if table.shape[1] > MOST_COLUMNS and not {"x", "y", "z"} <= set(titles):
        raise InputError(
            f"has rows of {table.shape[1]} numbers: a depth image rather than points",
            where=path,
            allowed="x y z in each row, or a row of titles with x, y and z",
            hint="store it as NPY; rgrasp cloud DEPTH.npy --intrinsics K.json makes a cloud of it",
        )
    if len(titles) == table.shape[1] and {"x", "y", "z"} <= set(titles):
        return _from_titles(table, titles, comments)
    remark = first and head[first - 1].lstrip().startswith(("#", "/"))  # may be any sentence
    if not remark and len(titles) == table.shape[1] > 3:
        *some, last = [title for title in ("x", "y", "z") if title not in titles]
        named = f"{', '.join(some)} or {last}" if some else last
        raise InputError(
            f"has columns {', '.join(titles)}, none of them named {named}",
            where=path,
            allowed="a header row with x, y and z; without one the first three columns are x, y, z",
        )
    return _from_table(table, comments, path)


def holds_points(path: Path) -> bool:
    """Whether an NPY file has the shape of points (a point a row, a column or a pixel), not that of
    a depth image; False for one that cannot be read."""
    try:
        shape = read_npy_array(path, "cloud").shape
    except InputError:
        return False
    if len(shape) == 2:
        return min(shape) <= MOST_BESIDE and max(shape) >= A_ROW
    return len(shape) == 3 and 3 <= shape[2] <= MOST_COLUMNS


def read_npy(path: Path) -> RawCloud:
    """An array [N, 3], [N, 6] or an image of points [height, width, 3].

    Raises:
        InputError: Damaged, holds Python objects, or is of another shape or type.
    """
    array = read_npy_array(path, "cloud")
    wrong, hint = "", None
    columns = array.shape[-1] if array.ndim else 0
    if array.ndim == 2 and columns > MOST_COLUMNS and len(array) <= MOST_BESIDE:
        wrong, hint = ": a point a column", "store it transposed"
    elif array.ndim == 2 and columns > MOST_COLUMNS:
        wrong = ": a depth image rather than points"
        hint = f"rgrasp cloud {path} --intrinsics K.json makes a cloud of it"
    elif not (array.dtype.kind in "fiu" and array.ndim in (2, 3) and 3 <= columns <= MOST_COLUMNS):
        wrong = f" of {array.dtype}"
    if wrong:
        allowed = "numbers [N, 3], [N, 6] or [height, width, 3]"
        raise InputError(
            f"is an array {list(array.shape)}{wrong}", where=path, allowed=allowed, hint=hint
        )
    return _from_table(array.reshape(-1, array.shape[-1]).astype(np.float64), {}, path)


def _before_comment(line: str) -> str:
    return line.partition("#")[0].partition("//")[0]


def _lines(handle: TextIO, path: Path) -> Iterator[str]:
    """The lines of a text, none of which may take more memory than a row of numbers needs.

    Raises:
        InputError: A line is longer, as one of binary data may be.
    """
    while line := handle.readline(_LONGEST_LINE):
        if len(line) == _LONGEST_LINE:
            what = f"has a line of more than {_LONGEST_LINE} characters"
            raise InputError(what, where=path, allowed="text with x y z in each row")
        yield line


def _words(row: str) -> list[str]:
    """The entries of a row; an empty one, as a table's first title may be, is "" ."""
    for separator in ",;":
        if separator in row:
            return [word.strip().strip('"').lower() for word in row.split(separator)]
    return row.lower().split()


def _from_titles(
    table: NDArray[np.float64], titles: list[str], comments: dict[str, str]
) -> RawCloud:
    """The columns that are called x y z, wherever they stand, and normals and colours."""

    def columns(*names: str) -> NDArray[np.float64] | None:
        if not set(names) <= set(titles):
            return None
        return table[:, [titles.index(name) for name in names]]

    points = columns("x", "y", "z")
    assert points is not None
    colours = columns("r", "g", "b")
    colours = columns("red", "green", "blue") if colours is None else colours
    return RawCloud(
        points,
        columns("nx", "ny", "nz"),
        None if colours is None else _as_colours(colours, _seen(points)),
        comments,
    )


def _seen(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Rows that are points: others, NaN where a camera saw nothing, say nothing of the columns."""
    return np.asarray(np.isfinite(points).all(axis=1))


def _as_colours(values: NDArray[np.float64], seen: NDArray[np.bool_]) -> NDArray[np.uint8] | None:
    """[N, 3] as colours, or None: shares of one, or nothing that is a colour."""
    told = values[seen]
    if not np.array_equal(told, np.clip(np.round(told), 0, 255)):
        return None
    return np.where(seen[:, None], values, 0).astype(np.uint8)


def _is_numbers(row: str) -> bool:
    words = _before_comment(row).replace(",", " ").replace(";", " ").split()
    try:
        return len([float(word) for word in words]) >= 3
    except ValueError:
        return False


def _from_table(table: NDArray[np.float64], comments: dict[str, str], path: Path) -> RawCloud:
    if table.shape[1] < 3:
        raise InputError(f"rows of {table.shape[1]} numbers", where=path, allowed="at least x y z")
    normals = colours = None
    if table.shape[1] >= 6:
        rest, seen = table[:, 3:6], _seen(table[:, :3])
        if np.allclose(np.linalg.norm(rest[seen], axis=1), 1, atol=1e-3):
            normals = rest
        else:
            colours = _as_colours(rest, seen)
    return RawCloud(table[:, :3], normals, colours, comments)
