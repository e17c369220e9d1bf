"""Checks of input files and folders before slow imports."""

from __future__ import annotations

from pathlib import Path

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.hdf5 import artifacts_below, require_schema


def require_present(*paths: Path | None, hint: str | None = None) -> None:
    """Refuse missing inputs; None is passed over.

    Args:
        paths: Files and folders.
        hint: Command that makes the missing file or folder.

    Raises:
        InputError: One is missing.
    """
    for path in paths:
        if path is not None and not path.exists():
            what = "no such file" if path.suffix else "no such folder"
            raise InputError(what, where=path, hint=hint)


def require_artifacts(folder: Path, schema: str, hint: str) -> None:
    """Require a folder of artifacts; the first one is looked at.

    Args:
        folder: The folder.
        schema: Their schema, such as "views".
        hint: Command that makes them.

    Raises:
        InputError: The folder is missing, holds no artifact, or those of another schema.
    """
    require_present(folder, hint=hint)
    if not folder.is_dir():
        raise InputError(f"is a file, and a folder of {schema} is needed", where=folder, hint=hint)
    files = artifacts_below(folder)
    if not files:
        raise InputError(f"holds no {schema} (*.h5)", where=folder, hint=hint)
    require_schema(files[0], schema)
