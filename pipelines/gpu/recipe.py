"""The recipe of a folder of view files: the options that made them, and whether more are made."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.atomic import write_text_atomic

RECIPE = "recipe.json"
"""File beside the views with the options that made them."""
ENDED = "ended"
"""File beside the views when no more of them are made."""


def begin(folder: Path, recipe: dict[str, Any]) -> None:
    """Write the recipe of a folder whose views are made from now on.

    Raises:
        InputError: Its views were made otherwise: labels belong to an object's number, which would
            be another object's.
    """
    file = folder / RECIPE
    before = json.loads(file.read_text()) if file.exists() else recipe
    changed = [name for name, value in recipe.items() if before.get(name) != value]
    if other := ", ".join(name for name in changed if name != "git_commit"):
        raise InputError(
            f"its views were made with other options or scans ({other})",
            where=folder,
            hint="give the former options and scans, or another folder",
        )
    folder.mkdir(parents=True, exist_ok=True)
    (folder / ENDED).unlink(missing_ok=True)
    write_text_atomic(file, json.dumps(recipe, indent=1))
