"""Simulated depth camera over the table: views of object, table and robot with sensor errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import trimesh
from numpy.typing import NDArray

from pointsdf_cli.camera.cleaning import clean
from pointsdf_cli.camera.noise import DepthNoise
from pointsdf_cli.camera.pinhole import CAMERAS, Camera
from pointsdf_cli.camera.raycast import MeshCaster, depth_image
from pointsdf_cli.camera.sensor_presets import load_sensor
from pointsdf_cli.camera.table_objects import nearest_object
from pointsdf_cli.camera.view import View
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import apply_transform, invert_transform, plane_in_camera
from pointsdf_cli.geometry.visibility import ViewEvidence, visibility_image
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.own_points import off_robot, robot_points
from pointsdf_cli.simulation.sim_object import SimObject
from pointsdf_cli.simulation.world import TABLE_HIGH, TABLE_LOW
from pointsdf_cli.viz.robot_picture import RobotMeshes
from pointsdf_cli.viz.shading import look_at


@dataclass(frozen=True)
class CameraPlacement:
    """Distribution of the camera's pose, sampled for every scene.

    Attributes:
        camera: Intrinsics.
        noise: Noise of the depth.
        sensor: Name of the depth sensor in `SENSORS`; only the ideal one uses `noise`.
        azimuth: Range of directions [rad] from the object to the camera, 0 away from the robot.
        elevation: Range of angles [rad] above the table.
        distance: Range of distances to the object [m].
    """

    camera: Camera = CAMERAS["kinect2"]
    noise: DepthNoise = field(default_factory=DepthNoise)
    azimuth: tuple[float, float] = (-1.0, 1.0)
    elevation: tuple[float, float] = (0.45, 0.95)
    distance: tuple[float, float] = (0.9, 1.2)
    sensor: str = "ideal"

    def __post_init__(self) -> None:
        load_sensor(self.sensor)

    def draw(self, target: Array, rng: np.random.Generator) -> Array:
        """T_world_camera [4, 4] of a camera that looks at `target` [3]."""
        azimuth, elevation = rng.uniform(*self.azimuth), rng.uniform(*self.elevation)
        level = np.cos(elevation)
        toward = np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
        return look_at(target + rng.uniform(*self.distance) * toward, target)


class Observer:
    """Renderer of scenes with one robot.

    Args:
        robot: The robot, at its home configuration.
        placement: Distribution of the camera's pose.
    """

    def __init__(self, robot: RobotDescription, placement: CameraPlacement | None = None) -> None:
        self.placement = placement or CameraPlacement()
        self._robot = [(p.vertices, p.faces) for p in RobotMeshes(robot, 16).at(robot.home)]
        self._own = robot_points(robot, robot.home)

    def depth_cloud(
        self,
        item: SimObject,
        T_world_object: Array,
        T_world_camera: Array,
        rng: np.random.Generator,
    ) -> Array:
        """Noisy cloud [N, 3] of the whole scene, camera frame, m."""
        depth = self.depth([(item, T_world_object)], T_world_camera, rng)
        v, u = np.nonzero(depth)
        return self.placement.camera.back_project(u, v, depth[v, u])

    def depth(
        self,
        standing: Sequence[tuple[SimObject, Array]],
        T_world_camera: Array,
        rng: np.random.Generator,
    ) -> Array:
        """Noisy depth image [height, width] of the scene, m along z, 0 without a return.

        Args:
            standing: Objects, each with its T_world_object [4, 4].
            T_world_camera: [4, 4].
            rng: Random generator of the sensor's errors.
        """
        parts = [
            (apply_transform(pose, item.mesh.vertices), item.mesh.faces.astype(np.int64))
            for item, pose in standing
        ]
        surfaces = [*parts, *self._robot, _table()]
        vertices, faces = zip(*surfaces, strict=True)
        vertices, faces = trimesh.util.append_faces(vertices, faces)
        camera = self.placement.camera
        patch = MeshCaster(vertices, faces, camera).cast(invert_transform(T_world_camera))
        sensor = load_sensor(self.placement.sensor).with_noise(self.placement.noise)
        depth = sensor.observe(depth_image(patch, camera), camera, rng)
        return depth.astype(np.float64)

    def object_view(
        self,
        item: SimObject,
        T_world_object: Array,
        T_world_camera: Array,
        rng: np.random.Generator,
    ) -> View:
        """View of the object segmented from the scene, cleaned, with its evidence.

        Raises:
            InputError: No object is seen: it is hidden, or too flat to tell from the table.
        """
        cloud = self.depth_cloud(item, T_world_object, T_world_camera, rng)
        world = apply_transform(T_world_camera, cloud)
        # Remove the arm's points, which outnumber those of an object below it.
        free = np.flatnonzero(off_robot(world, self._own))
        place = apply_transform(T_world_object, item.mesh.vertices).mean(axis=0)
        kept, table = nearest_object(world[free], T_world_camera[:3, 3], place)
        mine = free[kept]
        mine = mine[clean(cloud[mine]).kept]
        points, others = cloud[mine], np.delete(cloud, mine, axis=0)
        plane = None if table is None else plane_in_camera(table, T_world_camera)
        image = visibility_image(points, others, plane, 1.0 / self.placement.camera.fx)
        return View(points, T_world_camera, ViewEvidence(image, plane))


def _table() -> tuple[Array, NDArray[np.int64]]:
    """The table top as two triangles at z = 0."""
    (x0, y0), (x1, y1) = TABLE_LOW, TABLE_HIGH
    vertices = np.array([[x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]], dtype=float)
    return vertices, np.array([[0, 1, 2], [0, 2, 3]])
