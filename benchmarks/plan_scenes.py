"""Scenes for benchmarks of planning: meshes on the table, seen by a high or a low camera."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from pointsdf_cli.camera.table_objects import nearest_object
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import apply_transform, transform
from pointsdf_cli.geometry.stable_poses import STANDING, draw_pose, stable_poses
from pointsdf_cli.io.meshes import load_mesh
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.simulation.observe import Observer
from pointsdf_cli.simulation.sim_object import SimObject
from pointsdf_cli.viz.shading import look_at

CAMERAS = {"high": 0.85, "low": 0.40}
"""Heights of the two cameras above the table [m], 0.45 m apart (the paper, section V-C)."""
AWAY = 0.85
"""Level distance from the object to the camera [m]."""
WIDEST = 0.14
"""Objects that are wider than this all round do not fit the hand (as when data is collected)."""


@dataclass(frozen=True)
class TableScene:
    """One object on the table, and what a camera found of it.

    Attributes:
        name: Name of the mesh.
        camera: "high" or "low".
        vertices, faces: The true mesh in the world.
        cloud: [N, 3], the whole scene, camera frame, m.
        kept: bool [N], the segmented object.
        T_world_camera: [4, 4].
    """

    name: str
    camera: str
    vertices: Array
    faces: NDArray[np.int64]
    cloud: Array
    kept: NDArray[np.bool_]
    T_world_camera: Array

    @property
    def points(self) -> Array:
        """The object's points, camera frame."""
        return self.cloud[self.kept]


def table_scenes(
    folder: Path, robot: RobotDescription, count: int, seed: int = 0
) -> list[TableScene]:
    """`count` scenes of meshes of `folder`, which all take part before one comes again; cameras
    take turns. Meshes that do not fit the hand, or that no camera sees, are left out."""
    rng = np.random.default_rng(seed)
    paths = sorted(folder.rglob("*.ply"))
    order = [paths[i] for i in rng.permutation(len(paths))]
    observer, scenes, failed = Observer(robot), [], 0
    while len(scenes) < count and failed < len(paths):
        path = order[(len(scenes) + failed) % len(order)]
        camera = tuple(CAMERAS)[len(scenes) % len(CAMERAS)]
        try:
            scenes.append(table_scene(path, camera, observer, rng))
        except InputError:
            failed += 1
    return scenes


def table_scene(
    path: Path, camera: str, observer: Observer, rng: np.random.Generator
) -> TableScene:
    """One mesh in a resting pose, 0.52 to 0.68 m ahead of the robot, at a random yaw.

    Raises:
        InputError: It does not fit the hand, or is not seen.
    """
    mesh = load_mesh(path)
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces)
    if min(trimesh.bounds.oriented_bounds(solid)[1]) > WIDEST:
        raise InputError("is too large for the hand", where=path)
    poses = stable_poses(mesh.vertices, np.asarray(solid.center_mass))
    which, _ = draw_pose(poses, STANDING, rng)
    yaw, place = rng.uniform(-np.pi, np.pi), rng.uniform((0.52, -0.15), (0.68, 0.15))
    c, s = np.cos(yaw), np.sin(yaw)
    pose = transform([[c, -s, 0], [s, c, 0], [0, 0, 1]], [0, 0, 0]) @ poses[which].T_table_object
    level = apply_transform(pose, mesh.vertices)[:, :2]
    pose[:2, 3] += place - (level.min(axis=0) + level.max(axis=0)) / 2
    # Across the table from the robot: the grasps that the arm reaches best are on the far side.
    turn = rng.uniform(-0.5, 0.5)
    eye = (*(place + AWAY * np.array([np.cos(turn), np.sin(turn)])), CAMERAS[camera])
    T_world_camera = look_at(eye, (*place, 0.08))
    item = SimObject(mesh, [], np.eye(4), 0.1, np.ones(3), poses)
    cloud = observer.depth_cloud(item, pose, T_world_camera, rng)
    vertices = apply_transform(pose, mesh.vertices)
    world = apply_transform(T_world_camera, cloud)
    kept, _ = nearest_object(world, T_world_camera[:3, 3], vertices.mean(axis=0))
    return TableScene(
        path.stem, camera, vertices, mesh.faces.astype(np.int64), cloud, kept, T_world_camera
    )
