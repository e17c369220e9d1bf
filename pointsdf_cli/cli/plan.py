"""`rgrasp plan`: clouds of a table top to a grasp, the motion to it, or the reason for none."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pointsdf_cli.cli import common

if TYPE_CHECKING:
    from pointsdf_cli.camera.scene_file import SceneFileOptions
    from pointsdf_cli.io.plans import Plan
    from pointsdf_cli.planning.plan_request import PlanRequest, PlanResult
    from pointsdf_cli.planning.scene_input import SceneInput


def plan(
    clouds: Annotated[
        list[Path],
        typer.Argument(
            help="Depth images or clouds of one scene, one a camera: 16-bit PNG, TIFF, PGM or NPY; "
            "PLY, PCD, XYZ, TXT, CSV or NPY."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Output plan.")] = Path("plan.h5"),
    method: Annotated[
        str, typer.Option(help="Method: reconstruction or partial-view.")
    ] = "reconstruction",
    solver: Annotated[str, typer.Option(help="Solver: sqp, or slsqp (the paper's, slow).")] = "sqp",
    kind: Annotated[
        str,
        typer.Option(
            help="Kind of grasp: side, top, or auto (the better of both; below 3 cm top first)."
        ),
    ] = "auto",
    target: Annotated[
        str | None,
        typer.Option(
            metavar="N|U,V|X,Y,Z|any",
            help="The object: its number as `rgrasp segment` lists them, a pixel, a place in the "
            "world [m], or any: whichever can be taken first [default: the most reachable one "
            "near the middle of the image].",
        ),
    ] = None,
    camera_pose: Annotated[
        list[str] | None,
        typer.Option(
            metavar="POSE",
            help="Camera pose in the world: X,Y,Z,QW,QX,QY,QZ, or a file, one for each view. "
            "For trying out, table[:X,Y]: z = 0 is the observed table, the object at "
            "0.6,0 or X,Y.",
            show_default=False,
        ),
    ] = None,
    intrinsics: Annotated[
        list[str] | None,
        typer.Option(
            metavar="K.json",
            help="Intrinsics of depth images, one for all or one for each: K matrix, ROS "
            "camera_info, RealSense or Open3D intrinsics (JSON or YAML), or kinect2.",
            show_default=False,
        ),
    ] = None,
    depth_scale: common.DepthScale = None,
    mask: Annotated[
        list[str] | None,
        typer.Option(
            metavar="MASK.png",
            help="Mask image of the object, from any segmenter, one for each view: its nonzero "
            "pixels; MASK.png:7 takes the pixels of value 7.",
            show_default=False,
        ),
    ] = None,
    no_clean: common.NoClean = False,
    frame: Annotated[
        str | None,
        typer.Option(
            help="Frame of the cloud: camera or world [default: as the file says, else camera]."
        ),
    ] = None,
    unit: Annotated[str, typer.Option(help="Unit of the clouds: m, cm, mm or inch.")] = "m",
    drop_invalid: Annotated[
        bool, typer.Option("--drop-invalid", help="Leave out points that are NaN or infinite.")
    ] = False,
    segment: Annotated[
        str, typer.Option(help="Segmentation: auto, or none for clouds of the object alone.")
    ] = "auto",
    environment: Annotated[
        Path | None, typer.Option(help="YAML of the table and known obstacles.", show_default=False)
    ] = None,
    workspace: common.Workspace = None,
    ignore_others: Annotated[
        bool,
        typer.Option(
            "--ignore-others", help="Ignore other observed objects instead of avoiding them."
        ),
    ] = False,
    obstacles: Annotated[
        str,
        typer.Option(
            help="Other observed objects: their reconstruction, or the hull of their seen points "
            "(faster, without a back; always with partial-view)."
        ),
    ] = "reconstruction",
    clearance: Annotated[
        float | None,
        typer.Option(
            help="Smallest distance to everything [m] [default: object and self 0.001, table "
            "0.002].",
            show_default=False,
        ),
    ] = None,
    margin: Annotated[
        float, typer.Option(help="Preferred distance to the object, down to the clearance [m].")
    ] = 0.004,
    speed: Annotated[
        float, typer.Option(help="Speed of the motion as a share of the joints' speed limits.")
    ] = 0.5,
    rehearse: Annotated[
        int,
        typer.Option(
            metavar="N", help="Try up to N grasps a round in simulation on the reconstruction."
        ),
    ] = 0,
    min_success: Annotated[
        float | None,
        typer.Option(
            help="Refuse grasps with a lower predicted probability  [default: 0.1; if none reaches "
            "it, the best above 0.03, with a warning]",
            show_default=False,
        ),
    ] = None,
    accept_unlikely: Annotated[
        bool,
        typer.Option(
            "--accept-unlikely", help="Exit with 0 instead of 4 if no grasp is likely to hold."
        ),
    ] = False,
    start: Annotated[
        str | None,
        typer.Option(
            metavar="Q", help="Start configuration [rad], or a file [default: the robot's home]."
        ),
    ] = None,
    robot: Annotated[
        Path | None, typer.Option(help="Robot YAML [default: LBR4 + Allegro].", show_default=False)
    ] = None,
    checkpoint: Annotated[
        Path | None,
        typer.Option(help="Reconstruction weights [default: bundled].", show_default=False),
    ] = None,
    grasp_checkpoint: Annotated[
        Path | None, typer.Option(help="Success weights [default: bundled].", show_default=False)
    ] = None,
    trajectory: Annotated[
        Path | None,
        typer.Option(help="Also write the motion as a ROS JointTrajectory in JSON."),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(help="Output picture [default: beside the plan].", show_default=False),
    ] = None,
    no_picture: Annotated[bool, typer.Option("--no-picture", help="Draw no picture.")] = False,
    server: common.Server = None,
    threads: common.Threads = 0,
    seed: common.Seed = 0,
    device: common.Device = "cpu",
    force: common.Force = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Plan a grasp of an object that nobody has modelled: configuration, motion, scores.

    Exit code 3: no plan was found; the plan file holds the reason. Exit code 4: a plan was found,
    written, and is not likely to hold (see --min-success and --accept-unlikely).

    Example: rgrasp plan depth.png --intrinsics K.json --camera-pose T.json
    """
    from pointsdf_cli.errors import NoPlanError, UnlikelyPlanError
    from pointsdf_cli.io.apart import require_apart
    from pointsdf_cli.io.atomic import require_new
    from pointsdf_cli.io.checkpoints import read_config
    from pointsdf_cli.io.plans import OK, write_plan, write_trajectory
    from pointsdf_cli.io.poses import box
    from pointsdf_cli.planning.environment import Environment, read_environment
    from pointsdf_cli.planning.option_checks import check_obstacles, check_segment
    from pointsdf_cli.planning.plan_request import PlanChoices, PlanRequest
    from pointsdf_cli.robot.description import load_robot
    from pointsdf_cli.robot.start import start_configuration

    reporter = common.Reporter(quiet, as_json)
    common.check_seed(seed)
    common.check_suffix(out, "--out", (".h5", ".hdf5"))
    picture = None if no_picture else picture or out.with_suffix(".png")
    require_apart(
        [out, picture, trajectory],
        [
            *clouds, *(camera_pose or ()), *(intrinsics or ()), *(mask or ()), environment, robot,
            start, target, workspace, checkpoint, grasp_checkpoint,
        ],
    )  # fmt: skip
    require_new(out, force)
    files = {"--out": out, "--picture": picture, "--trajectory": trajectory}
    common.check_picture(picture, force)
    _require_places({k: path for k, path in files.items() if path is not None}, force)
    if trajectory is not None:
        common.check_suffix(trajectory, "--trajectory", (".json",))
    looked_at = None if workspace is None else box(workspace, "--workspace")
    choices = PlanChoices(method, solver, kind, clearance, margin, speed, rehearse, min_success)
    if server is not None:
        _check_server(server, threads, device)
    check_segment(segment, target is not None, workspace is not None)
    check_obstacles(obstacles)
    common.check_device(device)
    around = Environment() if environment is None else read_environment(environment)
    described = load_robot(robot)
    start_at = start_configuration(start, described)
    for weights in (checkpoint, grasp_checkpoint):
        if weights is not None:
            read_config(weights)
    options_of_files = _file_options(
        len(clouds),
        intrinsics,
        mask,
        depth_scale=depth_scale,
        unit=unit,
        frame=frame,
        drop_invalid=drop_invalid,
    )
    given = _read_scene(clouds, camera_pose, options_of_files, target, looked_at, no_clean, robot)
    for note in given.notes:
        reporter.say(note)
    request = PlanRequest(
        given.clouds,
        [str(path) for path in clouds],
        choices,
        around,
        None if start is None else start_at,
        seed,
        segment,
        given.target,
        not ignore_others,
        looked_at,
        not no_clean,
        obstacles,
    )
    request.check()
    if server is None:
        result = _plan_here(reporter, request, robot, checkpoint, grasp_checkpoint, device, threads)
    else:
        from pointsdf_cli.service.client import plan_at

        result = plan_at(server, request, robot, checkpoint, grasp_checkpoint)
        for sentence in result.warnings:
            reporter.say(f"warning: {sentence}")
    for line in result.report:
        reporter.say(line)
    answer = result.plan
    asked: dict[str, Any] = {
        "rehearse": rehearse,
        "target": target,
        "start": start,
        "segment": segment,
        "workspace": workspace,
    }
    asked |= {"environment": environment and str(environment), "ignore_others": ignore_others}
    asked |= {"unit": unit, "frame": frame, "camera_pose": camera_pose}
    asked |= {"intrinsics": intrinsics, "depth_scale": depth_scale, "mask": mask}
    asked |= {"clean": not no_clean, "obstacles": obstacles}
    config = _config(result.options, clouds, seed) | asked
    for stale in (trajectory, picture):  # a motion to another object must not outlive its plan
        if stale is not None:
            stale.resolve().unlink(missing_ok=True)  # of a link, what it leads to
    write_plan(out, answer, seed=seed, config=config)
    found = answer.status == OK
    if trajectory is not None and found:
        write_trajectory(trajectory, answer)
    stale_picture = out.with_suffix(".png")
    if no_picture and stale_picture.exists():
        reporter.say(f"{stale_picture} was there before and does not show this plan")
    _report(reporter, result, out, picture, trajectory if found else None)
    if picture is not None:
        sys.stdout.flush()  # the plan is on disk: who reads this need not wait for the picture
        from pointsdf_cli.viz.plan_picture import plan_picture
        from pointsdf_cli.viz.robot_picture import RobotMeshes

        title = _headline(answer)
        below = "; ".join((*result.report, *result.warnings))
        q = answer.q if found else result.start
        plan_picture(picture, RobotMeshes(described), q, result.scene(), title, below)
    if not found:
        raise NoPlanError(f"no plan ({answer.reason}): {answer.sentence.rstrip('.')}", where=out)
    least = result.least
    if answer.success_probability < least and not accept_unlikely:
        raise UnlikelyPlanError(
            f"the plan is not likely to hold: probability {answer.success_probability:.2f}, below "
            f"{least:g}",
            where=out,
            hint="--accept-unlikely takes it all the same (exit code 0); or turn the object, or "
            "look at it from another side",
        )


def _require_places(files: dict[str, Path], force: bool) -> None:
    """Each file has a place of its own that can be written: known before the planning.

    Raises:
        InputError: Two have one path, one exists already, or a folder cannot be written.
    """
    from pointsdf_cli.errors import InputError
    from pointsdf_cli.io.atomic import require_folder, require_new

    places = [path.resolve() for path in files.values()]
    if len(set(places)) < len(places):
        raise InputError("two outputs have one path", where=", ".join(files), allowed="one each")
    for path in files.values():
        require_folder(require_new(path, force).parent)


def _file_options(
    count: int, intrinsics: list[str] | None, masks: list[str] | None, **same: Any
) -> list[SceneFileOptions]:
    """Reading options of each file.

    Raises:
        InputError: Neither one for all nor one for each.
    """
    from pointsdf_cli.camera.scene_file import SceneFileOptions
    from pointsdf_cli.errors import InputError

    cameras: list[str | None] = [*intrinsics] if intrinsics else [None]
    if len(cameras) == 1:
        cameras = cameras * count
    on: list[str | None] = [*masks] if masks else [None] * count
    for option, given in (("--intrinsics", cameras), ("--mask", on)):
        if len(given) != count:
            raise InputError(
                f"{len(given)} for {count} views", where=option, allowed="one for each, in order"
            )
    return [
        SceneFileOptions(intrinsics=k, mask=m, **same) for k, m in zip(cameras, on, strict=True)
    ]


def _read_scene(
    paths: list[Path],
    poses: list[str] | None,
    options: list[SceneFileOptions],
    target: str | None,
    looked_at: tuple[tuple[float, ...], tuple[float, ...]] | None,
    no_clean: bool,
    robot: Path | None,
) -> SceneInput:
    """The views with their poses, and the object that is meant."""
    from pointsdf_cli.planning.scene_input import read_scene
    from pointsdf_cli.planning.table_top import workspace_of
    from pointsdf_cli.robot.description import load_robot

    return read_scene(
        paths,
        poses or [],
        options,
        target,
        workspace_of(looked_at),
        not no_clean,
        load_robot(robot),
    )


def _check_server(server: str, threads: int, device: str) -> None:
    """Refuse an address that is none, and options that are the server's own.

    Raises:
        InputError: One of these.
    """
    from pointsdf_cli.errors import InputError
    from pointsdf_cli.service.address import server_address

    server_address(server)
    for option, given in (("--threads", threads != 0), ("--device", device != "cpu")):
        if given:
            raise InputError(
                f"{option} with --server", hint=f"give {option} to `rgrasp serve`, or leave it out"
            )


def _plan_here(
    reporter: common.Reporter,
    request: PlanRequest,
    robot: Path | None,
    checkpoint: Path | None,
    grasp_checkpoint: Path | None,
    device: str,
    threads: int,
) -> PlanResult:
    """The answer of this process, which loads what it needs first."""
    # Seconds of imports: only for clouds and options that can be used.
    from pointsdf_cli.models.registry import use_threads
    from pointsdf_cli.planning.option_checks import RECONSTRUCTION
    from pointsdf_cli.service.resident import Resident
    from pointsdf_cli.training.precision import idle_processors

    resident = Resident(robot, checkpoint, grasp_checkpoint, common.torch_device(device))
    use_threads(threads or idle_processors())
    resident.planner(request.choices)  # what cannot be loaded is told first
    if request.choices.method == RECONSTRUCTION:
        common.say_if_from_another(reporter, checkpoint, grasp_checkpoint)
    return resident.plan(request, lambda sentence: reporter.say(f"warning: {sentence}"))


def _config(options: dict[str, Any], clouds: list[Path], seed: int) -> dict[str, Any]:
    """Provenance for the plan file."""
    from pointsdf_cli.io.provenance import file_sha256

    sums = [file_sha256(path) for path in clouds]
    return options | {"clouds": [str(path) for path in clouds], "cloud_sha256": sums, "seed": seed}


def _headline(plan: Plan) -> str:
    if plan.reason:
        return f"no plan: {plan.reason}. {plan.sentence}"
    return (
        f"{plan.kind} grasp, predicted to hold with probability {plan.success_probability:.2f}, "
        f"objective {plan.objective:.2f}"
    )


def _report(
    reporter: common.Reporter,
    result: PlanResult,
    out: Path,
    picture: Path | None,
    trajectory: Path | None,
) -> None:
    from pointsdf_cli.io.plans import plan_as_json
    from pointsdf_cli.planning.plan_request import as_sentences

    plan, warnings = result.plan, result.warnings
    files = {"out": out, "picture": picture, "trajectory_file": trajectory}
    lines = []  # why there is no plan is the message with which the command fails
    if not plan.reason:
        lines.append(f"{out}: {_headline(plan)}")
        # What was said before the planning is not said again.
        doubt = plan.sentence.removesuffix(as_sentences(warnings)).strip()
        if doubt:
            reporter.say(f"warning: {doubt}")
        near = float(plan.link_clearance_object.min()) * 1000
        lines.append(
            f"configuration in {plan.timings['configuration']:.2f} s from {plan.seeds_tried} seeds "
            f"({len(plan.accepted.kinds)} accepted), motion in {plan.timings['motion']:.2f} s: "
            f"{len(plan.times)} points, {plan.times[-1]:.1f} s; nearest to the object {near:.1f} mm"
        )
    lines += [
        f"{path}: {what}"
        for what, path in (("the picture", picture), ("the motion", trajectory))
        if path
    ]
    reporter.result(
        {**plan_as_json(plan), "clouds": list(result.report), "warnings": list(warnings), **files},
        lines,
    )
