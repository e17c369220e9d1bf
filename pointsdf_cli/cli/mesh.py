"""`rgrasp mesh`: one partial cloud to a closed mesh."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

from pointsdf_cli import choices
from pointsdf_cli.cli import common
from pointsdf_cli.errors import InputError

if TYPE_CHECKING:
    from pointsdf_cli.service.each_mesh import MeshTask

FEW = 200
"""Number of points below which a shape is mostly poor."""
SCENE = 0.45
"""A cloud wider than this [m] is more often of a whole table than of one object."""


def mesh(
    clouds: Annotated[
        list[Path],
        typer.Argument(
            help="A partial cloud (PLY, PCD, XYZ, TXT, CSV or NPY), or a depth image (16-bit PNG, "
            "TIFF or PGM, or NPY); with --each several."
        ),
    ],
    out: Annotated[Path | None, typer.Option(help="Output mesh [default: mesh.ply].")] = None,
    resolution: Annotated[
        int, typer.Option(help="Cells along the box: 32, 64, 128, 256 or 512.")
    ] = 128,
    form: Annotated[
        choices.MeshFormat | None,
        typer.Option(
            "--format", case_sensitive=False, help="Format [default: by the name of --out]."
        ),
    ] = None,
    checkpoint: Annotated[
        Path | None, typer.Option(help="Checkpoint [default: the bundled pointsdf_real].")
    ] = None,
    unit: Annotated[
        choices.Unit, typer.Option(help="Unit of the cloud, and so of the mesh.")
    ] = "m",
    frame: common.Frame = None,
    camera_pose: common.CameraPose = None,
    intrinsics: common.Intrinsics = None,
    depth_scale: common.DepthScale = None,
    mask: common.Mask = None,
    no_clean: common.NoClean = False,
    drop_invalid: common.DropInvalid = False,
    segment: Annotated[
        choices.Segment | None,
        typer.Option(
            help="auto: segment the object in a view of a table (a cloud needs its camera pose); "
            "none: the object is alone [default: auto for --camera-pose table and for depth "
            "images, except with --mask and no --camera-pose; else none]."
        ),
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(
            metavar="N|U,V|X,Y,Z",
            help="With --segment auto: the object's number in the list of `rgrasp segment`, a "
            "pixel, or a place in the world [m].",
        ),
    ] = None,
    workspace: common.Workspace = None,
    robot: common.RobotInScene = None,
    start: common.Start = None,
    all_parts: Annotated[
        bool, typer.Option("--all-parts", help="Keep small loose parts too.")
    ] = False,
    exact: Annotated[
        bool,
        typer.Option(
            "--exact",
            help="Evaluate the network everywhere near the surface; without it smooth regions are "
            "interpolated.",
        ),
    ] = False,
    smooth: Annotated[
        int, typer.Option(help="Number of smoothing passes over the surface; 0 for none.")
    ] = 25,
    picture: Annotated[
        Path | None,
        typer.Option(help="Also draw the cloud and the mesh from both sides into this PNG."),
    ] = None,
    each: Annotated[
        bool,
        typer.Option(
            "--each",
            help="Mesh every input by itself, into the folder --out [default: meshes]; what is "
            "there already is kept.",
        ),
    ] = False,
    jobs: common.EachJobs = None,
    skip_bad: common.EachSkipBad = False,
    precision: common.Precision = "auto",
    threads: common.Threads = 0,
    seed: common.Seed = 0,
    device: common.Device = "cpu",
    force: common.Force = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Complete one partial cloud of an object to a closed mesh, in the cloud's frame and unit.

    Example: rgrasp mesh cloud.ply --out mesh.ply

    Example: rgrasp mesh depth.png --intrinsics K.json --camera-pose table

    Example: rgrasp mesh clouds/*.ply --each --out meshes/
    """
    from pointsdf_cli.camera.scene_file import SceneFileOptions
    from pointsdf_cli.io.apart import require_apart
    from pointsdf_cli.io.atomic import require_folder, require_place
    from pointsdf_cli.io.each_file import check_each, require_one_name_each
    from pointsdf_cli.models.checkpoint_kinds import require_reconstructions
    from pointsdf_cli.planning.mesh_choices import MeshChoices
    from pointsdf_cli.planning.object_view import MeshSettings
    from pointsdf_cli.robot.description import load_robot
    from pointsdf_cli.robot.start import start_configuration
    from pointsdf_cli.service.each_mesh import MeshTask, mesh_cloud

    reporter = common.Reporter(quiet, as_json)
    # A wrong resolution is known before anything is read.
    meshing = MeshChoices(resolution, smooth, all_parts, exact, precision, seed)
    inputs = [*clouds, camera_pose, intrinsics, mask, checkpoint, robot, start]
    require_reconstructions([checkpoint])
    files = SceneFileOptions(
        intrinsics, depth_scale, mask=mask, unit=unit, frame=frame, drop_invalid=drop_invalid
    )
    start_at = None if start is None else start_configuration(start, load_robot(robot))
    settings = MeshSettings(
        meshing, segment, target, workspace, not no_clean, robot, checkpoint, device, start_at
    )
    check_each(each, {"--picture": picture, "--mask": mask}, jobs, skip_bad)
    if each:
        common.torch_device(device)
        require_one_name_each(clouds)
        out = require_folder(out or Path("meshes"))
        suffix = form or "ply"
        tasks = []
        for cloud in clouds:
            path = out / f"{cloud.stem}.{suffix}"
            task = MeshTask(cloud, files, camera_pose, path, settings, threads or 1, force)
            tasks.append((cloud.stem, task))
        require_apart((p for _, task in tasks for p in (task.out, task.record)), inputs)
        report = reporter.stage("mesh", tasks, mesh_cloud, jobs or common.job_count(0), [out])
        meshes = {name: asdict(summary) for name, summary in report.made.items()}
        lines = [
            f"{out / name}.{suffix}: {made.vertices} vertices, {made.faces} faces, "
            f"{made.seconds:.2f} s" + "".join(f"; warning: {each}" for each in made.warnings)
            for name, made in report.made.items()
        ]
        reporter.finish(report, out, skip_bad, {"meshes": meshes}, lines)
        return
    if len(clouds) > 1:
        raise InputError(f"{len(clouds)} inputs", allowed="one", hint="add --each")
    out = mesh_path(out, form)
    require_apart([out, picture], inputs)
    require_place(out, force)
    common.check_picture(picture, force)
    task = MeshTask(clouds[0], files, camera_pose, out, settings, threads, force)
    _mesh_one(reporter, task, picture)


def _mesh_one(reporter: common.Reporter, task: MeshTask, picture: Path | None) -> None:
    """Mesh one cloud and report; 0 threads stand for the idle processors.

    Raises:
        InputError: The cloud cannot be used.
        EmptySurfaceError: The network sees nothing solid in it.
    """
    import numpy as np

    from pointsdf_cli.geometry.frames import apply_transform
    from pointsdf_cli.io.idle_processors import IdleProcessors
    from pointsdf_cli.io.meshes import UNITS, save_mesh
    from pointsdf_cli.preload import preload

    idle = IdleProcessors()
    preload(("torch",))
    cloud, settings, unit = task.cloud, task.settings, task.files.unit
    seen = settings.view(cloud, task.files, task.pose)
    points = seen.points
    reporter.say(*seen.notes)
    if len(points) < FEW:
        reporter.say(f"{cloud}: {len(points)} points are few: expect a poor shape below {FEW}")
    if seen.alone and np.ptp(points, axis=0).max() > SCENE:
        reporter.say(f"warning: {cloud} is wide for one object: of a table? Add --segment auto")

    # Seconds of imports: only for a cloud that can be used.
    from pointsdf_cli.models.registry import load_model, use_threads
    from pointsdf_cli.planning.complete_mesh import complete_mesh

    use_threads(task.threads or idle.count())
    model = load_model(settings.checkpoint, common.torch_device(settings.device))
    completed = complete_mesh(model, seen, settings.choices, str(cloud))
    made = completed.mesh
    reporter.say(*(f"warning: {sentence}" for sentence in completed.warnings))
    vertices = apply_transform(seen.T_frame_camera, made.vertices) / UNITS[unit]
    save_mesh(task.out, vertices, made.faces, seen.comments)
    if picture:
        # Matplotlib and Open3D take longer to load than the mesh takes to make.
        from pointsdf_cli.viz.reconstruction_gallery import GalleryRow, draw_gallery

        surface, sdf = (made.vertices, made.faces), completed.reconstruction.sdf
        draw_gallery(picture, [GalleryRow(cloud.stem, points, surface, None, sdf)])
    values: dict[str, Any] = {
        "out": task.out,
        "picture": picture,
        "vertices": len(vertices),
        "faces": len(made.faces),
        "extent": np.ptp(vertices, axis=0),
        "unit": unit,
        "frame": seen.frame,
        "points": len(points),
        "resolution": settings.choices.resolution,
        "parts_dropped": made.parts_dropped,
        "queries": made.queries,
        "vessel": completed.reconstruction.vessel is not None,
        "seconds": completed.seconds,
        "warnings": completed.warnings,
    }
    reporter.result(values, _lines(values))


def _lines(made: dict[str, Any]) -> list[str]:
    sides = " × ".join(f"{side:.4g}" for side in made["extent"])
    dropped = made["parts_dropped"]
    return [
        f"{made['out']}: {made['vertices']} vertices, {made['faces']} faces, {sides} "
        f"{made['unit']}, in the {made['frame']} frame",
        f"made in {made['seconds']:.2f} s at {made['resolution']}³"
        + ("; the thin wall of a vessel is fitted" if made["vessel"] else "")
        + (f"; {dropped} loose part{'s' * (dropped > 1)} dropped" if dropped else ""),
    ]


def mesh_path(out: Path | None, form: str | None) -> Path:
    """Path of the mesh from --out and --format, which must agree; either may be missing.

    Raises:
        InputError: An unknown format, or two different ones.
    """
    out = out or Path(f"mesh.{form or 'ply'}")
    suffix = out.suffix.lower().lstrip(".")
    form, known = form or suffix, get_args(choices.MeshFormat)
    if form not in known:
        raise InputError(f"no mesh format {form!r}", where="--out", allowed=", ".join(known))
    if not out.name:
        raise InputError(f"{out} is a folder", where="--out", allowed=f"such as mesh.{form}")
    if not suffix:
        return out.with_suffix(f".{form}")
    if suffix != form:
        what = f"--format {form} and --out {out.name} disagree"
        raise InputError(what, where="--out", allowed=f"a name that ends in .{form}")
    return out
