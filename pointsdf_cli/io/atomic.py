"""Files that are either whole or not there: written beside their place, flushed, then moved."""

from __future__ import annotations

import errno
import os
import platform
import time
import uuid
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pointsdf_cli.errors import InputError

TEMPORARY_MARK = ".partial-"
"""Part of the name of every file under construction; nothing reads such a file."""
ABANDONED = 86400.0
"""What another machine has been building for so long [s] was left by a run that was killed."""
LONGEST_NAME = 255
"""Bytes that a file's name may have; that of a file under construction is cut to it."""
_HOST = f"{zlib.crc32(platform.node().encode()):08x}"


class UnwritableError(InputError):
    """The place for the output is what is wrong, and would be for the next input too."""


@contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """A temporary path in `path`'s folder that takes its place when the block ends well.

    On any exception the temporary file is removed and `path` is as it was. The suffix is kept,
    because writers choose their format by it.

    Raises:
        UnwritableError: The folder cannot be written, or the disk is full.
    """
    path = Path(path)
    try:
        # What a link points to is replaced, not the link.
        path = path.resolve() if path.is_symlink() else path
    except RuntimeError as error:
        raise UnwritableError("is a link that leads to itself", where=path) from error
    temporary = temporary_beside(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        with open(temporary, "rb") as handle:
            os.fsync(handle.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise unwritable(path, error) from error
    finally:
        with suppress(OSError):  # a file in place of a folder: there is nothing to remove
            temporary.unlink()


def temporary_beside(path: Path) -> Path:
    """A name for what this process builds, and then puts at `path`."""
    ending = f"{TEMPORARY_MARK}{_HOST}-{os.getpid()}-{uuid.uuid4().hex[:8]}{path.suffix}"
    stem = path.stem
    while len(os.fsencode(stem)) > max(1, LONGEST_NAME - 1 - len(os.fsencode(ending))):
        stem = stem[:-1]
    return path.with_name(f".{stem}{ending}")


def abandoned_beside(path: Path) -> list[Path]:
    """What killed runs left that were building `path`."""
    begin, end = f".{path.stem}{TEMPORARY_MARK}", path.suffix
    found = []
    for leftover in path.parent.iterdir():
        if leftover.name.startswith(begin) and leftover.name.endswith(end):
            with suppress(FileNotFoundError):
                if _is_abandoned(leftover):
                    found.append(leftover)
    return found


def write_text_atomic(path: Path | str, text: str) -> None:
    """Write UTF-8 text as a whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def remove_leftovers(folder: Path | str) -> None:
    """Remove temporary files that a killed run left in `folder` (they hold nothing finished).

    What a process is building at this moment stays: it may be another shard.
    """
    for leftover in Path(folder).glob(f".*{TEMPORARY_MARK}*"):
        with suppress(OSError):  # gone by now, or not ours to remove
            if leftover.is_file() and _is_abandoned(leftover):
                leftover.unlink()


def _is_abandoned(temporary: Path) -> bool:
    builder = temporary.name.rpartition(TEMPORARY_MARK)[2].partition(".")[0].split("-")
    if builder[0] != _HOST or len(builder) != 3 or not builder[1].isdecimal():
        return time.time() - temporary.stat().st_mtime > ABANDONED
    try:
        os.kill(int(builder[1]), 0)
    except ProcessLookupError:
        return True
    except OSError:  # somebody else's process
        pass
    return _is_zombie(int(builder[1]))


def _is_zombie(process: int) -> bool:
    """Whether a process has ended, and only waits for its parent to ask how.

    One whose parent was killed with it waits for the machine's first process, which in a
    container may take its time.
    """
    try:
        status = Path(f"/proc/{process}/stat").read_bytes()
    except OSError:  # it is gone by now, or this is no Linux
        return False
    return status.rpartition(b")")[2].split()[0] in (b"Z", b"X")


def require_new(path: Path | str, force: bool, inputs: Iterable[Path] = ()) -> Path:
    """`path`, unless something is there that `--force` was not given for.

    Raises:
        InputError: The file exists, is one of the inputs (whatever `force` says), or a folder
            stands where a file is to be written.
    """
    path = Path(path)
    if path.exists() and any(source.exists() and path.samefile(source) for source in inputs):
        raise InputError(
            "is an input, which the output would replace", where=path, hint="choose another name"
        )
    if path.is_dir():
        raise InputError("is a folder, and a file is to be written there", where=path)
    if path.exists() and not path.is_file():
        raise InputError("is no ordinary file, and would be replaced by one", where=path)
    if path.exists() and not force:
        raise InputError(
            "exists already, and nothing is overwritten unasked",
            where=path,
            hint="add --force, or choose another --out",
        )
    return path


def require_folder(path: Path | str) -> Path:
    """`path` as a folder that exists and can be written, made if need be.

    Raises:
        InputError: A file stands there, or the folder cannot be made or written.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise InputError("is a file, and a folder is needed", where=path)
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe = path / f".{TEMPORARY_MARK}{uuid.uuid4().hex[:8]}"
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise unwritable(path, error) from error
    return path


def unwritable(path: Path | str, error: OSError) -> UnwritableError:
    """The user's view of an operating-system error met while writing `path`."""
    if error.errno == errno.ENOSPC or "No space left" in str(error):
        return UnwritableError(
            "the disk is full; nothing half-written was kept",
            where=path,
            hint="free some space or choose another --out, then run the same command again; add "
            "--resume to a training, and --force where a file is said to be there already",
        )
    reason = error.strerror or str(error)
    return UnwritableError(f"cannot be written ({reason})", where=path, hint="choose another --out")
