"""Check for missing inputs, before slow imports."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.checkpoints import read_config


def require_present(
    *paths: Path | None,
    checkpoints: Iterable[Path | None] = (),
    hint: str | None = None,
) -> None:
    """Refuse missing inputs; None is passed over.

    Args:
        paths: Files and folders.
        checkpoints: Checkpoint directories; their configuration is read.
        hint: Command that makes the missing file or folder.

    Raises:
        InputError: One is missing.
    """
    for path in paths:
        if path is not None and not path.exists():
            what = "no such file" if path.suffix else "no such folder"
            raise InputError(what, where=path, hint=hint)
    for path in checkpoints:
        if path is not None:
            read_config(path)
