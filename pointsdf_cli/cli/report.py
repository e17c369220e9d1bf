"""`rgrasp report`: a folder of artifacts, or one, as an HTML page with pictures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pointsdf_cli.choices import first_given
from pointsdf_cli.cli import common
from pointsdf_cli.errors import InputError

if TYPE_CHECKING:
    from pointsdf_cli.viz.data_report import DataFolder


Found = dict[str, list[Path]]
_PICTURES = ("views.png", "signed_distance.png")


def report(
    artifacts: Annotated[
        Path,
        typer.Argument(
            help="Folder of artifacts, a checkpoint, or one artifact, cloud or mesh.",
            metavar="ARTIFACTS",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Output page.  [default: report.html in the folder, trials.html or grasps.html "
            "for trials or grasps, NAME.html by the file]"
        ),
    ] = None,
    pictures: Annotated[
        Path | None, typer.Option(help="Folder for the page's pictures as PNG files.")
    ] = None,
    meshes: Annotated[
        Path | None,
        typer.Option(help="Folder of the meshes of views and labels, if they have moved."),
    ] = None,
    unit: common.Unit = "m",
    robot: common.RobotOfFile = None,
    force: common.Force = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Write one self-contained HTML page about an artifact, or a folder of them.

    Example: rgrasp report demo/
    """
    from pointsdf_cli.io.present import require_present

    require_present(artifacts, meshes)

    from pointsdf_cli.io.apart import require_apart
    from pointsdf_cli.io.atomic import require_place, write_text_atomic
    from pointsdf_cli.io.hdf5 import artifacts_below, schema_of
    from pointsdf_cli.viz.data_report import data_report, sample_items
    from pointsdf_cli.viz.sheets import save_figure, sdf_slices, views_sheet

    title = f"rgrasp: {artifacts.resolve().name}"
    trials, found = (artifacts / "trials.h5").is_file(), Found()
    for file in [] if trials else artifacts_below(artifacts):
        found.setdefault(schema_of(file), []).append(file)
    shown = {"views", "labels"} & set(found) or {"grasps"}
    # The report.html of trials and of collect-grasps shows more, such as pictures of failures.
    name = "trials" if trials else "grasps" if found.keys() & shown == {"grasps"} else "report"
    page = out or (artifacts / name if artifacts.is_dir() else artifacts).with_suffix(".html")
    drawn = [] if pictures is None else [pictures / name for name in _PICTURES]
    require_apart([page, *drawn], [artifacts, robot, meshes])
    made = _content(artifacts, found, robot, meshes, unit, title)
    if pictures and isinstance(made, str):
        hint = "leave it out: the page contains its pictures"
        raise InputError("is only for pages about views or labels", where="--pictures", hint=hint)
    views, labels = sample_items(made) if pictures and not isinstance(made, str) else ([], [])
    if pictures and not views and not labels:
        raise InputError("no meshes were found", where="--pictures", hint="add --meshes FOLDER")
    for path in (page, *drawn):  # known before anything is written
        require_place(path, force)
    text = made if isinstance(made, str) else data_report(made, title)
    write_text_atomic(page, text)
    written = [page]
    if views:
        written.append(drawn[0])
        save_figure(views_sheet(views), written[-1])
    if labels:
        written.append(drawn[1])
        save_figure(sdf_slices(labels), written[-1])
    paths, reporter = [str(path) for path in written], common.Reporter(quiet, as_json)
    if left := [f"{len(files)} {kind}" for kind, files in found.items() if kind not in shown]:
        reporter.say(f"left out: {', '.join(left)}; for their pages name their folder or a file")
    reporter.result({"written": paths}, paths)


def _content(
    path: Path, found: Found, robot: Path | None, meshes: Path | None, unit: str, title: str
) -> str | DataFolder:
    """HTML page about a file, a folder of grasps or trials, or a checkpoint; or the views and
    labels to make one of. `found` are the artifacts below a folder.

    Raises:
        InputError: No page can be made of this, or an option is given that it does not use.
    """
    from pointsdf_cli.io.checkpoints import CONFIG

    if path.is_file() and path.suffix.lower() not in (".h5", ".hdf5"):
        from pointsdf_cli.viz.shape_report import shape_report

        _require_unused("a cloud or a mesh", robot, meshes)
        return shape_report(path, unit, title)
    if path.is_file():
        return _of_file(path, robot, meshes, title)
    if (path / "trials.h5").is_file():
        return _of_file(path / "trials.h5", robot, meshes, title)
    if (path / CONFIG).is_file():
        from pointsdf_cli.viz.checkpoint_report import checkpoint_report

        _require_unused("a checkpoint", robot, meshes)
        return checkpoint_report(path, title)
    if {"views", "labels"} & set(found):
        return _data(path / "any", found, meshes)
    if "grasps" in found:
        return _of_grasps(found["grasps"], title)
    what = f"holds {', '.join(found) or 'no artifacts'}, of which no common page can be made"
    allowed = "views, labels, grasps or trials"
    hint = f"rgrasp report {found['plan'][0]} makes a page of one" if "plan" in found else None
    raise InputError(what, where=path, allowed=allowed, hint=hint)


def _data(near: Path, found: Found, meshes: Path | None) -> DataFolder:
    """Views and labels, whose meshes are searched as those of the file `near`, and below
    `meshes`."""
    from pointsdf_cli.viz.data_report import DataFolder
    from pointsdf_cli.viz.scene_sources import mesh_folders, meshes_below

    files = list(meshes_below(*mesh_folders(near), meshes))
    return DataFolder(found.get("views", []), found.get("labels", []), files)


def _of_file(path: Path, robot: Path | None, meshes: Path | None, title: str) -> str | DataFolder:
    from pointsdf_cli.io.hdf5 import schema_of

    kind = schema_of(path)
    is_data = kind in ("views", "labels")
    _require_unused(kind, None if kind == "plan" else robot, None if is_data else meshes)
    if is_data:
        return _data(path, {kind: [path]}, meshes)
    if kind == "grasps":
        return _of_grasps([path], title)
    if kind == "plan":
        from pointsdf_cli.io.plans import read_plan
        from pointsdf_cli.robot.description import load_robot
        from pointsdf_cli.viz.plan_report import plan_report
        from pointsdf_cli.viz.scene_sources import SceneOptions

        plan, given = read_plan(path), None if robot is None else load_robot(robot)
        described = SceneOptions(given).robot_of(path, plan.joint_names)
        return plan_report(plan, described, title)
    if kind == "trials":
        from pointsdf_cli.io.trials import read_trials
        from pointsdf_cli.trials.report import html_report

        return html_report(read_trials(path), [], title, {})
    what = f"holds {kind}, of which no page can be made"
    raise InputError(what, where=path, allowed="views, labels, grasps, plan, trials")


def _require_unused(kind: str, robot: Path | None, meshes: Path | None) -> None:
    """Refuse options that a page about this kind does not use."""
    if option := first_given({"--robot": robot, "--meshes": meshes}):
        raise InputError(f"not used for {kind}", where=option, hint="leave it out")


def _of_grasps(files: list[Path], title: str) -> str:
    from pointsdf_cli.io.grasps import read_grasps
    from pointsdf_cli.viz.grasp_report import grasp_report

    return grasp_report([(file.stem, *read_grasps(file)) for file in files], [], [], title)
