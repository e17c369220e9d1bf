"""A bounded walk through the objects of an HDF5 file, which refuses whatever leads to other files.

HDF5 follows external links, external storage and virtual datasets without being asked: a dataset
then holds the bytes of any file that the reader may open. Groups may nest without end, or hold
themselves. Nothing that rgrasp writes has any of these.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
from h5py import h5a, h5d, h5g, h5l, h5o

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.hdf5_packing import check_packing

DEEPEST = 8
"""Groups within groups."""
MOST_OBJECTS = 10_000
MOST_ATTRIBUTES = 1000
LARGEST_ATTRIBUTE = 16 << 20
"""Bytes."""


def datasets_of(path: Path, file: h5py.File) -> dict[str, h5py.Dataset]:
    """All datasets by their path in the file, none of which has been read.

    Raises:
        InputError: A link, a dataset that is stored elsewhere or unpacks to too much, more objects
            or deeper groups or larger attributes than any artifact has.
    """
    return {
        name: h5py.Dataset(found)
        for name, found in _walk(path, file.id)
        if isinstance(found, h5d.DatasetID)
    }


def _walk(path: Path, root: h5g.GroupID) -> Iterator[tuple[str, h5d.DatasetID | h5g.GroupID]]:
    _check_attributes(path, "/", root)
    waiting, seen, count = [("", root, 0)], {h5o.get_info(root).addr}, 0
    while waiting:
        above, group, depth = waiting.pop()
        count += group.get_num_objs()  # before their names are listed
        if count > MOST_OBJECTS:
            raise InputError(f"holds more than {MOST_OBJECTS} objects", where=path)
        for raw in group:
            name = f"{above}/{raw.decode('utf-8', 'backslashreplace')}".lstrip("/")
            if group.links.get_info(raw).type != h5l.TYPE_HARD:
                what = f"{name} is a link, which may lead to another file, and is not followed"
                raise InputError(what, where=path, allowed="data that the file holds itself")
            found = h5o.open(group, raw)
            _check_attributes(path, name, found)
            if isinstance(found, h5d.DatasetID):
                _require_stored_here(path, name, found)
                check_packing(path, name, found)
                yield name, found
            elif isinstance(found, h5g.GroupID):
                address = h5o.get_info(found).addr
                if address in seen:
                    raise InputError(f"the group {name} holds itself, or stands twice", where=path)
                if depth + 1 > DEEPEST:
                    raise InputError(f"groups nest deeper than {DEEPEST}", where=path)
                seen.add(address)
                waiting.append((name, found, depth + 1))


def _require_stored_here(path: Path, name: str, dataset: h5d.DatasetID) -> None:
    plan = dataset.get_create_plist()
    if plan.get_external_count() or plan.get_layout() == h5d.VIRTUAL:
        what = f"the data of {name} lie in another file, which is not opened"
        raise InputError(what, where=path, allowed="data that the file holds itself")


def _check_attributes(path: Path, name: str, holder: h5o.ObjectID) -> None:
    count = h5a.get_num_attrs(holder)
    if count > MOST_ATTRIBUTES:
        raise InputError(f"{name} has {count} attributes", where=path)
    for index in range(count):
        attribute = h5a.open(holder, index=index)
        promised = int(np.prod(attribute.shape or (0,), dtype=object)) * attribute.dtype.itemsize
        if promised > LARGEST_ATTRIBUTE:
            raise InputError(f"an attribute of {name} promises {promised} bytes", where=path)
