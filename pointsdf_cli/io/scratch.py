"""Temporary folders for libraries that read from disk, removed when their process ends.

Folders of killed processes are removed by the next process that needs one, by the same rule as
outputs under construction (`atomic.py`).
"""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pointsdf_cli.io.atomic import UnwritableError, abandoned_in, temporary_beside, unwritable

NAME = "rgrasp"


class Scratch:
    """A folder of this process's own, readable by nobody else.

    Args:
        below: Parent folder; the system's folder of temporary files if None.

    Attributes:
        path: The folder.

    Raises:
        UnwritableError: It cannot be made.
    """

    def __init__(self, below: Path | None = None) -> None:
        below = Path(tempfile.gettempdir()) if below is None else below
        for folder in abandoned_in(below, NAME):
            with suppress(OSError):  # gone by now, or somebody else's
                about = folder.lstat()
                if stat.S_ISDIR(about.st_mode) and about.st_uid == os.geteuid():
                    shutil.rmtree(folder, ignore_errors=True)
        self.path = temporary_beside(below / NAME)
        try:
            self.path.mkdir(mode=0o700)
        except OSError as error:
            raise unwritable(below, error) from error
        self._end = weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)

    def close(self) -> None:
        """Remove the folder; so does the process's end."""
        self._end()

    def __enter__(self) -> Path:
        return self.path

    def __exit__(self, *_: object) -> None:
        self.close()


@contextmanager
def temporary_files(folder: Path) -> Iterator[None]:
    """Context that turns failures to write scratch files into one error.

    Raises:
        UnwritableError: They cannot be written, or the disk is full.
    """
    try:
        yield
    except OSError as error:
        raise UnwritableError(
            f"temporary files cannot be written ({error.strerror or error})",
            where=folder.parent,
            hint="free some space there, or set TMPDIR to a folder that has some",
        ) from error
