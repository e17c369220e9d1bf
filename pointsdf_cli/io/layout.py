"""Layout of an artifact's datasets, and the check of a file against it.

A layout is a mapping from name to `Column`. In the shapes letters stand for lengths that must agree
wherever the same letter stands in one file; `*` for any.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import h5py

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.input_files import largest_input


class Column(NamedTuple):
    """Description of a dataset.

    Attributes:
        form: Kind of number and shape, such as `"f4 [V, 1000, 3]"`; "S" for text.
        units: Unit of the numbers, such as "m".
        frame: Frame of the numbers, such as "camera".
        compress: Worth it for images and integers; noisy floats shrink by a tenth and cost more
            time to squeeze than to compute.
    """

    form: str
    units: str = ""
    frame: str = ""
    compress: bool = False

    @property
    def kind(self) -> str:
        """Kind of number, such as "f4"."""
        return self.form.partition(" ")[0]


Layout = Mapping[str, Column]

_KINDS = {"f": "f", "i": "iu", "S": "S", "b": "b"}
_MOST_SQUEEZED = 1100
"""Largest compression ratio of gzip, about 1030: a higher one means a damaged file."""


def check_layout(path: Path, file: h5py.File, layout: Layout) -> None:
    """Refuse datasets that are not as `layout` says, before any of them is read.

    Raises:
        InputError: A group or another kind of number where an array of the layout is expected,
            another shape, lengths that do not agree, or numbers that are not stored.
    """
    lengths: dict[str, int] = {}
    for name, column in layout.items():
        _, _, shape = column.form.partition(" ")
        sides = [side.strip() for side in shape.strip("[] ").split(",") if side.strip()]
        found = _array(path, file, name)
        ok = found.dtype.kind in _KINDS[column.kind[0]] and found.shape is not None
        ok = ok and len(found.shape) == len(sides)
        for side, length in zip(sides, found.shape or (), strict=False):
            if side.isdecimal():
                ok = ok and length == int(side)
            elif side != "*":
                ok = ok and lengths.setdefault(side, length) == length
        if not ok:
            known = ", ".join(f"{side} = {n}" for side, n in lengths.items())
            raise InputError(
                f"{name} is {found.dtype} {list(found.shape or ())}",
                where=path,
                allowed=column.form + (f" with {known}" if known else ""),
            )


def check_stored(path: Path, file: h5py.File, name: str) -> None:
    """Refuse a dataset that promises far more numbers than the file can hold.

    Raises:
        InputError: It does, or `name` is no dataset.
    """
    found = _array(path, file, name)
    promised = (found.size or 0) * found.dtype.itemsize
    if promised > 1 << 20 and promised > _MOST_SQUEEZED * found.id.get_storage_size():
        raise InputError(f"{name} promises {promised} bytes that are not there", where=path)
    if promised > largest_input("artifact"):
        raise InputError(
            f"{name} unpacks to {promised >> 20} MB",
            where=path,
            allowed=f"{largest_input('artifact') >> 20} MB",
            hint="if it is what it should be: rgrasp --largest-input SIZE COMMAND …",
        )


def _array(path: Path, file: h5py.File, name: str) -> h5py.Dataset:
    found = file[name]
    if not isinstance(found, h5py.Dataset):
        raise InputError(f"{name} is a group, and a dataset is needed", where=path)
    return found
