"""`rgrasp trial`: the paper's experiment in simulation, from depth image to lifted object."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pointsdf_cli.cli import common
from pointsdf_cli.errors import InputError

if TYPE_CHECKING:
    from pointsdf_cli.io.trials import TrialRow
    from pointsdf_cli.trials.protocol import PlannerVariant
    from pointsdf_cli.trials.run import TrialTask


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
        str, typer.Option(help="Method: reconstruction, partial-view, or both.")
    ] = "both",
    ablation: Annotated[
        list[str] | None,
        typer.Option(
            help="Ablation of the reconstruction method to add: oracle, no-object-constraint, "
            "no-success-network, no-rehearsal, all (of these), checkpoint=PATH.",
            show_default=False,
        ),
    ] = None,
    yaws: Annotated[int, typer.Option(help="Number of evenly spaced yaws of each object.")] = 3,
    cameras: Annotated[
        str, typer.Option(help="Cameras: high, low, or both separated by a comma.")
    ] = "high,low",
    repeats: Annotated[
        int, typer.Option(help="Number of repetitions, each with its own yaws, place and noise.")
    ] = 1,
    solver: Annotated[str, typer.Option(help="Solver: sqp, or slsqp (the paper's, slow).")] = "sqp",
    rehearse: Annotated[
        int,
        typer.Option(
            help="Number of grasps per round to rehearse on the reconstruction; 0 for none."
        ),
    ] = 12,
    clearance: Annotated[
        float, typer.Option(help="Smallest distance to the object in plans [m].")
    ] = 0.001,
    margin: Annotated[
        float, typer.Option(help="Preferred distance to the object in plans [m].")
    ] = 0.004,
    checkpoint: Annotated[
        Path | None, typer.Option(help="Reconstruction weights.", show_default="bundled")
    ] = None,
    grasp_checkpoint: Annotated[
        Path | None, typer.Option(help="Success weights.", show_default="bundled")
    ] = None,
    robot: common.Robot = None,
    sensor: common.Sensor = "structured-light",
    clutter: Annotated[
        int,
        typer.Option(
            help="Number of other objects of the folder around the target; a trial in which one "
            "falls over or moves more than 2 cm fails."
        ),
    ] = 0,
    shake: Annotated[
        float, typer.Option(help="Shake the lifted object with this acceleration [m/s²].")
    ] = 0.0,
    hold: Annotated[
        float, typer.Option(help="Time that the lifted object must be held [s]; 0 for none.")
    ] = 5.0,
    push: Annotated[
        float,
        typer.Option(
            help="Then push its centre of mass with this force [N] for 1 s along each of "
            "±x, ±y and ±z; 0 for none."
        ),
    ] = 2.5,
    pattern: Annotated[
        str, typer.Option(help="Only meshes whose names match this pattern, such as '*.ply'.")
    ] = "*",
    record: Annotated[int, typer.Option(help="Write this many trials as GIF films.")] = 0,
    pictures: Annotated[int, typer.Option(help="Number of failures to draw in the report.")] = 40,
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
    common.check_seed(seed)
    counts = {"--rehearse": rehearse, "--record": record, "--pictures": pictures}
    for name, value in (counts | {"--clutter": clutter}).items():
        if value < 0:
            raise InputError(f"{value}", where=name, allowed="0 or more")
    from pointsdf_cli.io.present import require_present
    from pointsdf_cli.robot.description import load_robot

    require_present(meshes, checkpoints=[checkpoint, grasp_checkpoint])
    load_robot(robot)  # before seconds of imports
    jobs = common.job_count(jobs)
    reporter = common.Reporter(quiet, as_json)

    from pointsdf_cli.io.apart import require_apart
    from pointsdf_cli.io.atomic import require_folder, write_text_atomic
    from pointsdf_cli.io.batch import run_stage, shard_of
    from pointsdf_cli.io.trials import write_trials
    from pointsdf_cli.planning.grasp_planner import PlanOptions
    from pointsdf_cli.planning.grasp_problem import Clearances
    from pointsdf_cli.planning.planner import PlannerConfig
    from pointsdf_cli.simulation.executor import ExecutorConfig
    from pointsdf_cli.simulation.world import try_robot
    from pointsdf_cli.trials.planner_variants import VariantOptions, check_variant
    from pointsdf_cli.trials.protocol import choose_objects, clutter_pool, make_trials
    from pointsdf_cli.trials.report import html_report, markdown_report, percent
    from pointsdf_cli.trials.run import (
        TrialConfig,
        TrialTask,
        read_rows,
        require_same_options,
        run_trial_task,
    )
    from pointsdf_cli.trials.summary import summarise

    try_robot(load_robot(robot))  # a wrong robot is said once and first, not by every worker
    variants = _variants(method, ablation or [])
    config = TrialConfig(
        variants=VariantOptions(
            PlanOptions(
                robot=robot,
                checkpoint=checkpoint,
                grasp_checkpoint=grasp_checkpoint,
                planner=PlannerConfig(solver, Clearances(object=clearance), margin),
            ),
            rehearse,
        ),
        execution=ExecutorConfig(shake=shake, hold=hold, push=push),
        sensor=sensor,
    )
    common.say_if_from_another(reporter, checkpoint, grasp_checkpoint)
    chosen = choose_objects(meshes, objects, pattern)
    pool = clutter_pool(meshes, pattern) if clutter else []
    asked = [c for c in cameras.split(",") if c]
    trials = make_trials(chosen, variants, yaws, asked, repeats, seed, clutter, pool)
    for variant in variants:
        check_variant(variant, config.variants)
    out = require_folder(out)
    folder = require_folder(out / "trials")
    filmed = {round(i * len(trials) / record) for i in range(record)} if record > 0 else set()
    tasks = {
        one.name: TrialTask(
            one,
            folder / f"{one.name}.h5",
            config,
            out / "films" / f"{one.name}.gif" if i in filmed else None,
            force,
        )
        for i, one in enumerate(trials)
    }
    require_apart(
        [*(task.out for task in tasks.values()), out / "trials.h5"],
        [*(one.mesh for one in chosen), checkpoint, grasp_checkpoint, robot],
    )
    started = time.monotonic()
    mine = shard_of(list(tasks.items()), shard)
    with reporter.progress("trial", len(mine)) as progress:
        report = run_stage(
            mine, run_trial_task, jobs=jobs, folders=[folder], on_done=progress.advance
        )
    refused = {tasks[name].trial.object.name: error.what for name, error in report.refused}
    for name, why in refused.items():
        reporter.say(f"skipped: {name}: {why}")
    done = {name for name, _ in mine}
    require_same_options([task for name, task in tasks.items() if name not in done])
    # A file of an earlier run is no trial of an object that is refused now.
    refused_now = {name for name, _ in report.refused}
    tried = [task for name, task in tasks.items() if name not in refused_now]
    rows = read_rows(tried)
    if not rows and shard is not None:  # other shards may have some
        reporter.result(
            {"out": out, "trials": 0, "refused": refused}, [f"{out}: no trials in shard {shard}"]
        )
        return
    if not rows:
        raise InputError(
            "no trial could be run: " + "; ".join(f"{k}: {v}" for k, v in refused.items()),
            where=meshes,
        )
    write_trials(out / "trials.h5", rows, seed=seed, config=config.as_dict())
    title = f"rgrasp trials: {out.resolve().name}"
    strips = _failures(tried, pictures)
    write_text_atomic(out / "report.html", html_report(rows, strips, title, refused))
    write_text_atomic(out / "report.md", markdown_report(rows, title) + "\n")
    summaries = summarise(rows)
    reporter.result(
        {
            "out": out,
            "trials": len(rows),
            "refused": refused,
            "lifted": {s.name: s.lifted.value for s in summaries},
            "held": {s.name: s.held.value for s in summaries},
            "unshaken": {s.name: s.unshaken.value for s in summaries if s.unshaken.trials},
            "no_plan": {s.name: s.no_plan.value for s in summaries},
            "contact": {s.name: s.contact.value for s in summaries},
            "report": out / "report.html",
            "seconds": round(time.monotonic() - started, 3),
        },
        [
            f"{s.name}: lifted {percent(s.lifted)}, held {percent(s.held)}, "
            f"unshaken {percent(s.unshaken)}, no plan {percent(s.no_plan)}"
            for s in summaries
        ]
        + [f"{out / 'report.html'}"],
    )


def _variants(method: str, ablations: list[str]) -> list[PlannerVariant]:
    from pointsdf_cli.trials.protocol import ABLATIONS, METHODS, RECONSTRUCTION, PlannerVariant

    if method not in ("both", *METHODS):
        raise InputError(
            f"no method {method!r}", where="--method", allowed="both, " + ", ".join(METHODS)
        )
    variants = [PlannerVariant(one) for one in METHODS if method in ("both", one)]
    wanted = [one for name in ablations for one in (ABLATIONS if name == "all" else (name,))]
    return variants + [PlannerVariant(RECONSTRUCTION, one) for one in wanted]


def _failures(tasks: list[TrialTask], most: int) -> list[tuple[str, bytes]]:
    """Captions and pictures of trials that failed, those of the whole method first."""
    from pointsdf_cli.io.trials import read_trial
    from pointsdf_cli.robot.description import load_robot
    from pointsdf_cli.trials.pictures import caption, trial_strip
    from pointsdf_cli.trials.scenes import object_mesh
    from pointsdf_cli.viz.grasp_report import png_bytes
    from pointsdf_cli.viz.robot_picture import RobotMeshes

    failed = []
    for task in tasks:
        if task.out.is_file():
            row, evidence = read_trial(task.out)
            if not row.succeeded or row.unshaken == 0:
                failed.append((_importance(row), task, row, evidence))
    failed.sort(key=lambda one: one[0])
    robot = None
    strips = []
    for _, task, row, evidence in failed[:most]:
        robot = robot or RobotMeshes(load_robot(task.config.variants.plan.robot), sections=20)
        mesh, *others = (object_mesh(o) for o in (task.trial.object, *task.trial.others))
        strip = trial_strip(robot, mesh, evidence, others)
        strips.append((caption(row), png_bytes(strip)))
    return strips


def _importance(row: TrialRow) -> tuple[bool, bool, bool, str]:
    return bool(row.ablation), row.method != "reconstruction", row.held, row.object
