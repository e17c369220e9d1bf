"""`rgrasp plan`: clouds of a table top to a grasp, the motion to it, or the reason for none."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from pointsdf_cli import choices
from pointsdf_cli.cli import common
from pointsdf_cli.cli.plan_each import plan_each
from pointsdf_cli.cli.plan_one import PlanOutputs, plan_one
from pointsdf_cli.errors import InputError
from pointsdf_cli.planning.option_checks import MARGIN, SPEED


def plan(
    context: typer.Context,
    clouds: Annotated[
        list[Path],
        typer.Argument(
            help="Depth images or clouds of one scene, one a camera: 16-bit PNG, TIFF, PGM or NPY; "
            "PLY, PCD, XYZ, TXT, CSV or NPY."
        ),
    ],
    out: Annotated[Path | None, typer.Option(help="Output plan [default: plan.h5].")] = None,
    method: Annotated[
        choices.Method, typer.Option(help="Source of the object's shape.")
    ] = "reconstruction",
    solver: common.Solver = "sqp",
    kind: Annotated[
        choices.GraspKind,
        typer.Option(
            help="Kind of grasp; auto takes the better one, top first for objects below 3 cm."
        ),
    ] = "auto",
    target: Annotated[
        str | None,
        typer.Option(
            metavar="N|U,V|X,Y,Z|any",
            help="The object: its number in the list of `rgrasp segment`, a pixel, a place in the "
            "world [m], or any: the first that can be grasped [default: number 1].",
        ),
    ] = None,
    camera_pose: Annotated[
        list[str] | None,
        typer.Option(
            metavar="POSE",
            help="Camera pose in the world: X,Y,Z,QW,QX,QY,QZ, or a file, one for each view. "
            "To try things out, table[:X,Y]: z = 0 is the observed table, the object at "
            "0.6,0 or X,Y.",
        ),
    ] = None,
    intrinsics: Annotated[
        list[str] | None,
        typer.Option(
            metavar="K.json",
            help="Intrinsics of depth images, one for all or one for each: K matrix, ROS "
            "camera_info, RealSense or Open3D intrinsics (JSON or YAML), or kinect2.",
        ),
    ] = None,
    depth_scale: common.DepthScale = None,
    mask: Annotated[
        list[str] | None,
        typer.Option(
            metavar="MASK.png",
            help="Mask image of the object, from any segmenter, one for each view: its nonzero "
            "pixels; MASK.png:7 takes the pixels of value 7.",
        ),
    ] = None,
    no_clean: common.NoClean = False,
    frame: common.Frame = None,
    unit: common.Unit = "m",
    drop_invalid: common.DropInvalid = False,
    segment: Annotated[
        choices.Segment, typer.Option(help="Segmentation; none for clouds of the object alone.")
    ] = "auto",
    environment: Annotated[
        Path | None, typer.Option(help="YAML of the table and known obstacles.")
    ] = None,
    workspace: common.Workspace = None,
    ignore_others: Annotated[
        bool,
        typer.Option(
            "--ignore-others", help="Ignore other observed objects instead of avoiding them."
        ),
    ] = False,
    obstacles: Annotated[
        choices.Obstacles,
        typer.Option(
            help="Other observed objects: their reconstruction, or the hull of their seen points "
            "(faster, without the unseen side; always with partial-view)."
        ),
    ] = "reconstruction",
    clearance: Annotated[
        float | None,
        typer.Option(
            help="Smallest distance to everything [m] [default: object and self 0.001, table "
            "0.002]."
        ),
    ] = None,
    margin: Annotated[
        float, typer.Option(help="Preferred distance to the object, down to the clearance [m].")
    ] = MARGIN,
    speed: Annotated[
        float, typer.Option(help="Speed of the motion as a share of the joints' speed limits.")
    ] = SPEED,
    min_success: Annotated[
        float | None,
        typer.Option(
            help="Refuse grasps with a lower predicted probability  [default: 0.1; if none reaches "
            "it, the best above 0.03, with a warning]"
        ),
    ] = None,
    accept_unlikely: Annotated[
        bool,
        typer.Option(
            "--accept-unlikely", help="Exit with 0 instead of 4 if no grasp is likely to hold."
        ),
    ] = False,
    start: common.Start = None,
    robot: common.Robot = None,
    checkpoint: common.Checkpoint = None,
    grasp_checkpoint: common.GraspCheckpoint = None,
    trajectory: Annotated[
        Path | None, typer.Option(help="Also write the motion as a ROS JointTrajectory in JSON.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Output picture [default: beside the plan].")
    ] = None,
    no_picture: Annotated[bool, typer.Option("--no-picture", help="Draw no picture.")] = False,
    each: Annotated[
        bool,
        typer.Option(
            "--each",
            help="Plan every input as a scene by itself, into the folder --out [default: plans]; "
            "what is there already is kept.",
        ),
    ] = False,
    jobs: common.EachJobs = None,
    skip_bad: common.EachSkipBad = False,
    server: common.Server = None,
    threads: common.Threads = 0,
    seed: common.Seed = 0,
    device: common.Device = "cpu",
    force: common.Force = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Plan a grasp of an object that nobody has modelled: configuration, motion, scores.

    Exit code 3: no plan was found; the plan file holds the reason. Exit code 4: the plan that was
    written is not likely to hold (see --min-success and --accept-unlikely).

    Example: rgrasp plan depth.png --intrinsics K.json --camera-pose T.json

    Example: rgrasp plan scenes/*.ply --each --out plans/
    """
    from pointsdf_cli.io.apart import require_apart
    from pointsdf_cli.io.atomic import require_folder
    from pointsdf_cli.io.each_file import check_each, one_for_each, require_one_name_each
    from pointsdf_cli.io.idle_processors import IdleProcessors
    from pointsdf_cli.io.poses import box, table_place
    from pointsdf_cli.models.checkpoint_kinds import require_reconstructions, require_successes
    from pointsdf_cli.planning.environment import Environment, read_environment
    from pointsdf_cli.planning.option_checks import check_segment
    from pointsdf_cli.planning.plan_request import PlanChoices, PlanRequest
    from pointsdf_cli.preload import preload
    from pointsdf_cli.robot.description import load_robot
    from pointsdf_cli.robot.start import start_configuration

    idle = IdleProcessors()
    reporter = common.Reporter(quiet, as_json)
    inputs = [
        *clouds, *(camera_pose or ()), *(intrinsics or ()), *(mask or ()), environment, robot,
        start, target, workspace, checkpoint, grasp_checkpoint,
    ]  # fmt: skip
    out = out or Path("plans" if each else "plan.h5")
    if picture is not None and no_picture:
        raise InputError("--picture with --no-picture", hint="leave one of the two out")
    for_one = {"--trajectory": trajectory, "--picture": picture, "--server": server}
    check_each(each, for_one, jobs, skip_bad)
    if not each:
        common.check_suffix(out, "--out", (".h5", ".hdf5"))
        drawn = None if no_picture else picture or out.with_suffix(".png")
        outputs = PlanOutputs(out, drawn, trajectory)
        outputs.require_free(inputs, force)
    if trajectory is not None and any(table_place(pose) for pose in camera_pose or ()):
        raise _assumed_pose("--trajectory")
    corners = None if workspace is None else box(workspace, "--workspace")
    search = PlanChoices(method, solver, kind, clearance, margin, speed, min_success)
    if server is not None:
        _check_server(server, threads, device)
    check_segment(segment, target is not None, workspace is not None)
    around = Environment() if environment is None else read_environment(environment)
    described = load_robot(robot)  # a wrong one is told before seconds of imports
    start_at = None if start is None else start_configuration(start, described)
    require_reconstructions([checkpoint])
    require_successes([grasp_checkpoint], described)
    if server is None and not each:
        preload(("torch",) if no_picture else ("torch", "open3d"))
    # What reads clouds is loaded for options that can be used.
    from pointsdf_cli.camera.scene_file import options_of_views
    from pointsdf_cli.service.each_plan import PlanTask
    from pointsdf_cli.service.identity import PlannerFiles
    from pointsdf_cli.service.plan_settings import PlanSettings

    files = options_of_views(
        len(clouds), intrinsics, mask,
        depth_scale=depth_scale, unit=unit, frame=frame, drop_invalid=drop_invalid,
    )  # fmt: skip
    request = PlanRequest(
        choices=search, environment=around, start=start_at, seed=seed, segment=segment,
        others=not ignore_others, workspace=corners, cleaned=not no_clean, obstacles=obstacles,
    )  # fmt: skip
    planner = PlannerFiles(robot, checkpoint, grasp_checkpoint)
    settings = PlanSettings(request, target, planner, device)
    if each:
        common.torch_device(device)
        common.say_if_from_another(reporter, planner, method)
        require_one_name_each(clouds)
        typed = one_for_each(camera_pose or [], len(clouds), "--camera-pose")
        out = require_folder(out)
        tasks = []
        for view, pose, file in zip(clouds, typed, files, strict=True):
            path = out / f"{view.stem}.h5"
            image = None if no_picture else path.with_suffix(".png")
            task = PlanTask(view, file, pose, path, image, settings, threads or 1, force)
            tasks.append((view.stem, task))
        require_apart((p for _, task in tasks for p in (task.out, task.picture)), inputs)
        least = 0.0 if accept_unlikely else search.acceptance().least
        plan_each(reporter, tasks, out, least, jobs, skip_bad)
        return
    request, notes = settings.read(clouds, camera_pose or [], files)
    if trajectory is not None:
        for cloud, name in zip(request.clouds, request.names, strict=True):
            if cloud.over_table:
                raise _assumed_pose(name)
    reporter.say(*notes)
    plan_one(
        reporter, request, settings, outputs, _as_typed(context.params), idle,
        server=server, threads=threads, accept_unlikely=accept_unlikely,
    )  # fmt: skip


def _assumed_pose(where: str) -> InputError:
    what = "a motion with an assumed camera pose would miss the object"
    instead = "calibrate the camera and give its pose (docs/your-camera.md)"
    return InputError(what, where=where, hint=f"leave --trajectory out, or {instead}")


_RECORDED = (
    "target", "start", "segment", "workspace", "ignore_others", "obstacles", "unit",
    "frame", "camera_pose", "intrinsics", "depth_scale", "mask",
)  # fmt: skip
"""Options that the plan's provenance holds as they were typed."""


def _as_typed(given: Mapping[str, Any]) -> dict[str, Any]:
    environment = given["environment"]
    return {
        # () stands there for an option that may be repeated and was not given.
        **{name: None if given[name] == () else given[name] for name in _RECORDED},
        "environment": environment and str(environment),
        "clean": not given["no_clean"],
    }


def _check_server(server: str, threads: int, device: str) -> None:
    """Refuse an invalid address, and options that only the server takes.

    Raises:
        InputError: The address is invalid, or such an option is given.
    """
    from pointsdf_cli.service.address import server_address

    server_address(server)
    if option := choices.first_given({"--threads": threads != 0, "--device": device != "cpu"}):
        hint = f"give {option} to `rgrasp serve`, or leave it out"
        raise InputError(f"{option} with --server", hint=hint)
