"""Arrays written row by row to .npy files, for data that does not fit into memory."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
from numpy.lib.format import dtype_to_descr, write_array_header_1_0
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError


class ArrayWriter:
    """Raw rows appended to a file, then copied behind a .npy header once their number is known."""

    def __init__(self, path: Path, first: NDArray) -> None:
        self.path, self.dtype, self.row = path, first.dtype, first.shape[1:]
        self.rows = 0
        path.write_bytes(b"")

    def append(self, array: NDArray, where: Path) -> None:
        """Add rows.

        Args:
            array: [n, ...].
            where: The artifact that they are of, for messages.

        Raises:
            InputError: Their shape is not that of the rows before.
        """
        if array.shape[1:] != self.row:
            raise InputError(
                f"has arrays of shape {array.shape[1:]} where the others have {self.row}",
                where=where,
                hint="make all artifacts of one data set with the same options",
            )
        with open(self.path, "ab") as handle:
            handle.write(np.ascontiguousarray(array, dtype=self.dtype).tobytes())
        self.rows += len(array)

    def finish(self, target: Path) -> None:
        """Write the .npy file and remove the raw rows."""
        descr, shape = dtype_to_descr(self.dtype), (self.rows, *self.row)
        header = {"descr": descr, "fortran_order": False, "shape": shape}
        # Plain writes: on a disk that fills, one into a mapped file kills the process.
        with open(self.path, "rb") as rows, open(target, "wb") as handle:
            write_array_header_1_0(handle, header)
            shutil.copyfileobj(rows, handle)
            handle.flush()
            os.fsync(handle.fileno())
        self.path.unlink()


def write_array(path: Path, array: NDArray) -> None:
    """Write a .npy file through to the disk."""
    with open(path, "wb") as handle:
        np.save(handle, array)
        handle.flush()
        os.fsync(handle.fileno())
