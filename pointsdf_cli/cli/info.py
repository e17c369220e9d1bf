"""`rgrasp info`: contents and provenance of an artifact."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from pointsdf_cli.cli import common
from pointsdf_cli.cli.printable import on_one_line


def info(
    artifacts: Annotated[
        list[Path],
        typer.Argument(
            help="HDF5 artifacts, clouds, meshes, checkpoint directories.", metavar="ARTIFACT..."
        ),
    ],
    unit: common.Unit = "m",
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Show the contents and provenance of artifacts (--json: one object a line).

    Example: rgrasp info views/006_mustard_bottle.h5
    """
    from pointsdf_cli.io.describe import describe

    reporter = common.Reporter(quiet, as_json)
    for path, description in [(path, describe(path, unit)) for path in artifacts]:
        reporter.result({"path": path, **description}, _lines(path, description))


def _lines(path: Path, description: dict[str, Any]) -> list[str]:
    lines = [on_one_line(f"{path}")]
    lines += [on_one_line(f"  {name}: {value}") for name, value in description["facts"].items()]
    if description["datasets"]:
        lines.append("  datasets:")
    for name, entry in description["datasets"].items():
        shape = " × ".join(map(str, entry["shape"])) or "scalar"
        meaning = ", ".join(part for part in (entry["units"], entry["frame"]) if part)
        told = f" ({meaning})" if meaning else ""
        lines.append(on_one_line(f"    {name}: {entry['dtype']} [{shape}]{told}"))
    return lines
