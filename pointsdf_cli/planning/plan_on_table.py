"""Plan on a table: from clouds of a table top to an answer with its surroundings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pointsdf_cli import choices
from pointsdf_cli.choices import require_choice
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.io.clouds import Cloud
from pointsdf_cli.io.plans import OK
from pointsdf_cli.models.processor import one_blas_thread, run_in_parallel
from pointsdf_cli.planning.answer import Answer, PerceivedObject, PlanNotes
from pointsdf_cli.planning.cloud_checks import in_world
from pointsdf_cli.planning.environment import Environment, Obstacle
from pointsdf_cli.planning.grasp_planner import GraspPlanner, PlanOptions
from pointsdf_cli.planning.object_choice import NoObjectError, TargetChoice, reach_of
from pointsdf_cli.planning.option_checks import RECONSTRUCTION
from pointsdf_cli.planning.plan_request import Corners, PlanRequest, PlanResult
from pointsdf_cli.planning.plausibility import (
    UNEVEN,
    outside_workspace,
    require_table_at_zero,
    scene_warnings,
    table_warning,
)
from pointsdf_cli.planning.seen_obstacles import named_obstacles, obstacle_tasks
from pointsdf_cli.planning.table_top import (
    TableTop,
    label_table,
    look_at_table,
    table_height,
    workspace_of,
)
from pointsdf_cli.planning.take_order import OrderedObject, take_order
from pointsdf_cli.planning.target import EmptyFieldError
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.start import start_configuration


@dataclass(frozen=True)
class TablePlan:
    """An answer and its inputs.

    Attributes:
        answer: Answer of the planner.
        report: Sentences about the segmentation.
        warnings: Sentences about implausible input.
        start: [J], the robot's start configuration.
        points: [N, 3], observed points of the object, world, m.
        camera: [3], position of the first camera.
        obstacles: All obstacles.
        table: Whether there is a table.
    """

    answer: Answer
    report: tuple[str, ...]
    start: Array
    points: Array
    camera: Array
    obstacles: tuple[Obstacle, ...]
    warnings: tuple[str, ...] = ()
    table: bool = True

    def result(self, options: PlanOptions) -> PlanResult:
        """The result in plain data, with the planner's options."""
        plain = {k: str(v) if isinstance(v, Path) else v for k, v in asdict(options).items()}
        return PlanResult(
            plan=self.answer.plan,
            report=self.report,
            warnings=self.warnings,
            start=self.start,
            points=self.points,
            camera=self.camera,
            obstacles=self.obstacles,
            options=plain,
            least=options.planner.synthesis.acceptance.least,
            table=self.table,
        )


def answer_request(
    planner: GraspPlanner, request: PlanRequest, warn: Callable[[str], None] | None = None
) -> PlanResult:
    """Answer a checked request; see `plan_on_table`."""
    return _plan(planner, request, warn).result(planner.options)


def plan_on_table(
    planner: GraspPlanner,
    clouds: Sequence[Cloud],
    names: Sequence[str],
    environment: Environment | None = None,
    start: str | Array | None = None,
    seed: int = 0,
    segment: str = "auto",
    target: TargetChoice | Array | None = None,
    others: bool = True,
    workspace: Corners | None = None,
    cleaned: bool = True,
    warn: Callable[[str], None] | None = None,
    obstacles: str = RECONSTRUCTION,
) -> TablePlan:
    """Find the object in the clouds and plan a grasp of it.

    Args:
        planner: A loaded planner.
        clouds: Clouds, one for each camera, each with its pose.
        names: Names of the clouds, for messages.
        environment: Known obstacles and table; the table alone if None.
        start: Start configuration [rad], as typed or [J]; the robot's home if None.
        seed: Random seed; equal seeds give equal plans.
        segment: "auto", or "none" if the clouds hold the object alone.
        target: Choice of the object, or a place [3] of it in the world. With `any`, objects are
            tried in their `take_order` until a grasp is good; otherwise the best is returned.
        others: Treat other observed objects as obstacles.
        workspace: Corners [m] of the part of the world to use; the default ones if None.
        cleaned: Drop flying pixels, outliers and specks.
        warn: Called with each warning about implausible input, before planning.
        obstacles: Model of other objects: "reconstruction", or "hull" of their seen points, which
            partial-view grasping always uses.

    Raises:
        InputError: The clouds or the start cannot be used, or show a table far from z = 0.
    """
    require_choice(obstacles, choices.Obstacles, "obstacles")
    _require_lists(clouds, names)
    if not (isinstance(seed, int | np.integer) and seed >= 0):
        raise InputError(f"{seed!r} is not a seed", where="seed", allowed="0 or more")
    q = start_configuration(start, planner.robot)
    if not (target is None or isinstance(target, TargetChoice)):
        target = TargetChoice(place=target)
    request = PlanRequest(
        clouds, names, environment=environment or Environment(), start=q, seed=seed,
        segment=segment, target=target, others=others, workspace=workspace, cleaned=cleaned,
        obstacles=obstacles,
    )  # fmt: skip
    return _plan(planner, request, warn)


def _require_lists(clouds: Sequence[Cloud], names: Sequence[str]) -> None:
    """Refuse what is easily given instead of a list of clouds and one of their names.

    Raises:
        InputError: It was.
    """
    if isinstance(clouds, Cloud) or isinstance(names, str):
        allowed = "lists: [cloud], ['name']"
        raise InputError("one cloud or name", where="clouds, names", allowed=allowed)
    if not len(clouds) or len(clouds) != len(names):
        given = f"{len(clouds)} clouds and {len(names)} names"
        allowed = "a name for each cloud, one or more"
        raise InputError(given, where="clouds, names", allowed=allowed)


def _plan(
    planner: GraspPlanner, request: PlanRequest, warn: Callable[[str], None] | None
) -> TablePlan:
    """Answer a request, whose choices are the planner's own; see `plan_on_table`."""
    q = start_configuration(request.start, planner.robot)
    if request.segment == "auto" and request.environment.table:
        require_table_at_zero([in_world(cloud) for cloud in request.clouds], request.names)
    attempt = partial(_plan_for, planner, request, q)
    with one_blas_thread():
        if request.target is None or not request.target.any:
            return attempt(request.target, warn)
        enough = planner.options.planner.synthesis.acceptance.success
        return _first_good(_in_order(planner, request, q), attempt, enough, warn)


def _plan_for(
    planner: GraspPlanner,
    request: PlanRequest,
    q: Array,
    target: TargetChoice | None,
    warn: Callable[[str], None] | None = None,
) -> TablePlan:
    """Plan for one object of a request, from the start q [J]."""
    environment = request.environment
    try:
        seen = look_for(target, request, planner.robot, q)
    except NoObjectError as error:
        return _without_object(planner, request, error, q)
    report = list(seen.report)
    warnings = planner.warnings() + _warnings(seen, request)
    unmodelled = outside_workspace([view for view, _ in seen.labelled], reach_of(planner.robot))
    warnings += [unmodelled] * bool(unmodelled)
    if warn is not None:
        for sentence in warnings:
            warn(sentence)
    height = seen.table_height or 0.0
    if environment.table and height > UNEVEN:
        height = max(height, environment.table_height)
        environment = replace(environment, table_height=height)
    tasks: list[Callable[[], Any]] = [partial(_perceived, planner, seen, request)]
    beside = request.others and len(seen.others) > 0
    network = planner.shape if request.obstacles == RECONSTRUCTION else None
    if beside:
        tasks += obstacle_tasks(seen, network, request.seed, request.cleaned)
    perceived, *found = run_in_parallel(tasks)
    known = environment.obstacles
    others, seconds = named_obstacles(found, [obstacle.name for obstacle in known])
    if beside:
        how = "hulls" if network is None else "reconstructions"
        report += [f"seen obstacles: {len(others)} ({how}, {seconds:.2f} s)"] * bool(others)
        environment = replace(environment, obstacles=(*known, *others))
    notes = PlanNotes(warnings, {"obstacles": seconds}, surface=True)
    if isinstance(perceived, EmptyFieldError):
        answer = planner.nothing(perceived.what, notes)
    else:
        answer = planner.plan_seen(perceived, environment, q, request.seed, notes=notes)
    points = np.concatenate([view.in_world for view in seen.views])
    camera = seen.views[0].T_world_camera[:3, 3]
    obstacles = environment.obstacles
    table = request.environment.table
    return TablePlan(answer, tuple(report), q, points, camera, obstacles, tuple(warnings), table)


def look_for(
    target: TargetChoice | None, request: PlanRequest, robot: RobotDescription, q: Array
) -> TableTop:
    """The table top in a request's clouds, with the robot at q [J]; see `look_at_table`."""
    clouds, names, segment = request.clouds, request.names, request.segment
    workspace, cleaned = workspace_of(request.workspace), request.cleaned
    return look_at_table(clouds, names, robot, q, segment, target, workspace, cleaned)


def _perceived(
    planner: GraspPlanner, seen: TableTop, request: PlanRequest
) -> PerceivedObject | EmptyFieldError:
    try:
        return planner.see(seen.views, request.seed, table=request.environment.table)
    except EmptyFieldError as error:
        return error


def _without_object(
    planner: GraspPlanner, request: PlanRequest, error: NoObjectError, q: Array
) -> TablePlan:
    """The result for clouds that show no object."""
    world = np.concatenate([in_world(cloud) for cloud in request.clouds])
    camera = np.asarray(request.clouds[0].T_world_camera)[:3, 3]
    answer = planner.nothing(f"{error.what}; {error.hint or error.allowed}")
    said = (f"{error.where}: {error.what}",)
    around = request.environment
    return TablePlan(answer, said, q, world, camera, around.obstacles, (), around.table)


def _warnings(seen: TableTop, request: PlanRequest) -> list[str]:
    clouds, has_table = request.clouds, request.environment.table
    # A pose from the table has no height to be wrong by.
    checked = request.segment == "auto" and has_table and not clouds[0].over_table
    off = table_warning(seen.table_height, [in_world(each) for each in clouds]) if checked else ""
    height = (table_height(seen.labelled, carried=True) or 0.0) if has_table else None
    return [off] * bool(off) + scene_warnings(seen.views, height)


def _in_order(planner: GraspPlanner, request: PlanRequest, q: Array) -> list[OrderedObject]:
    """Objects in the first camera's view, the easiest to grasp first."""
    cloud, name = request.clouds[0], request.names[0]
    workspace = workspace_of(request.workspace)
    view = label_table(cloud, name, planner.robot, q, workspace, request.cleaned)
    return take_order(view, reach_of(planner.robot))


def _first_good(
    ordered: list[OrderedObject],
    attempt: Callable[..., TablePlan],
    enough: float,
    warn: Callable[[str], None] | None,
) -> TablePlan:
    """The result for the first object with a good grasp, or else of the best grasp.

    Args:
        ordered: The objects, the easiest to grasp first.
        attempt: `_plan_for` as a function of target and `warn`.
        enough: Success probability of a good grasp.
        warn: As in `plan_on_table`.
    """
    if not ordered:
        return attempt(None, warn)
    said, best = [], None
    for each in ordered:
        found = attempt(TargetChoice(number=each.item.number))
        plan = found.answer.plan
        success = plan.success_probability if plan.status == OK else -1.0
        outcome = f"success {success:.2f}" if plan.status == OK else f"no plan ({plan.reason})"
        said.append(f"{each.describe()}: {outcome}")
        if best is None or success > best[0]:
            best = success, found, each
        if success >= enough:
            break
    assert best is not None
    success, found, chosen = best
    why = "the first good grasp" if success >= enough else "the best of all"
    said.append(f"object {chosen.item.number} is taken: {why}")
    if warn is not None:
        for sentence in found.warnings:
            warn(sentence)
    return replace(found, report=(*said, *found.report))
