"""`rgrasp info`: what an artifact holds and where it came from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pointsdf_cli.cli import common


def info(
    artifact: Annotated[
        Path, typer.Argument(help="An HDF5 artifact or a mesh.", metavar="ARTIFACT")
    ],
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Show the contents and provenance of an artifact.

    Example: rgrasp info views/006_mustard_bottle.h5
    """
    from pointsdf_cli.io.describe import describe

    description = describe(artifact)
    lines = [f"{name}: {value}" for name, value in description["facts"].items()]
    if description["datasets"]:
        lines.append("datasets:")
    for name, entry in description["datasets"].items():
        shape = " × ".join(map(str, entry["shape"])) or "scalar"
        meaning = ", ".join(part for part in (entry["units"], entry["frame"]) if part)
        lines.append(f"  {name}: {entry['dtype']} [{shape}]" + (f" ({meaning})" if meaning else ""))
    common.Reporter(quiet, as_json).result(description, lines)
