"""`rgrasp report`: a folder of artifacts, or one, as an HTML page with pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pointsdf_cli.cli import common


def report(
    artifacts: Annotated[
        Path,
        typer.Argument(
            help="A folder of artifacts, or one file of collect-grasps, plan or trial.",
            metavar="ARTIFACTS",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="The page.  [default: report.html in the folder, NAME.html by the file]"),
    ] = None,
    pictures: Annotated[
        Path | None, typer.Option(help="A folder for the page's pictures as PNG files too.")
    ] = None,
    meshes: Annotated[
        Path | None, typer.Option(help="The meshes, if they do not lie below the folder.")
    ] = None,
    robot: Annotated[
        Path | None,
        typer.Option(help="Robot YAML of a plan [default: LBR4 + Allegro].", show_default=False),
    ] = None,
    force: common.Force = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Write one self-contained HTML page on what a folder of artifacts, or one of them, holds.

    Example: rgrasp report demo/
    """
    from pointsdf_cli.io.atomic import require_new, write_text_atomic
    from pointsdf_cli.viz.data_report import data_report, sample_items, scan
    from pointsdf_cli.viz.sheets import save_figure, sdf_slices, views_sheet

    title = f"rgrasp: {artifacts.resolve().name}"
    page = out or (
        artifacts / "report.html" if artifacts.is_dir() else artifacts.with_suffix(".html")
    )
    text = _of_grasps_plan_or_trials(artifacts, robot, title)
    if text is not None:
        write_text_atomic(require_new(page, force), text)
        written = [page]
    else:
        found = scan(artifacts, meshes)
        write_text_atomic(require_new(page, force), data_report(found, title))
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


def _of_grasps_plan_or_trials(path: Path, robot: Path | None, title: str) -> str | None:
    """The page on one file, or on a folder of grasps; None where it is a folder of other data.

    Raises:
        InputError: A file of another kind.
    """
    from pointsdf_cli.errors import InputError
    from pointsdf_cli.io.atomic import TEMPORARY_MARK
    from pointsdf_cli.io.grasps import read_grasps
    from pointsdf_cli.io.hdf5 import open_hdf5

    def schema(file: Path) -> str:
        with open_hdf5(file) as opened:
            return str(opened.attrs.get("schema", "nothing that rgrasp wrote"))

    if path.is_dir():
        files = [p for p in sorted(path.rglob("*.h5")) if TEMPORARY_MARK not in p.name]
        kinds = [schema(file) for file in files]
        if (path / "trials.h5").is_file():
            return _of_grasps_plan_or_trials(path / "trials.h5", robot, title)
        if {"views", "labels"} & set(kinds) or "grasps" not in kinds:
            return None
        chosen = [file for file, kind in zip(files, kinds, strict=True) if kind == "grasps"]
    else:
        chosen, kind = [path], schema(path)
        if kind == "plan":
            from pointsdf_cli.io.plans import read_plan
            from pointsdf_cli.robot.description import load_robot
            from pointsdf_cli.viz.plan_report import plan_report
            from pointsdf_cli.viz.scene_sources import require_joints

            plan, described = read_plan(path), load_robot(robot)
            require_joints(path, plan.joint_names, described)
            return plan_report(plan, described, title)
        if kind == "trials":
            from pointsdf_cli.io.trials import read_trials
            from pointsdf_cli.trials.report import html_report

            return html_report(read_trials(path), [], title, {})
        if kind != "grasps":
            raise InputError(
                f"holds {kind}, and a file of grasps, a plan or trials is needed",
                where=path,
                hint="give the folder for views and labels",
            )
    from pointsdf_cli.viz.grasp_report import grasp_report

    items = [(file.stem, *read_grasps(file)) for file in chosen]
    return grasp_report(items, [], [], title)
