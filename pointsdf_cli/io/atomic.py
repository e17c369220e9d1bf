"""Atomic writes: files are written beside their place, flushed, then moved."""

from __future__ import annotations

import errno
import glob
import os
import platform
import re
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
"""Age [s] after which another machine's unfinished file counts as left by a killed run."""
LONGEST_NAME = 255
"""Bytes that a file's name may have; that of a file under construction is cut to it."""
_NAME = re.compile(
    rf"\..*{re.escape(TEMPORARY_MARK)}([0-9a-f]{{8}})-([0-9]{{1,9}})-([0-9]{{1,18}})-[0-9a-f]{{8}}(\..*)?"
)


def _host() -> str:
    """Namespace of process numbers: this machine, in this container."""
    known = platform.node()
    with suppress(OSError):
        known += str(os.stat("/proc/self/ns/pid").st_ino)
        identity, boot = Path("/etc/machine-id"), Path("/proc/sys/kernel/random/boot_id")
        known += (identity if identity.is_file() else boot).read_text(encoding="ascii")
    return f"{zlib.crc32(known.encode()):08x}"


_HOST = _host()


class UnwritableError(InputError):
    """The output folder cannot be written; other inputs would meet the same error."""


@contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Temporary path in `path`'s folder that replaces `path` when the block ends without an error.

    On any exception the temporary file is removed and `path` is unchanged. The suffix is kept,
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
    """Temporary name for a file that this process builds and then moves to `path`."""
    ending = f"{TEMPORARY_MARK}{_builder(os.getpid())}-{uuid.uuid4().hex[:8]}{path.suffix}"
    stem = path.stem
    while len(os.fsencode(stem)) > max(1, LONGEST_NAME - 1 - len(os.fsencode(ending))):
        stem = stem[:-1]
    return path.with_name(f".{stem}{ending}")


def abandoned_in(folder: Path | str, stem: str = "*", suffix: str = "") -> list[Path]:
    """Leftovers of killed runs in a folder.

    Args:
        folder: The folder; none of its files if it cannot be read.
        stem, suffix: Patterns for the name of what was being built.
    """
    found: list[Path] = []
    with suppress(OSError):
        found += Path(folder).glob(f".{stem}{TEMPORARY_MARK}*{suffix}")
    return [path for path in found if is_abandoned(path)]


def abandoned_beside(path: Path) -> list[Path]:
    """Leftovers of killed runs that were building `path`."""
    return abandoned_in(path.parent, glob.escape(path.stem), glob.escape(path.suffix))


def write_text_atomic(path: Path | str, text: str) -> None:
    """Write UTF-8 text as a whole or not at all; bytes of file names that are none as `\\udc…`."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")


def remove_leftovers(folder: Path | str) -> None:
    """Remove temporary files that a killed run left in `folder` (they hold nothing finished).

    What a process is building at this moment stays: it may be another shard.
    """
    for leftover in abandoned_in(folder):
        with suppress(OSError):  # gone by now, or not ours to remove
            if leftover.is_file():
                leftover.unlink()


def is_abandoned(temporary: Path) -> bool:
    """Whether the builder of a file named by `temporary_beside` has ended."""
    name = _NAME.fullmatch(temporary.name)
    if name is None:  # nobody's who writes like this
        return False
    host, process, began = name[1], int(name[2]), int(name[3])
    if host != _HOST:
        with suppress(OSError):
            return time.time() - temporary.stat().st_mtime > ABANDONED
        return False  # it is gone by now
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    except OSError:  # somebody else's process
        pass
    status = _status(process)
    # A killed process stays a zombie until process 1 reaps it, which may take long in a container.
    # Process numbers are reused, so the start time must match too.
    return bool(status) and (status[0] in ("Z", "X") or int(status[19]) != began)


def _builder(process: int) -> str:
    """Part of a temporary name that identifies the process: machine, number and start time."""
    status = _status(process)
    return f"{_HOST}-{process}-{status[19] if status else 0}"


def _status(process: int) -> list[str]:
    """A process's state first, and when it began [ticks since the start] twentieth; empty if there
    is none, or this is no Linux."""
    try:
        told = Path(f"/proc/{process}/stat").read_bytes().rpartition(b")")[2].decode("ascii")
    except OSError:
        return []
    return told.split() if len(told.split()) >= 20 else []


def require_new(path: Path | str, force: bool, inputs: Iterable[Path] = ()) -> Path:
    """Check that `path` may be written, and return it: existing files need `force`.

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
        raise InputError("is a folder, but a file must be written there", where=path)
    if path.exists() and not path.is_file():
        raise InputError("is not an ordinary file, and would be replaced by one", where=path)
    if path.exists() and not force:
        what = "exists already, and is not overwritten without --force"
        raise InputError(what, where=path, hint="add --force, or choose another name")
    return path


def require_place(path: Path | str, force: bool) -> Path:
    """Check, before any work, that a file can be written at `path`, and return it.

    Raises:
        InputError: As `require_new`, or its folder cannot be made or written.
    """
    path = require_new(path, force)
    target = Path(os.path.realpath(path)) if path.is_symlink() else path
    if target.is_symlink():
        raise UnwritableError("is a link that leads to itself", where=path)
    require_folder(target.parent)
    return path


def require_folder(path: Path | str) -> Path:
    """Check that `path` is a writable folder, created if missing, and return it.

    Raises:
        InputError: A file stands there, or the folder cannot be made or written.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise InputError("is a file, and a folder is needed", where=path)
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe = temporary_beside(path / "probe")
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise unwritable(path, error) from error
    return path


def unwritable(path: Path | str, error: OSError) -> UnwritableError:
    """Input error for an operating-system error while writing `path`."""
    if error.errno == errno.ENOSPC or "No space left" in str(error):
        return UnwritableError(
            "the disk is full; nothing half-written was kept",
            where=path,
            hint="free some space or choose another place, then run the same command again; add "
            "--resume to a training, and --force if it says that a file exists already",
        )
    reason = error.strerror or str(error)
    return UnwritableError(f"cannot be written ({reason})", where=path, hint="choose another place")
