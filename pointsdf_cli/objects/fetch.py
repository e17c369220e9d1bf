"""Download of the YCB object set: official archives, verified by checksums, converted to PLY."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.atomic import require_folder, write_text_atomic
from pointsdf_cli.io.meshes import load_mesh, save_mesh
from pointsdf_cli.io.provenance import file_sha256
from pointsdf_cli.io.scratch import Scratch
from pointsdf_cli.io.untrusted import read_json
from pointsdf_cli.objects.archive import extract_mesh
from pointsdf_cli.objects.download import Patience, download
from pointsdf_cli.objects.ycb_names import choose_ycb

YCB_BASE_URL = "http://ycb-benchmarks.s3-website-us-east-1.amazonaws.com/data/google/"
"""Address at which the official YCB download script finds the Google scanner's archives."""

LOCK = "ycb.lock.json"
_LOCK_FORMAT = 1


@dataclass(frozen=True)
class LockEntry:
    """Lock entry of one archive and the mesh made from it.

    Attributes:
        url: Address of the archive.
        sha256: Hash of the archive's bytes, as first seen.
        size: Size of the archive in bytes.
        mesh_sha256: Hash of the PLY made from it.
        repair: Repair that closed the mesh.
    """

    url: str
    sha256: str
    size: int
    mesh_sha256: str
    repair: str


def fetch_ycb(
    out: Path,
    objects: Sequence[str] | None = None,
    base_url: str = YCB_BASE_URL,
    force: bool = False,
    patience: Patience | None = None,
    on_done: Callable[[str, str], None] | None = None,
) -> tuple[dict[str, str], list[InputError]]:
    """Fetch objects of the YCB set as watertight PLY meshes in metres, `out`/NAME.ply.

    The checksum of each archive is stored in `out`/ycb.lock.json at its first download and compared
    from then on; an existing mesh with the right checksum is kept.

    Args:
        out: A folder, made if need be.
        objects: Names or leading numbers (`003`, `065-a`); None for all.
        base_url: The folder of the archives NAME_google_16k.tgz.
        force: Fetch existing meshes again (checksums must still match).
        patience: Tries and waits.
        on_done: Called with each name and "fetched", "kept" or "refused".

    Returns:
        "fetched" or "kept" for each name, and the errors of the archives that could not be used.

    Raises:
        InputError: A name is not a YCB object, or the folder cannot be written.
        RgraspError: The server cannot be reached.
    """
    names = choose_ycb(objects)
    out = require_folder(out)
    lock = read_lock(out)
    states: dict[str, str] = {}
    refused: list[InputError] = []
    for name in names:
        try:
            states[name] = _fetch_one(name, out, lock, base_url, force, patience)
        except InputError as error:
            refused.append(error)
        if on_done:
            on_done(name, states.get(name, "refused"))
    return states, refused


def read_lock(out: Path) -> dict[str, LockEntry]:
    """Known checksums in a folder; none without a lock file.

    Raises:
        InputError: The lock file cannot be understood.
    """
    path = out / LOCK
    if not path.exists():
        return {}
    try:
        document: dict[str, Any] = read_json(path)
        if document["format"] != _LOCK_FORMAT:
            raise ValueError(f"format {document['format']}")
        return {name: LockEntry(**entry) for name, entry in document["objects"].items()}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"is not a lock file of this version ({error})",
            where=path,
            hint="move it away; the checksums are then stored again",
        ) from error


def _fetch_one(
    name: str,
    out: Path,
    lock: dict[str, LockEntry],
    base_url: str,
    force: bool,
    patience: Patience | None,
) -> str:
    mesh_path = out / f"{name}.ply"
    known = lock.get(name)
    if mesh_path.exists() and not force:
        if known and file_sha256(mesh_path) == known.mesh_sha256:
            return "kept"
        what = "is there already, but not as it was fetched"
        raise InputError(what, where=mesh_path, hint="move it away, or add --force")
    url = f"{base_url.rstrip('/')}/{name}_google_16k.tgz"
    # Hidden, so that a stage which takes the folder for its meshes does not look inside.
    archive = require_folder(out / ".archives") / f"{name}_google_16k.tgz"
    sha256 = download(url, archive, patience)
    try:
        if known and sha256 != known.sha256:
            raise InputError(
                f"has changed: SHA-256 {sha256}, but {known.sha256} when first seen",
                where=url,
                hint=f"if that is to be trusted, remove {name!r} from {out / LOCK}",
            )
        size = archive.stat().st_size
        with Scratch(archive.parent) as scratch:
            mesh = load_mesh(extract_mesh(archive, scratch / name))
            made = scratch / mesh_path.name
            save_mesh(made, mesh.vertices, mesh.faces)
            lock[name] = LockEntry(url, sha256, size, file_sha256(made), mesh.repair)
            # Checksum first: a run killed in between leaves no mesh, which is fetched again. A mesh
            # without a checksum would be refused.
            _add_to_lock(out, name, lock[name])
            made.replace(mesh_path)
    finally:
        archive.unlink(missing_ok=True)
    return "fetched"


def _add_to_lock(out: Path, name: str, entry: LockEntry) -> None:
    """Add one entry and keep those added by other runs meanwhile."""
    guard = os.open(out, os.O_RDONLY)
    try:
        fcntl.flock(guard, fcntl.LOCK_EX)
        lock = read_lock(out) | {name: entry}
        entries = {known: asdict(lock[known]) for known in sorted(lock)}
        document = {"format": _LOCK_FORMAT, "objects": entries}
        write_text_atomic(out / LOCK, json.dumps(document, indent=1) + "\n")
    finally:
        os.close(guard)
