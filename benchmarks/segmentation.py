"""Right object found on a table by cameras that err?

    python benchmarks/segmentation.py MESHES [--objects all] [--seed 21]

Scenes of `rgrasp trial`: one object on the table, a high and a low camera, each sensor. It is
found if nine tenths of the points of number 1 of `rgrasp segment` lie within 12 mm of its surface,
and they cover seven tenths of its points that were measured. Prints, for each sensor and camera, in
how many scenes that holds, and the mean number of objects that are listed: 1 is right.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from pointsdf_cli.camera.depth_cloud import cloud_of_depth
from pointsdf_cli.errors import leave_with_message
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.planning.labelled_view import WORKSPACE, LabelledView, label_view
from pointsdf_cli.planning.object_choice import reach_of
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.own_points import off_robot, robot_points
from pointsdf_cli.simulation.observe import CameraPlacement, Observer
from pointsdf_cli.simulation.physics import PhysicsConfig
from pointsdf_cli.simulation.world import World
from pointsdf_cli.trials.protocol import (
    CAMERAS,
    RECONSTRUCTION,
    PlannerVariant,
    choose_objects,
    make_trials,
)
from pointsdf_cli.trials.scenes import load_object, place_camera, place_object

SENSORS = ("structured-light", "stereo")
NEAR, COVERED = 0.012, 0.006
"""Distances [m] up to which a point is the object's, and is covered by another."""


def is_found(view: LabelledView, surface: Array) -> bool:
    """Whether number 1 is the object whose surface points [S, 3] are given, world, m."""
    if not view.listed:
        return False
    found = view.world[view.objects.label == view.listed[0].label]
    tree = cKDTree(surface)
    seen = view.world[(tree.query(view.world)[0] < 0.01) & (view.world[:, 2] > NEAR)]
    if not len(seen):
        return False
    pure = float((tree.query(found)[0] < NEAR).mean())
    covered = float((cKDTree(found).query(seen)[0] < COVERED).mean())
    return pure > 0.9 and covered > 0.7


@leave_with_message()
def main() -> None:
    """Print one line for each sensor and camera."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("meshes", type=Path)
    parser.add_argument("--objects", default="all")
    parser.add_argument("--seed", type=int, default=21)
    options = parser.parse_args()
    robot = load_robot()
    own, reach = robot_points(robot, robot.home), reach_of(robot)
    world = World(robot, PhysicsConfig())
    observers = {name: Observer(robot, CameraPlacement(sensor=name)) for name in SENSORS}
    right: dict[tuple[str, str], list[bool]] = {}
    listed: dict[tuple[str, str], list[int]] = {}
    objects = choose_objects(options.meshes, options.objects)
    variants = [PlannerVariant(RECONSTRUCTION)]
    for trial in make_trials(objects, variants, 1, list(CAMERAS), seed=options.seed):
        item, pose, _ = place_object(world, load_object(trial.object), trial)
        T_world_camera = place_camera(item, pose, trial)
        solid = trimesh.Trimesh(apply_transform(pose, item.mesh.vertices), item.mesh.faces)
        surface, _ = trimesh.sample.sample_surface(solid, 20_000, seed=0)
        for name, observer in observers.items():
            depth = observer.depth([(item, pose)], T_world_camera, trial.rng("view"))
            cloud = cloud_of_depth(depth, observer.placement.camera, T_world_camera)
            view = label_view(cloud, name, WORKSPACE, lambda at: ~off_robot(at, own), reach)
            key = name, trial.camera
            right.setdefault(key, []).append(is_found(view, np.asarray(surface)))
            listed.setdefault(key, []).append(len(view.listed))
    for (sensor, camera), found in right.items():
        print(
            f"{sensor:17s} {camera:5s} right {sum(found)} of {len(found)}, "
            f"listed {np.mean(listed[sensor, camera]):.2f}"
        )


if __name__ == "__main__":
    main()
