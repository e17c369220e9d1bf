"""Provenance of a file: the version, the commit and the contents it came from."""

from __future__ import annotations

import functools
import hashlib
import subprocess
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from pointsdf_cli import __version__
from pointsdf_cli.io.input_files import open_input

_PACKAGE = Path(__file__).resolve().parents[1]


def created_by() -> str:
    """The program and version, as written to every artifact."""
    return f"rgrasp {__version__}"


@functools.cache
def git_commit() -> str:
    """The checkout's commit, with `-dirty` where it has changes; empty in an installed wheel."""
    if not (_PACKAGE.parent / ".git").exists():
        return ""
    repository = ["git", "-C", str(_PACKAGE.parent)]
    describe = [*repository, "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        answer = subprocess.run(describe, capture_output=True, text=True, timeout=5, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return answer.stdout.strip()


def file_sha256(path: Path | str) -> str:
    """The SHA-256 of a file's bytes, in hexadecimal.

    Raises:
        InputError: No ordinary file, or larger than any input.
    """
    with open_input(path, "artifact") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


def data_sha256(names: Iterable[str], *arrays: ArrayLike) -> str:
    """SHA-256 of the training data, in hexadecimal: names, and arrays of their roles."""
    digest = hashlib.sha256("\0".join(names).encode())
    for array in arrays:
        values = np.ascontiguousarray(array)
        digest.update(f"\0{values.dtype.str}{values.shape}".encode())
        digest.update(values.tobytes())
    return digest.hexdigest()
