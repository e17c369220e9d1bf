"""Run of one trial, from the placed object to the verdict, and task of a worker process."""

from __future__ import annotations

import functools
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch

from pointsdf_cli.camera.sensor_presets import load_sensor, with_sensor_parameters
from pointsdf_cli.geometry.arrays import Array, Surface
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.io.hdf5 import is_complete
from pointsdf_cli.io.plans import OK, Plan
from pointsdf_cli.io.provenance import file_sha256
from pointsdf_cli.io.trials import (
    TRIAL_SCHEMA,
    TRIAL_VERSION,
    Evidence,
    TrialRow,
    read_trial,
    write_trial,
)
from pointsdf_cli.planning.contacts import link_poses
from pointsdf_cli.planning.environment import Environment
from pointsdf_cli.planning.fields import MeshField
from pointsdf_cli.planning.grasp_planner import PlanOptions
from pointsdf_cli.planning.object_distance import ObjectDistances
from pointsdf_cli.planning.robot_geometry import RobotGeometry
from pointsdf_cli.planning.target import surface_of
from pointsdf_cli.robot.description import load_robot, robot_digest
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.simulation.executor import ExecutorConfig
from pointsdf_cli.simulation.film import Recorder
from pointsdf_cli.simulation.observe import CameraPlacement, Observer
from pointsdf_cli.simulation.physics import PhysicsConfig
from pointsdf_cli.simulation.verdict import UNTRIED
from pointsdf_cli.simulation.world import World
from pointsdf_cli.trials.clutter import look, place_neighbours, with_others
from pointsdf_cli.trials.evidence import evidence_of
from pointsdf_cli.trials.execution import NO_LIFT, Executed, execute_plan
from pointsdf_cli.trials.pictures import write_film
from pointsdf_cli.trials.planner_variants import TrialPlanner, weights_of
from pointsdf_cli.trials.protocol import NO_CLEANING, Trial
from pointsdf_cli.trials.scenes import load_object, object_mesh, place_camera, place_object

NO_PLAN = "no_plan"
KEPT_OBJECTS = 32


@dataclass(frozen=True)
class TrialConfig:
    """Settings of all trials of an experiment.

    Attributes:
        planning, physics, execution: Settings of all planners, simulation and execution.
        sensor: Name of the depth sensor in `SENSORS`.
    """

    planning: PlanOptions = field(default_factory=PlanOptions)
    physics: PhysicsConfig = field(default_factory=PhysicsConfig)
    execution: ExecutorConfig = field(default_factory=ExecutorConfig)
    sensor: str = "ideal"

    def __post_init__(self) -> None:
        load_sensor(self.sensor)

    def as_dict(self) -> dict[str, Any]:
        """Settings for `config_json`."""
        plain: dict[str, Any] = with_sensor_parameters(asdict(self))
        options = plain["planning"]
        for name in ("robot", "checkpoint", "grasp_checkpoint"):
            options[name] = None if options[name] is None else str(options[name])
        return plain


@dataclass(frozen=True)
class TrialTask:
    """One trial for one worker process.

    Attributes:
        trial: The trial.
        out: Output file.
        config: Settings.
        film: Path of a film to write; None for none.
        force: Replace an existing file.
    """

    trial: Trial
    out: Path
    config: TrialConfig
    film: Path | None = None
    force: bool = False


class TrialRunner:
    """Runner of trials in one process; a trial's result does not depend on the others.

    Args:
        config: Settings.
    """

    def __init__(self, config: TrialConfig) -> None:
        self.config = config
        self.robot = load_robot(config.planning.robot)
        self._world = World(self.robot, config.physics)
        self._kinematics = Kinematics(self.robot)
        self._geometry = RobotGeometry(self._kinematics)
        self._observer = Observer(self.robot, CameraPlacement(sensor=config.sensor))
        self._planner = functools.cache(lambda variant: TrialPlanner(variant, config.planning))
        self._item = functools.lru_cache(maxsize=KEPT_OBJECTS)(load_object)

    def close(self) -> None:
        """Close the physics client."""
        self._world.close()

    def run(self, trial: Trial, recorder: Recorder | None = None) -> tuple[TrialRow, Evidence]:
        """Run one trial.

        Raises:
            InputError: The mesh cannot be used, or the object never rests.
        """
        item = self._item(trial.object)
        item, T_world_object, yaw = place_object(self._world, item, trial)
        others = place_neighbours(self._world, (item, T_world_object), trial, self._item)
        T_world_camera = place_camera(item, T_world_object, trial)
        rng = trial.rng("view")
        vertices = apply_transform(T_world_object, item.mesh.vertices)
        truth = vertices, item.mesh.faces
        planner = self._planner(trial.variant)
        standing = [(item, T_world_object), *others]
        cleaned = trial.variant.ablation != NO_CLEANING
        view, seen = look(self._observer, self.robot, standing, T_world_camera, rng, cleaned)
        answer, around = None, Environment()
        began = time.perf_counter(), time.process_time()
        if len(view.points):
            seed = int(trial.rng("view").integers(2**31))
            around = around if seen is None else planner.surroundings(seen, seed)
            answer = planner.plan(view, lambda: truth, seed, around)
        spent = time.perf_counter() - began[0], time.process_time() - began[1]
        plan = None if answer is None else answer.plan
        executed = None
        if plan is not None and plan.status == OK:
            executed = execute_plan(
                self._world,
                item,
                T_world_object,
                plan.trajectory,
                plan.times,
                plan.lift,
                config=self.config.execution,
                watch=recorder,
                others=others,
            )
        row = self._row(trial, yaw, plan, executed, spent, truth)
        if others:
            ends = [] if executed is None else [one.pose() for one in self._world.others]
            row = with_others(row, others, ends)
        believed = None
        if answer is not None and answer.target is not None:
            believed = surface_of(answer.target)
        poses = [pose for _, pose in standing]
        home, obstacles = self.robot.home, around.obstacles
        return row, evidence_of(view, poses, believed, plan, executed, home, obstacles)

    def penetration(self, q: Array, surface: Surface) -> float:
        """Penetration of the robot at q [J] into a closed surface in the world [m]; 0 if none."""
        distances = ObjectDistances(self._geometry, MeshField(*surface))
        found = distances(link_poses(self._kinematics, q[None]), gradients=False)
        return max(0.0, -float(found.distance.min()))

    def _row(
        self,
        trial: Trial,
        yaw: float,
        plan: Plan | None,
        executed: Executed | None,
        spent: tuple[float, float],
        truth: Surface,
    ) -> TrialRow:
        outcome = None if executed is None else executed.outcome
        cause = NO_PLAN
        if executed is not None:
            cause = NO_LIFT if outcome is None else outcome.cause
        planned = plan is not None and plan.status == OK
        pushed = self.config.execution.push > 0
        return TrialRow(
            object=trial.object.name,
            yaw_index=trial.yaw_index,
            repeat=trial.repeat,
            yaw=yaw,
            camera=trial.camera,
            method=trial.variant.method,
            ablation=trial.variant.ablation,
            status="no_plan" if plan is None else plan.status,
            reason="no_object" if plan is None else plan.reason,
            kind="" if plan is None else plan.kind,
            cause=cause,
            planning_time=spent[0],
            planning_cpu=spent[1],
            success_probability=float("nan") if plan is None else plan.success_probability,
            contact=executed is not None and bool(executed.contact),
            moved=0.0 if executed is None else executed.moved,
            penetration=self.penetration(plan.q, truth) if plan is not None and planned else 0.0,
            lifted=outcome is not None and outcome.lifted,
            held=outcome is not None and outcome.held,
            unshaken=int(outcome is not None and outcome.unshaken == 1) if pushed else UNTRIED,
            lost_in="" if outcome is None else outcome.lost_in,
            final_height=0.0 if outcome is None else outcome.lift_height,
            seed=trial.seed,
        )


def run_trial_task(task: TrialTask) -> TrialRow | None:
    """Run one trial and write its file; None if the file exists already.

    Raises:
        InputError: The object cannot be used.
        OptionsDifferError: The file was made with other options.
    """
    torch.set_num_threads(1)
    trial, config = task.trial, _options_of(task)
    if not task.force and is_complete(
        task.out, schema=TRIAL_SCHEMA, version=TRIAL_VERSION, config=config
    ):
        filmed = task.film is None or task.film.is_file()
        if filmed or read_trial(task.out)[0].cause == NO_PLAN:  # without a motion, no film
            return None
    runner = _runner(task.config)
    recorder = Recorder(rate=10.0) if task.film is not None else None
    row, evidence = runner.run(trial, recorder)
    if task.film is not None and recorder is not None and recorder.moments:
        meshes = [object_mesh(one) for one in (trial.object, *trial.others)]
        write_film(task.film, runner.robot, meshes, recorder.moments, recorder.rate)
    write_trial(task.out, row, evidence, config)
    return row


def require_same_options(tasks: list[TrialTask]) -> None:
    """Require the same options in existing files of these trials, which count too.

    Raises:
        OptionsDifferError: A file was made with other options.
    """
    for task in tasks:
        config = _options_of(task)
        is_complete(task.out, schema=TRIAL_SCHEMA, version=TRIAL_VERSION, config=config)


def _options_of(task: TrialTask) -> dict[str, Any]:
    """All settings that determine a trial's outcome."""
    trial = task.trial
    config = task.config.as_dict() | {"seed": trial.seed, "yaws": trial.yaws, "trial": trial.name}
    config["weights"] = weights_of(trial.variant, task.config.planning)
    config["mesh"] = "" if trial.object.mesh is None else file_sha256(trial.object.mesh)
    config |= {} if trial.object.unit == "m" else {"unit": trial.object.unit}
    if trial.others:
        config["others"] = {
            one.name: "" if one.mesh is None else file_sha256(one.mesh) for one in trial.others
        }
    config["planning"]["robot"] = robot_digest(task.config.planning.robot)
    return config


def read_rows(tasks: list[TrialTask]) -> list[TrialRow]:
    """Rows of all trials with a file, in the order of the tasks."""
    return [read_trial(task.out)[0] for task in tasks if task.out.is_file()]


_runner = functools.lru_cache(maxsize=1)(TrialRunner)
"""The process's runner, cached with its networks and physics client."""
