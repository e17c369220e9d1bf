"""Grasp planner: from a cloud of one object to a plan, by the two methods of the paper.

    planner = GraspPlanner(PlanOptions(method="reconstruction"))       # loads networks, once
    answer = planner.plan([View(points, T_world_camera)], seed=0)
    answer.plan.status, answer.plan.q, answer.candidates

As in the paper (section V-C): *reconstruction* constrains the robot by the shape that the network
completes and judges grasps by that shape (the paper by its embedding); *partial-view* constrains it
by the seen points alone, meshed at 32³, and judges by an encoder that learned from grasps only
(PointSDF-Scratch). Everything else is the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from pointsdf_cli import choices
from pointsdf_cli.camera.view import View
from pointsdf_cli.choices import require_choice
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.models.checkpoint_kinds import bundled_success
from pointsdf_cli.models.grasp_checkpoint import reconstruction_to_plan_with
from pointsdf_cli.models.grasp_score import load_grasp_model
from pointsdf_cli.models.processor import timed, timed_stage, usable_device
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.registry import load_model
from pointsdf_cli.models.shape_model import ShapeModel
from pointsdf_cli.planning.answer import NO_NOTES, Answer, PerceivedObject, PlanNotes
from pointsdf_cli.planning.cancellation import stop_if_cancelled
from pointsdf_cli.planning.environment import Environment
from pointsdf_cli.planning.grid import GridConfig
from pointsdf_cli.planning.option_checks import PARTIAL_VIEW, RECONSTRUCTION
from pointsdf_cli.planning.plan_artifact import no_plan, plan_of
from pointsdf_cli.planning.planner import Planner, PlannerConfig
from pointsdf_cli.planning.reasons import few_grasps, too_large
from pointsdf_cli.planning.screen import narrowest
from pointsdf_cli.planning.seeds import EITHER, SuccessModel
from pointsdf_cli.planning.support import unseen_support
from pointsdf_cli.planning.synthesis import SynthesisConfig
from pointsdf_cli.planning.target import (
    EmptyFieldError,
    ObjectField,
    Target,
    absent_object,
    completed,
    enclosing,
    given_object,
    grid_for,
    missed_points,
    reconstructed_object,
    seen_object,
    with_seen_points,
    with_surface,
)
from pointsdf_cli.robot.description import load_robot

LOW_OBJECT = 0.03
"""An object lower than this [m] is grasped from the top first, as the paper's heuristic does."""


@dataclass(frozen=True)
class PlanOptions:
    """Options that are fixed before any cloud is read.

    Attributes:
        method: One of `choices.Method`.
        kind: "side", "top", or "auto": the more promising; low objects from the top first.
        robot: YAML file of the robot; the bundled one if None.
        checkpoint: Reconstruction network; if None the bundled one that the success network was
            trained on.
        grasp_checkpoint: Success network; the method's bundled one if None.
        device: Device of the networks.
        planner: Solver, distances, effort and speed.
    """

    method: str = RECONSTRUCTION
    kind: str = "auto"
    robot: Path | None = None
    checkpoint: Path | None = None
    grasp_checkpoint: Path | None = None
    device: str = "cpu"
    planner: PlannerConfig = field(default_factory=PlannerConfig)

    def __post_init__(self) -> None:
        require_choice(self.method, choices.Method, "--method")
        require_choice(self.kind, choices.GraspKind, "--kind")


class GraspPlanner:
    """Loaded networks and a planner, made once and used for every cloud.

    Args:
        options: Options; the defaults if None.
        grasps: The success network to use instead of a checkpoint's.

    Attributes:
        shape: The reconstruction network; None in partial-view grasping.

    Raises:
        InputError: The robot, a checkpoint or the device cannot be used.
    """

    def __init__(
        self, options: PlanOptions | None = None, grasps: SuccessModel | None = None
    ) -> None:
        self.options = options = options or PlanOptions()
        usable_device(options.device)
        self.robot = load_robot(options.robot)
        self.planner = Planner(self.robot, options.planner)
        self.shape: ShapeModel | None = None
        if options.method == RECONSTRUCTION:
            success = options.grasp_checkpoint or bundled_success(self.robot)
            shape = options.checkpoint or reconstruction_to_plan_with(success)
            self.shape = load_model(shape, options.device)
        path = options.grasp_checkpoint
        if path is None and options.method == PARTIAL_VIEW:
            # Where none from scratch is bundled, both methods use the one on geometry, which then
            # reads each method's own field: in partial-view grasping the seen points alone.
            path = bundled_success(self.robot, "embedding")
        self._grasps = grasps or load_grasp_model(path, None, options.device, self.robot)

    def warnings(self) -> list[str]:
        """Sentences about what makes all plans doubtful."""
        return few_grasps(getattr(self._grasps, "learned_from", None))

    def see(
        self,
        views: Sequence[View],
        seed: int = 0,
        field: Field | Literal["none"] | None = None,
        table: bool = True,
    ) -> PerceivedObject:
        """Complete the object, sample its field on a grid, and prepare the score.

        Args:
            views: One or more views of the same object. Each is completed on its own; the object is
                the mean of the fields. The score is that of the first view.
            seed: Random seed of the cloud's resampling.
            field: Object constraint instead of the method's own field: the truth in trials, or
                "none" for no constraint. The score still reads the method's own field.
            table: The object rests on the table. A reconstruction that could not stand there also
                keeps the hand out of the unseen space below it (`support.py`).

        Raises:
            InputError: No view, or a field that is none.
            EmptyFieldError: The network sees nothing solid.
        """
        if isinstance(views, View) or not len(views):
            raise InputError("no list of views", where="views", allowed="[View, …], one or more")
        world = np.concatenate([view.in_world for view in views])
        grid = grid_for(narrowest(world))
        made: list[Reconstruction] = []
        timings: dict[str, float] = {}
        with timed_stage(timings, "reconstruction"):
            if self.shape is not None:
                made = [completed(self.shape, view, seed) for view in views]
                own = reconstructed_object(made, grid, world)
            else:
                own = seen_object(world, grid)
            stop_if_cancelled()
        with timed_stage(timings, "score"):
            first = views[0]
            grasps = self._grasps.on(first.points, first.T_world_camera, field=own.kept, seed=seed)
        with timed_stage(timings, "surface"):
            if field is not None:
                constraint = _given_constraint(field, world, grid)
            elif made:
                constraint = _whole_constraint(own, made, views, world, grid, table)
            else:
                constraint = own
        reconstruction = made[0] if made else None
        target = Target.of(constraint, grasps, grasps)
        return PerceivedObject(target, world, reconstruction, timings)

    def plan(
        self,
        views: Sequence[View],
        environment: Environment | None = None,
        start: Array | None = None,
        seed: int = 0,
        field: Field | Literal["none"] | None = None,
        notes: PlanNotes = NO_NOTES,
    ) -> Answer:
        """Plan configuration and motion, or find the reason why there is none.

        Args:
            views: As in `see`.
            environment: Obstacles and table; the table alone if None.
            start: [J], the robot's present configuration; its home if None.
            seed: Random seed; equal seeds give equal plans.
            field: As in `see`.
            notes: Further content of the plan.

        Raises:
            InputError: The start is not a configuration within the joint limits.
        """
        try:
            table = environment is None or environment.table
            perceived = self.see(views, seed, field, table)
        except EmptyFieldError as error:
            return self.nothing(error.what, notes)
        return self.plan_seen(perceived, environment, start, seed, notes=notes)

    def plan_seen(
        self,
        perceived: PerceivedObject,
        environment: Environment | None = None,
        start: Array | None = None,
        seed: int = 0,
        notes: PlanNotes = NO_NOTES,
    ) -> Answer:
        """Plan as `plan` does, for a perceived object.

        Args:
            perceived: Result of `see`.
            environment: As in `plan`.
            start: As in `plan`.
            seed: As in `plan`.
            notes: As in `plan`.
        """
        points = perceived.points
        settings = self.search_settings(points)
        outcome = self.planner.search(perceived.target, environment, start, seed, settings)
        found = outcome.found
        if found.reason not in ("", "inverse_kinematics", "motion") and self.is_too_large(points):
            reason, sentence = too_large(narrowest(points), self.planner.geometry.hand.span)
            found = replace(found, reason=reason, sentence=sentence)
        timings = {**perceived.timings, **outcome.timings}
        timings["configuration"] += sum(perceived.timings.values())
        timings |= notes.timings
        drawn, warnings = None, list(notes.warnings)
        if notes.surface:
            drawn, seconds = timed(perceived.surface)
            timings["surface"] += seconds
            warnings += missed_points(drawn, points)
        outcome = replace(outcome, found=found, timings=timings)
        plan = plan_of(outcome, warnings, drawn)
        return Answer(plan, perceived.target, perceived.reconstruction)

    def is_too_large(self, points: Array) -> bool:
        """Whether an object seen at points [N, 3] is wider than the open hand everywhere."""
        return narrowest(points) > self.planner.geometry.hand.span

    def search_settings(self, points: Array) -> SynthesisConfig:
        """Search settings for an object seen at points [N, 3] of the world."""
        search = replace(self.options.planner.synthesis, kinds=self.kinds(points))
        if not self.is_too_large(points):
            return search
        # It may have a rim or a handle, but a long search seldom finds it, and a grasp that
        # touches nothing only stands beside the object.
        strict = replace(search.acceptance, floor=search.acceptance.least)
        return replace(search, rounds=min(search.rounds, 2), acceptance=strict)

    def kinds(self, points: Array) -> tuple[str, ...]:
        """Kinds of grasp to try, one a round, for an object seen at points [N, 3] of the world."""
        if self.options.kind != "auto":
            return (self.options.kind,)
        if np.percentile(points[:, 2], 99) < LOW_OBJECT:
            return ("top", EITHER)
        return (EITHER,)

    def nothing(self, what: str, notes: PlanNotes = NO_NOTES) -> Answer:
        """Answer for a cloud that shows no object."""
        sentence = f"{what[0].upper()}{what[1:]}."
        plan = no_plan(self.robot, "no_object", sentence, notes.warnings, notes.timings)
        return Answer(plan, None, None)


def _given_constraint(field: Field | str, world: Array, grid: GridConfig) -> ObjectField:
    """Object constraint by a field instead of the method's own, around points [N, 3], world.

    Raises:
        InputError: A name other than "none".
    """
    if field == "none":
        return absent_object(world)
    if isinstance(field, str):
        allowed = 'a field, "none" for no constraint, or None for the method\'s own field'
        raise InputError(f"no field {field!r}", where="field", allowed=allowed)
    return given_object(field, world, grid)


def _whole_constraint(
    own: ObjectField,
    made: Sequence[Reconstruction],
    views: Sequence[View],
    world: Array,
    grid: GridConfig,
    table: bool,
) -> ObjectField:
    """Object constraint by the reconstructions and by what their field misses: the seen points
    [N, 3], and the hidden space under an object that could not stand. The score does not read
    these, since it was trained on the network's field."""
    hidden = unseen_support(own, views) if table else np.zeros((0, 3))
    known = np.concatenate([world, hidden])
    whole = enclosing(own, made, hidden, grid) if len(hidden) else own
    return with_surface(with_seen_points(whole, known), made, known)
