"""`rgrasp collect-grasps`: meshes to labelled grasps, by simulation."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pointsdf_cli.choices import Preshapes, first_given
from pointsdf_cli.cli import common
from pointsdf_cli.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from pointsdf_cli.io.grasps import Grasps, GraspsMeta
    from pointsdf_cli.robot.description import RobotDescription
    from pointsdf_cli.simulation.collect import CollectTask


def collect_grasps(
    meshes: Annotated[Path, typer.Option(help="Folder of meshes, or one mesh.")],
    out: Annotated[Path, typer.Option(help="Output folder: one HDF5 of grasps per mesh.")] = Path(
        "grasps"
    ),
    count: Annotated[
        int,
        typer.Option(
            min=1, help="Total number of executed grasps; a fifth are of held-out objects."
        ),
    ] = 9111,
    robot: common.Robot = None,
    sensor: common.Sensor = "structured-light",
    preshapes: Annotated[
        Preshapes,
        typer.Option(
            help="The paper's heuristic, or the planner's own solutions (--checkpoint, "
            "--grasp-checkpoint), whose outcomes teach the success network where it misleads."
        ),
    ] = "heuristic",
    checkpoint: common.Checkpoint = None,
    grasp_checkpoint: common.GraspCheckpoint = None,
    shake: common.Shake = 0.0,
    push: Annotated[
        float,
        typer.Option(
            min=0,
            max=1000,
            help="Push the held object's centre of mass with this force [N] for 1 s along each of "
            "±x, ±y and ±z, and record whether it stays held; 0 for none.",
        ),
    ] = 0.0,
    record: Annotated[
        int, typer.Option(min=0, help="Write this many attempts as GIF films beside the report.")
    ] = 0,
    pictures: Annotated[
        bool, typer.Option(help="Draw six successes and six failures in report.html.")
    ] = True,
    unit: common.Unit = "m",
    pattern: common.Pattern = "*",
    seed: common.Seed = 0,
    jobs: common.Jobs = 0,
    shard: common.Shard = None,
    force: common.Force = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Collect labelled multi-fingered grasps of meshes in simulation.

    Meshes that cannot be simulated or grasped are skipped with their reason.

    Example: rgrasp collect-grasps --meshes train/ --out grasps/ --count 9111
    """
    from pointsdf_cli.io.atomic import require_folder, write_text_atomic
    from pointsdf_cli.io.batch import shard_of
    from pointsdf_cli.io.meshes import find_meshes
    from pointsdf_cli.models.checkpoint_kinds import require_reconstructions, require_successes
    from pointsdf_cli.robot.description import load_robot

    machine, found = load_robot(robot), find_meshes(meshes, pattern)
    networks = {"--checkpoint": checkpoint, "--grasp-checkpoint": grasp_checkpoint}
    if preshapes == "heuristic" and (option := first_given(networks)):
        hint = "add --preshapes planned, or leave it out"
        raise InputError("the heuristic uses no network", where=option, hint=hint)
    require_reconstructions([checkpoint])
    require_successes([grasp_checkpoint], machine)

    # Seconds of imports: only for what can be used.
    from pointsdf_cli.simulation.attempt import AttemptConfig
    from pointsdf_cli.simulation.collect import make_tasks, require_same_options
    from pointsdf_cli.simulation.observe import CameraPlacement
    from pointsdf_cli.simulation.world import try_robot
    from pointsdf_cli.viz.grasp_report import grasp_report

    config = AttemptConfig(placement=CameraPlacement(sensor=sensor))
    config = replace(config, execution=replace(config.execution, shake=shake, push=push))
    try_robot(machine)  # report a wrong robot once, here, instead of from every worker
    out = require_folder(out)
    source = None
    if preshapes == "planned":
        from pointsdf_cli.planning.grasp_planner import PlanOptions
        from pointsdf_cli.planning.planned_preshapes import PlannedPreshapes

        options = PlanOptions(robot=robot, checkpoint=checkpoint, grasp_checkpoint=grasp_checkpoint)
        source = PlannedPreshapes(options)
        source.as_dict()  # report a wrong checkpoint once, here, instead of from every worker
    every = make_tasks(found, meshes, out, count, config, seed, robot, force, source, unit)
    mine = set(shard_of(sorted(every), shard))
    tasks = {name: task for name, task in every.items() if name in mine}
    reporter = common.Reporter(quiet, as_json)
    started = time.monotonic()
    # Otherwise another run's grasps of objects that this count does not reach would count, too.
    require_same_options(task for task in tasks.values() if not task.quota)
    items, refused, missing = _collect(tasks, every, jobs, reporter, whole=shard is None)
    if refused and not items and shard is None:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in sorted(refused.items())[:5])
        raise InputError(f"no mesh could be used: {reasons}", where=meshes)
    shown, page = _with_other_shards(items, tasks, every), out / "report.html"
    if force:  # they may show grasps that are gone
        for stale in out.glob("film-[0-9][0-9]*.gif"):
            stale.unlink()
    strips = _films(shown, every, machine, out, record, pictures)
    title = f"rgrasp grasps: {out.name}"
    write_text_atomic(page, grasp_report(shown, sorted(refused.items()), strips, title))
    values = {"out": out, "objects": len(items), "refused": refused, "missing": missing}
    values |= _counts(items, push > 0)
    seconds = round(time.monotonic() - started, 3)
    reporter.result({**values, "report": page, "seconds": seconds}, [_line(values), f"{page}"])
    if any(missing.values()):
        reporter.warn(_shortfall(missing, refused, shard is None))


def _counts(items: list[tuple[str, Grasps, GraspsMeta]], pushed: bool) -> dict[str, int]:
    every = [grasps for _, grasps, _ in items]
    counts = {
        "attempts": sum(len(grasps) for grasps in every),
        "executed": sum(int(grasps.executed.sum()) for grasps in every),
        "held": sum(int((grasps.label == 1).sum()) for grasps in every),
    }
    if pushed:
        counts["unshaken"] = sum(int((grasps.unshaken == 1).sum()) for grasps in every)
    return counts


def _line(made: dict[str, Any]) -> str:
    from pointsdf_cli.viz.grasp_report import share

    executed = made["executed"]
    unshaken = f", {share(made['unshaken'], executed)} unshaken" if "unshaken" in made else ""
    return (
        f"{made['out']}: {executed} executed grasps of {made['objects']} objects, "
        f"{share(made['held'], executed)} held{unshaken}; "
        f"{made['attempts']} attempts; {len(made['refused'])} meshes skipped"
    )


def _shortfall(missing: dict[str, int], refused: dict[str, str], whole: bool) -> str:
    """A sentence on the executed grasps that splits lack, with a reason and a remedy."""
    splits = " and ".join(f"{n} for {split}" for split, n in missing.items() if n)
    skipped = ""
    if refused:
        name, reason = min(refused.items())
        skipped = f" ({len(refused)} meshes skipped, such as {name}: {reason})"
    remedy = "add meshes that the hand can grasp" if whole else "run once more without --shard"
    return f"--count is not met: executed grasps are missing, {splits}{skipped}; {remedy}"


def _with_other_shards(
    items: list[tuple[str, Grasps, GraspsMeta]],
    tasks: dict[str, CollectTask],
    every: dict[str, CollectTask],
) -> list[tuple[str, Grasps, GraspsMeta]]:
    """The grasps of this shard, and those that the other shards have made until now."""
    from pointsdf_cli.simulation.collect import is_of_run

    found = {name: (name, grasps, meta) for name, grasps, meta in items}
    others = [n for n, task in every.items() if n not in tasks and is_of_run(task)]
    found |= {name: (name, *_read(every[name])) for name in others}
    return [found[name] for name in every if name in found]


def _read(task: CollectTask) -> tuple[Grasps, GraspsMeta]:
    """Stored attempts without what was seen: no report needs it, and it would fill the memory."""
    from pointsdf_cli.io.grasps import read_grasps

    grasps, meta = read_grasps(task.out)
    return replace(grasps, cloud=grasps.cloud[:, :0].copy(), evidence=()), meta


def _collect(
    tasks: dict[str, CollectTask],
    every: dict[str, CollectTask],
    jobs: int,
    reporter: common.Reporter,
    whole: bool,
) -> tuple[list[tuple[str, Grasps, GraspsMeta]], dict[str, str], dict[str, int]]:
    """Run rounds until every quota is met or exhausted; returns the grasps of each object, the
    reasons of refused files, and the number of executed grasps that each split lacks.

    `tasks`, a shard of `every`, receive their final quotas. Without `whole` only the first round
    runs: later rounds redistribute quotas, which takes the results of all objects.
    """
    from pointsdf_cli.simulation.collect import collect_object, missing_of, next_quotas, wanted_of

    splits = {name: task.split for name, task in every.items()}
    quotas = {name: task.quota for name, task in every.items()}
    wanted = wanted_of(splits, {name: quotas[name] for name in tasks})
    refused: dict[str, str] = {}
    while True:
        rates = _Rates(reporter)
        todo = [(n, t) for n, t in tasks.items() if n not in refused and t.quota > 0]
        folders = (task.out.parent for task in tasks.values())
        report = reporter.stage("collect-grasps", todo, collect_object, jobs, folders, rates.add)
        rates.say()
        for name, error in report.refused:
            refused[name] = error.what
            reporter.say(f"skipped: {error.message}")
        there = [n for n, t in tasks.items() if n not in refused and t.out.is_file()]
        items = [(name, *_read(tasks[name])) for name in there]
        executed = {name: int(grasps.executed.sum()) for name, grasps, _ in items}
        more = next_quotas(quotas, executed, splits, wanted) if whole else None
        if more is None:
            return items, refused, missing_of(executed, splits, wanted)
        quotas = more
        for name, task in tasks.items():
            tasks[name] = replace(task, quota=quotas[name], force=False)


class _Rates:
    """Progress report every ten seconds: rates of each outcome."""

    _EVERY = 10.0

    def __init__(self, reporter: common.Reporter) -> None:
        self._reporter = reporter
        self._causes: Counter[str] = Counter()
        self._spoke = self._began = time.monotonic()

    def add(self, causes: dict[str, int] | None) -> None:
        self._causes.update(causes or {})
        if time.monotonic() - self._spoke > self._EVERY:
            self.say()

    def say(self) -> None:
        total = self._causes.total()
        if not total:
            return
        self._spoke = time.monotonic()
        shares = ", ".join(f"{cause} {n / total:.0%}" for cause, n in self._causes.items() if n)
        rate = total / (self._spoke - self._began)
        self._reporter.say(f"{total} attempts, {rate:.1f} a second: {shares}")


def _films(
    items: list[tuple[str, Grasps, GraspsMeta]],
    tasks: dict[str, CollectTask],
    robot: RobotDescription,
    out: Path,
    record: int,
    pictures: bool,
) -> list[tuple[str, np.ndarray]]:
    """Pictures for the report, and GIF films of the first `record` of the same attempts."""
    if not items or not (pictures or record):
        return []
    from pointsdf_cli.simulation.replay import film_of, pick_attempts
    from pointsdf_cli.viz.grasp_report import film_strip, write_gif
    from pointsdf_cli.viz.robot_picture import RobotMeshes

    strips = []
    meshes = RobotMeshes(robot, sections=20)
    for n, (name, row) in enumerate(pick_attempts(items, max(6, -(-record // 2)))):
        grasps = next(g for other, g, _ in items if other == name)
        film, moments = film_of(tasks[name], grasps, row)
        if pictures and n < 12:
            strips.append((film.title, film_strip(meshes, film)))
        if n < record:
            write_gif(out / f"film-{n:02d}.gif", meshes, moments, rate=20.0)
    return strips
