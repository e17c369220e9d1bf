"""Random views of a mesh as partial clouds (paper section III-A)."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.camera.noise import REFERENCE_DEPTH, DepthNoise
from pointsdf_cli.camera.pinhole import CAMERAS, Camera
from pointsdf_cli.camera.raycast import DepthPatch, MeshCaster, depth_image, depth_window
from pointsdf_cli.camera.scene_views import SceneViewConfig, SceneViews
from pointsdf_cli.camera.sensor import DepthSensor
from pointsdf_cli.camera.sensor_presets import load_sensor, with_sensor_parameters
from pointsdf_cli.errors import InputError, as_input_error
from pointsdf_cli.geometry.cloud_sampling import systematic_sample
from pointsdf_cli.geometry.frames import random_rotation, transform
from pointsdf_cli.io.batch import task_seed
from pointsdf_cli.io.hdf5 import is_complete
from pointsdf_cli.io.meshes import LoadedMesh, load_mesh
from pointsdf_cli.io.provenance import file_sha256
from pointsdf_cli.io.views import SCHEMA, VERSION, Views, read_views_header, write_views

CLOUD_SIZE = 1000
FEWEST_PIXELS = 50
"""Least number of pixels in a view; emptier ones are drawn again."""
LARGEST_COVER = 0.95
"""Largest share of the image covered by a view; fuller ones have no silhouette and are drawn
again."""
DRAWS = 50
EDGE_MARGIN = 6
"""Sensor pixels around the mesh into which its silhouette may be displaced."""


@dataclass(frozen=True)
class ViewConfig:
    """Settings of a mesh's views.

    Attributes:
        views: Number of views per mesh.
        distance: Distance from the camera to the centre of the mesh's bounding box [m].
        camera: Intrinsics.
        noise: Noise of the depth.
        keep_depth: Store the depth images too.
        unit: Unit of the mesh file.
        above: Only views from above the horizon (z up), which see into open vessels as on a table.
        sensor: Name of the depth sensor in `SENSORS`; only the ideal one uses `noise`.
        scene: Settings for views of random table-top scenes, segmented with errors; `distance`,
            `noise`, `above` and `keep_depth` are then unused.

    Raises:
        InputError: A value is out of its range.
    """

    views: int = 200
    distance: float = 1.5
    camera: Camera = CAMERAS["reference"]
    noise: DepthNoise = field(default_factory=DepthNoise)
    keep_depth: bool = False
    unit: str = "m"
    above: bool = False
    scene: SceneViewConfig | None = None
    sensor: str = "ideal"

    def __post_init__(self) -> None:
        if not 1 <= self.views <= 100_000:
            raise InputError(f"{self.views} views", where="--views", allowed="1 to 100000")
        if not 0.1 <= self.distance <= 20:
            raise InputError(f"{self.distance} m", where="--distance", allowed="0.1 to 20 m")
        if not load_sensor(self.sensor).is_ideal and self.noise != DepthNoise():
            what = f"the sensor {self.sensor} has its own noise"
            raise InputError(what, where="--noise", allowed="only with --sensor ideal")

    @property
    def measures(self) -> DepthSensor:
        """Sensor that measures the depth."""
        return load_sensor(self.sensor).with_noise(self.noise)

    def as_dict(self) -> dict[str, Any]:
        """Settings for `config_json`."""
        return with_sensor_parameters(asdict(self))


@dataclass(frozen=True)
class ViewTask:
    """One mesh to render, for one worker process."""

    name: str
    mesh: Path
    out: Path
    config: ViewConfig
    seed: int
    force: bool = False


@dataclass(frozen=True)
class ViewSummary:
    """Summary of a rendered mesh: views kept, views drawn again, and the repair of the mesh."""

    views: int
    redrawn: int
    repair: str


def render_file(task: ViewTask) -> ViewSummary | None:
    """Render one mesh file to its views file; None if that exists already.

    Raises:
        InputError: The mesh cannot be used or is never seen, or the file cannot be written.
    """
    config = task.config.as_dict() | {"seed": task.seed, "name": task.name}
    if not task.force and is_complete(task.out, schema=SCHEMA, version=VERSION, config=config):
        if read_views_header(task.out).mesh_hash != file_sha256(task.mesh):
            raise InputError(
                f"shows another version of {task.mesh}", where=task.out, hint="add --force"
            )
        return None
    mesh = load_mesh(task.mesh, task.config.unit)
    with as_input_error(task.mesh):
        views, redrawn = render_views(mesh, task.config, task_seed(task.seed, task.name))
    write_views(task.out, replace(views, mesh_file=task.mesh.name), seed=task.seed, config=config)
    return ViewSummary(len(views.cloud), redrawn, mesh.repair)


def render_views(
    mesh: LoadedMesh, config: ViewConfig, rng: np.random.Generator
) -> tuple[Views, int]:
    """Render views of a mesh at random orientations; also returns how many were drawn again.

    Raises:
        InputError: The mesh is too small or too large for the camera at this distance.
    """
    if config.scene is not None:
        return _scene_views(mesh, config, config.scene, rng)
    caster = MeshCaster(mesh.vertices, mesh.faces, config.camera)
    centre = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    clouds = np.empty((config.views, CLOUD_SIZE, 3), dtype=np.float32)
    poses = np.empty((config.views, 4, 4))
    width, height = config.camera.width, config.camera.height
    depths = np.empty((config.views, height, width), np.float32) if config.keep_depth else None
    redrawn, sensor = 0, config.measures
    for k in range(config.views):
        for _ in range(DRAWS):
            rotation = random_rotation(rng)
            if config.above and rotation[2, 2] > 0:  # the camera looks along z, so from below
                rotation = rotation * [1.0, -1.0, -1.0]
            pose = transform(rotation, np.array([0, 0, config.distance]) - rotation @ centre)
            patch = caster.cast(pose)
            if len(patch.u) >= FEWEST_PIXELS and patch.covered <= LARGEST_COVER:
                patch = measured_patch(patch, config.camera, sensor, rng)
                if len(patch.u) >= FEWEST_PIXELS:
                    break
            redrawn += 1
        else:
            raise InputError(
                f"{DRAWS} views at {config.distance} m saw fewer than {FEWEST_PIXELS} pixels of "
                "it, or nothing else",
                hint="check its size and unit, or choose another --distance or --camera",
            )
        clouds[k] = sample_cloud(patch, config.camera, rng)
        poses[k] = pose
        if depths is not None:
            depths[k] = depth_image(patch, config.camera)
    views = Views(
        cloud=clouds,
        T_camera_object=poses,
        K=config.camera.K,
        image_size=(width, height),
        noise=sensor.deviation(REFERENCE_DEPTH),
        mesh_file=mesh.name,
        mesh_hash=mesh.sha256,
        mesh_repair=mesh.repair,
        depth=depths,
    )
    return views, redrawn


def _scene_views(
    mesh: LoadedMesh, config: ViewConfig, scene: SceneViewConfig, rng: np.random.Generator
) -> tuple[Views, int]:
    drawer = SceneViews(mesh, config.camera, scene)
    drawn = [drawer.draw(rng) for _ in range(config.views)]
    seen = [view.points for view, _ in drawn]
    clouds = [points[systematic_sample(points[:, :2], CLOUD_SIZE, rng)] for points in seen]
    views = Views(
        cloud=np.stack(clouds).astype(np.float32),
        T_camera_object=np.stack([view.T_camera_object for view, _ in drawn]),
        K=config.camera.K,
        image_size=(config.camera.width, config.camera.height),
        noise=float(np.mean([load_sensor(s).deviation(REFERENCE_DEPTH) for s in scene.sensors])),
        mesh_file=mesh.name,
        mesh_hash=mesh.sha256,
        mesh_repair=mesh.repair,
        evidence=tuple(view.evidence for view, _ in drawn),
    )
    return views, sum(rejected for _, rejected in drawn)


def measured_patch(
    patch: DepthPatch, camera: Camera, sensor: DepthSensor, rng: np.random.Generator
) -> DepthPatch:
    """A sensor's measurement of a patch; pixels that return nothing are left out."""
    if sensor.is_ideal:
        return replace(patch, depth=sensor.noise.apply(patch.depth, rng))
    window, (left, top) = depth_window(patch, math.ceil(EDGE_MARGIN * camera.fx / sensor.focal))
    depth = sensor.observe(window, camera, rng, (left, top))
    # Drop edges that are displaced beyond the image.
    depth = depth[max(0, -top) : camera.height - top, max(0, -left) : camera.width - left]
    v, u = np.nonzero(depth)
    return DepthPatch(
        u + max(0, left), v + max(0, top), depth[v, u], len(u) / (camera.width * camera.height)
    )


def sample_cloud(
    patch: DepthPatch, camera: Camera, rng: np.random.Generator, count: int = CLOUD_SIZE
) -> NDArray[np.float64]:
    """`count` points [count, 3] of a patch, camera frame, m; each pixel once before any twice."""
    total = len(patch.u)
    if total < 4 * count:
        chosen = rng.permutation(total)[:count]
    else:
        chosen = rng.choice(total, count, replace=False, shuffle=False)
    if total < count:
        chosen = np.concatenate([chosen, rng.integers(total, size=count - total)])
    return camera.back_project(patch.u[chosen], patch.v[chosen], patch.depth[chosen])
