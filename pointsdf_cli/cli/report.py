"""`rgrasp report`: a folder of artifacts as one HTML page with pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pointsdf_cli.cli import common


def report(
    folder: Annotated[Path, typer.Argument(help="A folder of artifacts.", metavar="DIR")],
    out: Annotated[
        Path | None, typer.Option(help="The page.  [default: report.html in the folder]")
    ] = None,
    pictures: Annotated[
        Path | None, typer.Option(help="A folder for the page's pictures as PNG files too.")
    ] = None,
    meshes: Annotated[
        Path | None, typer.Option(help="The meshes, if they do not lie below the folder.")
    ] = None,
    force: common.Force = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Write one self-contained HTML page on what a folder of artifacts holds.

    Example: rgrasp report demo/
    """
    from pointsdf_cli.io.atomic import require_new, write_text_atomic
    from pointsdf_cli.viz.data_report import data_report, sample_items, scan
    from pointsdf_cli.viz.sheets import save_figure, sdf_slices, views_sheet

    page = require_new(out or folder / "report.html", force) if folder.is_dir() else Path()
    found = scan(folder, meshes)
    write_text_atomic(page, data_report(found, f"rgrasp: {folder.resolve().name}"))
    written = [page]
    if pictures:
        views, labels = sample_items(found)
        if views:
            written.append(require_new(pictures / "views.png", force))
            save_figure(views_sheet(views), written[-1])
        if labels:
            written.append(require_new(pictures / "signed_distance.png", force))
            save_figure(sdf_slices(labels), written[-1])
    common.Reporter(quiet, as_json).result(
        {"written": [str(path) for path in written]}, [f"{path}" for path in written]
    )
