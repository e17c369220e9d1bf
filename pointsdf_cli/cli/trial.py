"""`rgrasp trial`: the paper's experiment in simulation, from depth image to lifted object."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Literal

import typer

from pointsdf_cli.cli import common
from pointsdf_cli.errors import InputError
from pointsdf_cli.planning.option_checks import MARGIN


def trial(
    out: Annotated[Path, typer.Option(help="Output folder of trials, table and report.")] = Path(
        "trials"
    ),
    meshes: Annotated[
        Path | None,
        typer.Option(help="Folder of meshes, YCB or any.  [default: stand-ins of the eight]"),
    ] = None,
    objects: Annotated[
        str,
        typer.Option(
            help="Objects: eight, all, others (all but the eight), names separated by commas, "
            "or auto: the eight if the folder is of YCB, else all."
        ),
    ] = "auto",
    method: Annotated[
        Literal["both", "reconstruction", "partial-view"],
        typer.Option(help="Source of the object's shape."),
    ] = "both",
    ablation: Annotated[
        list[str] | None,
        typer.Option(
            help="Ablation of the reconstruction method to add: oracle, no-object-constraint, "
            "no-success-network, no-cleaning, no-free-space, no-support-plane, all "
            "(of these), checkpoint=PATH."
        ),
    ] = None,
    yaws: Annotated[
        int, typer.Option(min=1, help="Number of evenly spaced yaws of each object.")
    ] = 3,
    cameras: Annotated[
        str, typer.Option(help="Cameras: high, low, or both separated by a comma.")
    ] = "high,low",
    repeats: Annotated[
        int,
        typer.Option(min=1, help="Number of repetitions, each with its own yaws, place and noise."),
    ] = 1,
    solver: common.Solver = "sqp",
    clearance: Annotated[
        float, typer.Option(help="Smallest distance to the object in plans [m].")
    ] = 0.001,
    margin: Annotated[
        float, typer.Option(help="Preferred distance to the object in plans [m].")
    ] = MARGIN,
    checkpoint: common.Checkpoint = None,
    grasp_checkpoint: common.GraspCheckpoint = None,
    robot: common.Robot = None,
    sensor: common.Sensor = "structured-light",
    clutter: Annotated[
        int,
        typer.Option(
            min=0,
            help="Number of other objects of the folder around the target; a trial in which one "
            "falls over or moves more than 2 cm fails.",
        ),
    ] = 0,
    shake: common.Shake = 0.0,
    hold: Annotated[
        float,
        typer.Option(
            min=0, max=600, help="Time that the lifted object must be held [s]; 0 for none."
        ),
    ] = 5.0,
    push: Annotated[
        float,
        typer.Option(
            min=0,
            max=1000,
            help="Then push its centre of mass with this force [N] for 1 s along each of "
            "±x, ±y and ±z; 0 for none.",
        ),
    ] = 2.5,
    unit: common.Unit = "m",
    pattern: common.Pattern = "*",
    record: Annotated[int, typer.Option(min=0, help="Write this many trials as GIF films.")] = 0,
    pictures: Annotated[
        int, typer.Option(min=0, help="Number of failures to draw in the report.")
    ] = 40,
    seed: common.Seed = 0,
    jobs: common.Jobs = 0,
    shard: common.Shard = None,
    force: common.Force = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Repeat the paper's 96 trials in simulation: both methods, eight objects, two cameras.

    An interrupted run resumes. The report is report.html and report.md beside trials.h5.

    Example: rgrasp trial --out trials/ --meshes ycb/
    """
    from pointsdf_cli.io.present import require_present
    from pointsdf_cli.models.checkpoint_kinds import require_reconstructions, require_successes
    from pointsdf_cli.robot.description import load_robot
    from pointsdf_cli.trials import protocol

    reporter = common.Reporter(quiet, as_json)
    if clutter and shake:  # gravity is shaken in place of the hand: everything would move
        raise InputError("--shake with --clutter", hint="leave one of the two out")
    require_present(meshes)
    machine = load_robot(robot)
    variants = protocol.planner_variants(method, ablation or [])
    require_reconstructions([checkpoint, *protocol.checkpoints_of(variants)])
    require_successes([grasp_checkpoint], machine)
    chosen = protocol.choose_objects(meshes, objects, pattern, unit)
    pool = protocol.clutter_pool(meshes, pattern, unit) if clutter else []
    asked = [name for camera in cameras.split(",") if (name := camera.strip())]
    trials = protocol.make_trials(chosen, variants, yaws, asked, repeats, seed, clutter, pool)

    # Seconds of imports: only for what can be used.
    from pointsdf_cli.io.batch import shard_of
    from pointsdf_cli.planning.grasp_planner import PlanOptions
    from pointsdf_cli.planning.grasp_problem import Clearances
    from pointsdf_cli.planning.planner import PlannerConfig
    from pointsdf_cli.simulation.executor import ExecutorConfig
    from pointsdf_cli.simulation.world import try_robot
    from pointsdf_cli.trials.experiment import make_tasks, write_results
    from pointsdf_cli.trials.run import TrialConfig, run_trial_task

    try_robot(machine)  # report a wrong robot once, here
    planner = PlannerConfig(solver, Clearances(object=clearance), margin)
    planning = PlanOptions(
        robot=robot, checkpoint=checkpoint, grasp_checkpoint=grasp_checkpoint, planner=planner
    )
    execution = ExecutorConfig(shake=shake, hold=hold, push=push)
    config = TrialConfig(planning, execution=execution, sensor=sensor)
    common.say_if_from_another(reporter, planning)
    tasks = make_tasks(trials, config, out, record, force)
    started = time.monotonic()
    mine = shard_of(list(tasks.items()), shard)
    report = reporter.stage("trial", mine, run_trial_task, jobs, [out / "trials"])
    found, lines = write_results(out, tasks, report, pictures)
    reporter.say(*(f"skipped: {name}: {why}" for name, why in found["refused"].items()))
    if found["trials"]:
        found["report"] = out / "report.html"
        found["seconds"] = round(time.monotonic() - started, 3)
        lines.append(f"{found['report']}")
    elif shard is not None:  # other shards may have some
        lines = [f"{out}: no trials in shard {shard}"]
    else:
        reasons = "; ".join(f"{k}: {v}" for k, v in found["refused"].items())
        raise InputError(f"no trial could be run: {reasons}", where=meshes)
    reporter.result({"out": out, **found}, lines)
