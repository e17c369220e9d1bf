"""Nested dictionaries and lists with arrays in them, as one NPZ.

In the NPZ, `tree.npy` holds the JSON text, in which {"$array": "a0"} stands for the array `a0.npy`.
Nothing in it is compressed or pickled, so that what is read is never larger than what was sent.
"""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.untrusted import NPY_ERRORS, first_line, read_npy_header

REFERENCE = "$array"
MOST_ARRAYS = 10_000
_BROKEN = (*NPY_ERRORS, KeyError, RuntimeError, zipfile.BadZipFile)


def tree_to_npz(tree: Any) -> bytes:
    """The bytes of an NPZ that holds dictionaries, lists, plain values and arrays."""
    arrays: dict[str, NDArray[Any]] = {}

    def plain(node: Any) -> Any:
        if isinstance(node, np.ndarray):
            name = f"a{len(arrays)}"
            arrays[name] = node
            return {REFERENCE: name}
        if isinstance(node, dict):
            return {str(key): plain(value) for key, value in node.items()}
        if isinstance(node, (list, tuple)):
            return [plain(value) for value in node]
        if isinstance(node, np.generic):
            return node.item()
        return str(node) if isinstance(node, Path) else node

    text = json.dumps(plain(tree)).encode()
    stored = io.BytesIO()
    np.savez(stored, allow_pickle=False, tree=np.frombuffer(text, np.uint8), **arrays)
    return stored.getvalue()


def tree_of_npz(data: bytes, where: str) -> Any:
    """The tree of `tree_to_npz`.

    Args:
        data: Untrusted bytes.
        where: Its source, for messages.

    Raises:
        InputError: Damaged, compressed, of Python objects, or without the tree.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = archive.infolist()
            if len(entries) > MOST_ARRAYS:
                raise ValueError(f"{len(entries)} arrays")
            if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):
                raise ValueError("it is compressed: use numpy.savez, not savez_compressed")
            if sum(entry.file_size for entry in entries) > len(data):
                raise ValueError("its arrays overlap")
            arrays = {e.filename.removesuffix(".npy"): _array(archive.read(e)) for e in entries}
        # Each array once: what is read is never larger than what was sent.
        return _filled(json.loads(arrays.pop("tree").tobytes()), arrays)
    except _BROKEN as error:
        raise InputError(
            f"is not an NPZ that can be used ({first_line(error)})",
            where=where,
            allowed="arrays, and in `tree` the JSON text that names them",
        ) from error


def _array(data: bytes) -> NDArray[Any]:
    """The array of an NPY file, no larger than the file."""
    handle = io.BytesIO(data)
    shape, by_columns, dtype = read_npy_header(handle)
    if dtype.kind not in "biuf":
        raise ValueError(f"an array of {dtype}")
    values = np.frombuffer(data, dtype, offset=handle.tell())
    return values.reshape(shape, order="F" if by_columns else "C").copy()


def _filled(node: Any, arrays: dict[str, NDArray[Any]]) -> Any:
    if isinstance(node, dict):
        if set(node) == {REFERENCE}:
            return arrays.pop(node[REFERENCE])
        return {key: _filled(value, arrays) for key, value in node.items()}
    if isinstance(node, list):
        return [_filled(value, arrays) for value in node]
    return node
