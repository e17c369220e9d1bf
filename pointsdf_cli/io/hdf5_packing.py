"""Check of compressed HDF5 chunks: rgrasp's filters only, and no more than a chunk's declared size.

The library unpacks a chunk to whatever its stream says, gigabytes for a chunk that is declared as
some kilobytes, and only then looks how much of it is wanted.
"""

from __future__ import annotations

import math
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any

from h5py import h5d, h5z

from pointsdf_cli.errors import InputError

_FILTERS = {h5z.FILTER_DEFLATE, h5z.FILTER_SHUFFLE, h5z.FILTER_FLETCHER32}
_DEFLATE_MOST = 1032
"""Bytes that one byte of a deflate stream unpacks to, at most."""
_HARMLESS = 256 << 20
"""A chunk that cannot unpack to more bytes than this is not looked into."""
_CHECK_SUM = 4
"""Bytes that Fletcher's checksum adds."""


def check_packing(path: Path, name: str, dataset: h5d.DatasetID) -> None:
    """Refuse a dataset whose chunks unpack to more than they hold.

    Raises:
        InputError: They do, or are packed by other filters, or twice.
    """
    made = dataset.get_create_plist()
    filters = [made.get_filter(k)[0] for k in range(made.get_nfilters())]
    if not _FILTERS.issuperset(filters) or filters.count(h5z.FILTER_DEFLATE) > 1:
        raise InputError(f"{name} is packed in a way that rgrasp does not use", where=path)
    may_be_large = dataset.get_storage_size() * _DEFLATE_MOST > _HARMLESS
    if h5z.FILTER_DEFLATE not in filters or not may_be_large:
        return
    most = math.prod(made.get_chunk()) * int(dataset.dtype.itemsize) + _CHECK_SUM
    large: list[tuple[int, ...]] = []

    def note(chunk: Any) -> None:
        if chunk.size * _DEFLATE_MOST > _HARMLESS:
            large.append(chunk.chunk_offset)

    dataset.chunk_iter(note)
    for offset in large:
        _, packed = dataset.read_direct_chunk(offset)
        with suppress(zlib.error):  # damaged: the library says so when it is read
            if len(zlib.decompressobj().decompress(packed, most + 1)) > most:
                raise InputError(f"a chunk of {name} unpacks to more than it holds", where=path)
