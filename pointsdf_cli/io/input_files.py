"""Opening of input files: ordinary files only, and none larger than its kind may be.

A FIFO holds a reader for ever, a device never ends, and a sparse file of a few blocks promises
gigabytes. Every reader opens its files here, so that each of them is refused in one message.
"""

from __future__ import annotations

import errno
import os
import re
import stat
from collections.abc import Collection, Mapping
from io import BufferedReader
from pathlib import Path

from pointsdf_cli.errors import InputError

MEBIBYTE = 1 << 20
LARGEST: Mapping[str, int] = {
    "YAML": 1 * MEBIBYTE,  # PyYAML takes seconds for a megabyte
    "text": 16 * MEBIBYTE,
    "cloud": 256 * MEBIBYTE,
    "mesh": 256 * MEBIBYTE,
    "image": 512 * MEBIBYTE,
    "array": 4096 * MEBIBYTE,
    "archive": 4096 * MEBIBYTE,
    "checkpoint": 8192 * MEBIBYTE,
    "artifact": 16384 * MEBIBYTE,
    "bag": 262144 * MEBIBYTE,  # read message by message
}
"""Bytes of the largest input of each kind, unless `--largest-input` allows more."""
VARIABLE = "RGRASP_LARGEST_INPUT"
"""Environment variable with the value of `--largest-input`, for worker processes."""

_NEEDED = {
    "cloud": "a point cloud",
    "mesh": "a mesh file",
    "artifact": "an HDF5 file",
    "image": "an image",
}
_SIZE = re.compile(r"(\d+(?:\.\d+)?) *([kmgt]?)i?b?", re.IGNORECASE)
_UNITS = {"": 1, "k": 1 << 10, "m": 1 << 20, "g": 1 << 30, "t": 1 << 40}


def allow_inputs_of(text: str) -> None:
    """Allow inputs of this size, such as `20G`, to this process and to those that it starts.

    Raises:
        InputError: Not a size.
    """
    match = _SIZE.fullmatch(text.strip())
    if match is None or len(text) > 30:
        raise InputError(
            f"{text[:30]!r} is not a size", where="--largest-input", allowed="such as 500M or 20G"
        )
    os.environ[VARIABLE] = str(int(float(match[1]) * _UNITS[match[2].lower()]))


def largest_input(kind: str) -> int:
    """Bytes of the largest input of a kind of `LARGEST`."""
    allowed = os.environ.get(VARIABLE, "")
    return max(LARGEST[kind], int(allowed) if allowed.isdecimal() else 0)


def open_input(path: Path | str, kind: str) -> BufferedReader:
    """An input file, open for reading.

    Args:
        path: The file.
        kind: A key of `LARGEST`.

    Raises:
        InputError: No such file, a folder, a pipe or a device, not readable, or too large.
    """
    needed = _NEEDED.get(kind, "a file")
    try:
        # Without waiting: to open a FIFO that nobody writes to would take for ever.
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    except (OSError, ValueError) as error:
        raise _cannot_be_opened(path, error, needed) from error
    try:
        _require_ordinary(path, os.fstat(handle), kind, needed)
        os.set_blocking(handle, True)
        return open(handle, "rb")
    except BaseException:
        os.close(handle)
        raise


def check_input(path: Path | str, kind: str) -> None:
    """Open an input file as `open_input` does, for libraries that open files themselves.

    Raises:
        InputError: As `open_input`.
    """
    open_input(path, kind).close()


def is_hidden(path: Path, folder: Path) -> bool:
    """Whether a file below a folder is under construction, or somebody's notes beside another one
    (`._mug.ply`, `.archives/`)."""
    return any(part.startswith(".") for part in path.relative_to(folder).parts)


def require_suffix(path: Path, known: Collection[str], what: str) -> None:
    """Refuse a file whose suffix no reader knows.

    Args:
        path: The file.
        known: Suffixes in small letters.
        what: Name for the suffix in the message, such as "mesh format".

    Raises:
        InputError: It has another one.
    """
    if path.suffix.lower() not in known:
        raise InputError(f"unknown {what} {path.suffix!r}", where=path, allowed=", ".join(known))


def read_input(path: Path | str, kind: str) -> bytes:
    """The bytes of an input file.

    Raises:
        InputError: As `open_input`.
    """
    most = largest_input(kind)
    with open_input(path, kind) as handle:
        try:
            # By its size, not by the bound: so much memory would be asked for before any is used.
            data = handle.read(os.fstat(handle.fileno()).st_size + 1)
            # It grew, or is of a file system that does not tell sizes.
            while len(data) <= most and (more := handle.read(MEBIBYTE)):
                data += more
        except OSError as error:
            raise _cannot_be_opened(path, error, _NEEDED.get(kind, "a file")) from error
    if len(data) > most:
        raise _too_large(path, len(data), kind)
    return data


def _require_ordinary(path: Path | str, about: os.stat_result, kind: str, needed: str) -> None:
    if stat.S_ISDIR(about.st_mode):
        raise InputError(f"is a folder, and {needed} is needed", where=path)
    if not stat.S_ISREG(about.st_mode):
        raise InputError(
            "is a pipe or a device",
            where=path,
            allowed="an ordinary file",
            hint="write it to a file first",
        )
    if about.st_size > largest_input(kind):
        raise _too_large(path, about.st_size, kind)


def _too_large(path: Path | str, size: int, kind: str) -> InputError:
    most = largest_input(kind)
    return InputError(
        f"is larger than {most >> 20} MB ({size >> 20} MB)",
        where=path,
        allowed=f"{most >> 20} MB for a file of this kind ({kind})",
        hint=f"if it is what it should be: rgrasp --largest-input {-(-size >> 30) or 1}G COMMAND …",
    )


def _cannot_be_opened(path: Path | str, error: Exception, needed: str) -> InputError:
    number = getattr(error, "errno", None)
    if number in (errno.ENOENT, errno.ENOTDIR, errno.ENAMETOOLONG) or isinstance(error, ValueError):
        return InputError("no such file", where=path)
    if number == errno.EISDIR:
        return InputError(f"is a folder, and {needed} is needed", where=path)
    if number in (errno.EACCES, errno.EPERM):
        return InputError("cannot be read (permission denied)", where=path)
    if number in (errno.ENXIO, errno.ENODEV):  # a socket, or a device without a driver
        return InputError("is a pipe or a device", where=path, allowed="an ordinary file")
    told = (getattr(error, "strerror", None) or type(error).__name__).lower()
    return InputError(f"cannot be read ({told})", where=path)
