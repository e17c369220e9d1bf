"""Folder of the bundled files: inside the package in a wheel, beside it in a checkout."""

from __future__ import annotations

from pathlib import Path

from pointsdf_cli.errors import InputError

DEFAULT_ROBOT = "robots/lbr4_allegro.yaml"

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


def bundled_robots() -> list[str]:
    """Names of the bundled robots."""
    return sorted(path.stem for path in (assets_folder() / "robots").glob("*.yaml"))


def robot_file(robot: Path | str | None = None) -> Path:
    """The YAML file of a robot that is given by its path or, if it is bundled, by its name.

    None is the LBR4 with Allegro hand. A file with a bundled robot's name goes before it.
    """
    if robot is None:
        return asset_path(DEFAULT_ROBOT)
    path = Path(robot)
    bare = path.name == str(robot) and not path.suffix
    if bare and not path.is_file() and path.name in bundled_robots():
        return asset_path(f"robots/{path.name}.yaml")
    return path


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
