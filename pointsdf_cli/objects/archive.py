"""Extraction of one mesh from a downloaded tar archive, without trusting the archive."""

from __future__ import annotations

import lzma
import tarfile
import zlib
from pathlib import Path, PurePosixPath

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.input_files import open_input

LARGEST_MEMBER = 256 * 1024**2
MOST_MEMBERS = 10_000
# What is wanted, best first: the watertight mesh, then the same as STL, then the textured one.
WANTED = ("nontextured.ply", "nontextured.stl", "textured.obj")
# OverflowError: a member whose size no file position can hold. ValueError: a header's number.
_UNREADABLE = (
    *(tarfile.TarError, zlib.error, lzma.LZMAError),
    *(EOFError, OSError, OverflowError, ValueError),
)


def extract_mesh(archive: Path, out: Path, largest: int = LARGEST_MEMBER) -> Path:
    """Copy the mesh in a tar archive to `out` with the member's suffix; nothing else is unpacked.

    No member determines where anything is written; an archive with unsafe members is refused.

    Args:
        archive: A `.tgz`.
        out: Path to write, without suffix.
        largest: Largest size of the mesh in bytes.

    Returns:
        The file written.

    Raises:
        InputError: The archive is damaged, holds absolute paths, `..`, links or devices, too many
            or too large members, or no mesh.
    """
    try:
        with open_input(archive, "archive") as packed, tarfile.open(fileobj=packed) as tar:
            member = _choose(tar, archive, largest)
            source = tar.extractfile(member)
            if source is None:
                raise InputError("the mesh in it is not a file", where=archive)
            data = source.read(largest + 1)
    except _UNREADABLE as error:
        what = f"is not a readable tar archive ({type(error).__name__}: {error})"
        raise InputError(what, where=archive, hint="delete it and fetch it again") from error
    if len(data) != member.size:
        raise InputError(f"{member.name} is cut short", where=archive)
    path = out.with_name(out.name + PurePosixPath(member.name).suffix)
    path.write_bytes(data)
    return path


def _choose(tar: tarfile.TarFile, archive: Path, largest: int) -> tarfile.TarInfo:
    """Check all members and choose the one to read."""
    found: dict[str, tarfile.TarInfo] = {}
    for number, member in enumerate(tar):
        name = PurePosixPath(member.name)
        if number >= MOST_MEMBERS:
            raise InputError(f"holds more than {MOST_MEMBERS} members", where=archive)
        if name.is_absolute() or ".." in name.parts or "\\" in member.name:
            raise InputError(f"holds a path that leads outside: {member.name!r}", where=archive)
        if not (member.isfile() or member.isdir()):
            raise InputError(f"holds a link or a device: {member.name!r}", where=archive)
        if member.size > largest:
            what = f"{member.name!r} unpacks to {member.size} bytes"
            raise InputError(what, where=archive, allowed=f"at most {largest}")
        if member.isfile() and name.name in WANTED:
            found.setdefault(name.name, member)
    for wanted in WANTED:
        if wanted in found:
            return found[wanted]
    raise InputError("holds no mesh", where=archive, allowed=", ".join(WANTED))
