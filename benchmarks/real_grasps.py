"""Grasps planned from real depth images, executed in simulation on the registered scans.

    python benchmarks/real_grasps.py CAPTURES MESHES [--checkpoint DIR] [--grasp-checkpoint DIR]
        [--robot FILE] [--yaws 3] [--seed 0]

CAPTURES and MESHES as for real_depth.py. Every object whose pose is known and that stands by itself
is planned for from the depth image, with its mask where there is a label image. The table is z = 0
and the object 0.6 m ahead of the robot, turned about the vertical by each yaw. The motion and the
grasp are then executed on the scan at its true pose, moved up or down onto the table; other objects
are obstacles of the plan and are left out of the simulation. Prints all verdicts and their sums.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from registered import registered_objects

from pointsdf_cli.camera.scene_file import SceneFileOptions, read_view
from pointsdf_cli.errors import RgraspError, leave_with_message
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import apply_transform, rotation_vector, transform
from pointsdf_cli.io.clouds import Cloud
from pointsdf_cli.io.meshes import LoadedMesh
from pointsdf_cli.io.plans import OK
from pointsdf_cli.planning.grasp_planner import GraspPlanner, PlanOptions
from pointsdf_cli.planning.plan_on_table import plan_on_table
from pointsdf_cli.planning.scene_input import stand_on_table
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.simulation.executor import ExecutorConfig
from pointsdf_cli.simulation.sim_object import prepare_object
from pointsdf_cli.simulation.world import World
from pointsdf_cli.trials.execution import execute_plan

PLACE = (0.6, 0.0)
"""Place of the object in the world, x and y [m]."""
FALLS = 0.1
"""Tilt [rad] within a second from which an object leaned on others."""


class Case(NamedTuple):
    """One object of a capture.

    Attributes:
        name: Capture and object.
        cloud: The depth image's cloud, posed over its table.
        mesh: The scan.
        T_world_mesh: [4, 4].
    """

    name: str
    cloud: Cloud
    mesh: LoadedMesh
    T_world_mesh: Array


def cases(captures: Path, meshes: Path) -> Iterator[Case]:
    """Every object of the captures whose pose is known."""
    for one in registered_objects(captures, meshes):
        mask = None if one.label is None else f"{one.folder / 'label.png'}:{one.label}"
        options = SceneFileOptions(str(one.folder / "K.json"), 1e-4, mask=mask)
        view = read_view(one.folder / "depth.png", options)
        cloud, _ = stand_on_table(view, one.folder.name, PLACE)
        yield Case(one.name, cloud, one.mesh, cloud.T_world_camera @ one.T_camera_mesh)


def turned(case: Case, yaw: float) -> Case:
    """The scene turned by `yaw` [rad] about the vertical through PLACE."""
    c, s = np.cos(yaw), np.sin(yaw)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    place = np.array([*PLACE, 0.0])
    T = transform(rotation, place - rotation @ place)
    # A pose that is said to be known: the robot stands where the world's origin is.
    cloud = replace(case.cloud, T_world_camera=T @ case.cloud.T_world_camera, over_table=False)
    return case._replace(cloud=cloud, T_world_mesh=T @ case.T_world_mesh)


def on_table(case: Case) -> tuple[Case, float]:
    """The scan moved vertically onto the table, and how high it was [m]."""
    lowest = float(apply_transform(case.T_world_mesh, case.mesh.vertices)[:, 2].min())
    pose = case.T_world_mesh.copy()
    pose[2, 3] -= lowest
    return case._replace(T_world_mesh=pose), lowest


def tilt_alone(case: Case, world: World) -> float:
    """Rotation [rad] of the scan in a second by itself."""
    world.reset(prepare_object(case.mesh), case.T_world_mesh, robot="none")
    world.step(round(1.0 / world.physics.step))
    turn = world.object.pose()[:3, :3] @ case.T_world_mesh[:3, :3].T
    return float(np.linalg.norm(rotation_vector(turn)))


def verdict(case: Case, planner: GraspPlanner, world: World, seed: int) -> tuple[str, list[bool]]:
    """Plan and execute: a word for the table, and (planned, lifted, held, unshaken, untouched)."""
    try:
        plan = plan_on_table(planner, [case.cloud], [case.name], seed=seed).answer.plan
    except RgraspError as error:
        return f"refused: {error.message}", [False] * 5
    if plan.status != OK:
        return f"no plan: {plan.reason}", [False] * 5
    item = prepare_object(case.mesh)
    config = ExecutorConfig(hold=5.0, push=2.5)
    done = execute_plan(
        world, item, case.T_world_mesh, plan.trajectory, plan.times, plan.lift, config
    )
    if done.outcome is None:
        return "no lift", [True, False, False, False, not done.contact]
    outcome = done.outcome
    flags = [True, outcome.lifted, outcome.held, outcome.unshaken == 1, not done.contact]
    return outcome.lost_in or "unshaken", flags


@leave_with_message()
def main() -> None:
    """Print the verdicts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("captures", type=Path)
    parser.add_argument("meshes", type=Path)
    parser.add_argument("--checkpoint", type=Path)
    parser.add_argument("--grasp-checkpoint", type=Path)
    parser.add_argument("--robot", type=Path)
    parser.add_argument("--yaws", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    options = PlanOptions(
        robot=given.robot, checkpoint=given.checkpoint, grasp_checkpoint=given.grasp_checkpoint
    )
    planner = GraspPlanner(options)
    sums = []
    with World(load_robot(given.robot)) as world:
        for given_case in cases(given.captures, given.meshes):
            case, lowest = on_table(given_case)
            if (tilt := tilt_alone(case, world)) > FALLS:
                print(f"{case.name:40s} leans on others (falls by {tilt:.1f} rad): left out")
                continue
            print(f"{case.name:40s} was {1e3 * lowest:+.0f} mm above the table")
            for k in range(given.yaws):
                began = time.process_time()
                said, flags = verdict(
                    turned(case, 2 * np.pi * k / given.yaws), planner, world, given.seed
                )
                sums.append(flags)
                touched = ", touched early" if flags[0] and not flags[4] else ""
                spent = time.process_time() - began
                print(f"{case.name:40s} yaw {k}: {said}{touched} ({spent:.0f} s)", flush=True)
    planned, lifted, held, unshaken, untouched = np.sum(sums, axis=0)
    print(
        f"{len(sums)} scenes: planned {planned}, lifted {lifted}, held {held}, "
        f"unshaken {unshaken}, touched early {planned - untouched}"
    )


if __name__ == "__main__":
    main()
