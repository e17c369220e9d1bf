"""A check that the HDF5 library lacks: a damaged heap of strings makes it loop for ever.

Strings of variable length lie in "global heap collections" (HDF5 file format, III.E): a signature,
a size, then objects with index, size and data. The last one, of index 0, is the free space. The
library advances by an object's size, so a size of 0 makes it loop for ever.
"""

from __future__ import annotations

import struct
from pathlib import Path

from pointsdf_cli.io.input_files import open_input

SEARCHED = 1 << 20
"""Bytes at the beginning of a file in which heaps are looked for: attributes come first."""
_SIGNATURE = b"GCOL\x01\x00\x00\x00"
_HEAD, _OBJECT = 16, 16


def heaps_end(path: Path) -> bool:
    """Whether a walk through each heap of strings in the file's first part ends."""
    with open_input(path, "artifact") as handle:
        data = handle.read(SEARCHED)
    at = data.find(_SIGNATURE)
    while at >= 0:
        if not _ends(data, at):
            return False
        at = data.find(_SIGNATURE, at + 1)
    return True


def _ends(data: bytes, start: int) -> bool:
    if start + _HEAD > len(data):
        return True
    end = start + struct.unpack_from("<Q", data, start + 8)[0]
    at = start + _HEAD
    while at + _OBJECT <= end:
        if at + _OBJECT > len(data):
            return True  # beyond what was read, or cut short, which the library notices
        index, _, _, size = struct.unpack_from("<HHIQ", data, at)
        if index == 0:
            return size >= _OBJECT and at + size <= end
        at += _OBJECT + -(-size // 8) * 8
    return at <= end
