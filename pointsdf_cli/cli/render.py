"""`rgrasp render`: meshes to partial views."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from pointsdf_cli.cli import common
from pointsdf_cli.errors import InputError


def render(
    meshes: Annotated[Path, typer.Option(help="Folder of meshes, or one mesh.")],
    out: Annotated[Path, typer.Option(help="Output folder: one HDF5 of views per mesh.")] = Path(
        "views"
    ),
    views: Annotated[int, typer.Option(help="Number of views per mesh.")] = 200,
    camera: Annotated[
        str,
        typer.Option(
            help="Camera: reference, kinect2, xtion, realsense, or a JSON file with K, width "
            "and height."
        ),
    ] = "reference",
    distance: Annotated[
        float | None, typer.Option(help="Distance from camera to object [m]; 1.5 if not given.")
    ] = None,
    sensor: Annotated[
        str,
        typer.Option(
            metavar="ideal|structured-light|stereo",
            help="Depth camera to simulate. With --scene table: several, separated by commas, "
            "one of them for each view.",
        ),
    ] = "ideal",
    exact: Annotated[
        float,
        typer.Option(
            help="With --scene table: share of views of the object alone, without any error."
        ),
    ] = 0.0,
    noise: Annotated[
        float | None,
        typer.Option(
            help="With --sensor ideal: standard deviation of the depth at 1.5 m [m]; grows "
            "with its square.  [default: 0.001]"
        ),
    ] = None,
    scene: Annotated[
        Literal["void", "table"],
        typer.Option(
            help="Scene: void (the object alone), or table (resting on a table with "
            "neighbours, at 0.4 to 1.6 m, segmented with errors of a few pixels)."
        ),
    ] = "void",
    above: Annotated[
        bool,
        typer.Option(
            "--above", help="Render only views from above the horizon; z is up in the meshes."
        ),
    ] = False,
    keep_depth: Annotated[
        bool, typer.Option("--keep-depth", help="Also store the depth images (large).")
    ] = False,
    unit: common.Unit = "m",
    pattern: common.Pattern = "*",
    seed: common.Seed = 0,
    jobs: common.Jobs = 0,
    shard: common.Shard = None,
    force: common.Force = False,
    skip_bad: common.SkipBad = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Render meshes to noisy partial point clouds from random orientations.

    Example: rgrasp render --meshes ycb/ --out views/
    """
    from pointsdf_cli.io.present import require_present

    require_present(meshes)

    if scene == "table" and (keep_depth or above):
        option = "--keep-depth" if keep_depth else "--above"
        raise InputError(f"{option} with --scene table", hint="leave one of the two out")
    if scene == "table" and (noise is not None or distance is not None):
        option = "--noise" if noise is not None else "--distance"
        hint = "leave it out: the scenes vary the distance, and --sensor makes the errors"
        raise InputError(f"{option} with --scene table", hint=hint)
    sensors = tuple(name.strip() for name in sensor.split(","))
    if scene == "void" and (len(sensors) > 1 or exact):
        option = f"--sensor {sensor}" if len(sensors) > 1 else f"--exact {exact:g}"
        raise InputError("is for --scene table", where=option, hint="add --scene table")

    if scene == "void" and noise is not None and sensor != "ideal":
        what = f"--noise with --sensor {sensor}, which has noise of its own"
        raise InputError(what, hint="leave it out")
    # Seconds of imports: only for options that fit each other.
    from pointsdf_cli.camera.intrinsics import read_intrinsics
    from pointsdf_cli.camera.noise import DepthNoise
    from pointsdf_cli.camera.scene_views import SceneViewConfig
    from pointsdf_cli.camera.views import ViewConfig, ViewTask, render_file
    from pointsdf_cli.io.apart import require_apart
    from pointsdf_cli.io.atomic import require_folder
    from pointsdf_cli.io.batch import shard_of
    from pointsdf_cli.io.meshes import find_meshes, named_artifacts

    depth_noise = DepthNoise() if noise is None else DepthNoise(noise)
    table = SceneViewConfig(sensors, exact=exact) if scene == "table" else None
    away = ViewConfig.distance if distance is None else distance
    config = ViewConfig(
        views, away, read_intrinsics(camera), depth_noise, keep_depth, unit, above, table,
        sensor=sensors[0],
    )  # fmt: skip
    found = shard_of(find_meshes(meshes, pattern), shard)
    out = require_folder(out)
    named = named_artifacts(found, meshes, out)
    tasks = [(n, ViewTask(n, mesh, path, config, seed, force)) for n, (mesh, path) in named.items()]
    require_apart((task.out for _, task in tasks), [*found, camera])
    reporter = common.Reporter(quiet, as_json)
    folders = (task.out.parent for _, task in tasks)
    report = reporter.stage("render", tasks, render_file, jobs, folders)
    made = sum(summary.views for summary in report.made.values())
    redrawn = sum(summary.redrawn for summary in report.made.values())
    repaired = {n: s.repair for n, s in report.made.items() if s.repair != "none"}
    rate = made / report.seconds if report.seconds else 0.0
    values = {"views": made, "redrawn": redrawn, "views_per_second": rate, "repaired": repaired}
    drawn = f"{made} views ({redrawn} drawn again), {rate:.0f} a second"
    line = f"{drawn}; {len(repaired)} meshes repaired"
    reporter.finish(report, out, skip_bad, values, [line])
