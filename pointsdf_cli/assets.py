"""Folder of the bundled files: inside the package in a wheel, beside it in a checkout."""

from __future__ import annotations

from pathlib import Path

from pointsdf_cli.errors import InputError

_PACKAGE = Path(__file__).resolve().parent


def assets_folder() -> Path:
    """The folder that holds `robots/`, `weights/` and `clouds/`."""
    for folder in (_PACKAGE / "assets", _PACKAGE.parent / "assets"):
        if folder.is_dir():
            return folder
    raise InputError(
        "the bundled assets are missing",
        where=_PACKAGE,
        hint="install rgrasp again (pip install --force-reinstall rgrasp)",
    )


def asset_path(name: str) -> Path:
    """The bundled file or folder `name`, e.g. `"robots/lbr4_allegro.yaml"`.

    Raises:
        InputError: There is no such asset; the message lists its neighbours.
    """
    path = assets_folder() / name
    if not path.exists():
        siblings = sorted(p.name for p in path.parent.glob("*")) if path.parent.is_dir() else []
        raise InputError("no such bundled asset", where=name, allowed=", ".join(siblings) or None)
    return path
