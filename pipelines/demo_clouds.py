"""The bundled demo clouds: one view each of a few generated objects, and one of a whole table.

    python pipelines/demo_clouds.py assets/clouds

`spray_bottle.ply`, `mug.ply` and `power_drill.ply` hold the object alone, from 0.9 m away; their
headers say where the camera stood, so that the object stands on the table 0.6 m ahead of the robot.
`table.ply` is what a Kinect 2 across the table sees: three objects, the table and the robot, the
table thinned. The objects are free of any licence but this project's, and were not among those
trained on (another seed).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from pointsdf_cli.camera.noise import DepthNoise
from pointsdf_cli.camera.pinhole import CAMERAS
from pointsdf_cli.camera.raycast import MeshCaster
from pointsdf_cli.geometry.frames import apply_transform, invert_transform, transform
from pointsdf_cli.io.clouds import Cloud, write_cloud
from pointsdf_cli.io.meshes import LoadedMesh
from pointsdf_cli.objects.generate import make_object
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.simulation.observe import Observer
from pointsdf_cli.simulation.sim_object import SimObject
from pointsdf_cli.viz.shading import look_at

SEED = 99
DISTANCE = 0.9
FAMILIES = ("spray_bottle", "mug", "power_drill")
AHEAD = 0.6
"""Position of the objects on the table, straight ahead of the robot [m]."""

SCENE_SEED = 98
SCENE = (("can", 0.56, 0.0), ("mug", 0.62, 0.28), ("drink_carton", 0.6, -0.27))
SCENE_EYE, SCENE_AIM = (1.45, 0.1, 0.75), (0.55, 0.0, 0.05)
TABLE_POINTS = 5000


def look_down(distance: float, tilt: float, turn: float) -> np.ndarray:
    """The pose of an object standing on the ground plane in a camera tilted down [rad]."""
    spin = turned(turn)[:3, :3]
    # World z up to camera y down, then the tilt about the camera's x.
    upright = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    c, s = np.cos(tilt), np.sin(tilt)
    pitch = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    return transform(pitch @ upright @ spin, [0, 0, distance])


def turned(yaw: float) -> np.ndarray:
    """The rotation about the vertical, [4, 4]."""
    c, s = np.cos(yaw), np.sin(yaw)
    return transform([[c, -s, 0], [s, c, 0], [0, 0, 1]], [0, 0, 0])


def camera_across(T_camera_object: np.ndarray, height: float) -> np.ndarray:
    """T_world_camera with the object, whose middle is its origin, standing `AHEAD` of the robot and
    the camera straight across the table."""
    eye = invert_transform(T_camera_object)[:3, 3]
    T_world_object = turned(-float(np.arctan2(eye[1], eye[0])))
    T_world_object[:3, 3] = AHEAD, 0.0, height / 2
    return T_world_object @ invert_transform(T_camera_object)


def object_clouds(folder: Path) -> None:
    camera = CAMERAS["reference"]
    for index, family in enumerate(FAMILIES):
        made = make_object(SEED, index, [family])
        vertices = made.vertices - (made.vertices.min(axis=0) + made.vertices.max(axis=0)) / 2
        rng = np.random.default_rng([SEED, index])
        pose = look_down(DISTANCE, 0.5, 0.7 + 1.1 * index)
        patch = MeshCaster(vertices, made.faces, camera).cast(pose)
        depth = DepthNoise().apply(patch.depth, rng)
        points = camera.back_project(patch.u, patch.v, depth)
        if len(points) > 4000:
            points = points[rng.permutation(len(points))[:4000]]
        T_world_camera = camera_across(pose, float(np.ptp(vertices[:, 2])))
        path = folder / f"{family}.ply"
        write_cloud(path, Cloud(points, frame="camera", T_world_camera=T_world_camera))
        print(f"{path}: {len(points)} points, {np.ptp(points, axis=0).round(3)} m")


def table_cloud(folder: Path) -> None:
    parts, faces, count = [], [], 0
    for index, (family, x, y) in enumerate(SCENE):
        made = make_object(SCENE_SEED, index, [family])
        parts.append(apply_transform(turned(1.0 + index), made.vertices) + [x, y, 0.0])
        faces.append(made.faces + count)
        count += len(made.vertices)
    mesh = LoadedMesh(
        "scene", np.concatenate(parts), np.concatenate(faces).astype(np.int32), "", "none"
    )
    item = SimObject(mesh, [], np.eye(4), 1.0, np.ones(3), [])
    rng = np.random.default_rng(SCENE_SEED)
    T_world_camera = look_at(SCENE_EYE, SCENE_AIM)
    points = Observer(load_robot()).depth_cloud(item, np.eye(4), T_world_camera, rng)
    world = apply_transform(T_world_camera, points)
    above = world[:, 2] > 0.015
    on_table = rng.permutation(np.flatnonzero(~above))[:TABLE_POINTS]
    keep = np.sort(np.concatenate([np.flatnonzero(above), on_table]))
    path = folder / "table.ply"
    write_cloud(path, Cloud(points[keep], frame="camera", T_world_camera=T_world_camera))
    print(f"{path}: {len(keep)} points")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    object_clouds(Path(sys.argv[1]))
    table_cloud(Path(sys.argv[1]))
