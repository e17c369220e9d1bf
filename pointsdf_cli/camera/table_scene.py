"""Random table-top scenes around one object, as exact depth: table, neighbours, background.

The object rests on a table in one of its stable poses. Simple bodies stand beside it or in front of
it; beyond the table's edge is a wall, or empty space.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.camera.raycast import DepthWindow, MeshCaster
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import (
    apply_transform,
    invert_transform,
    random_rotation,
    transform,
)
from pointsdf_cli.geometry.stable_poses import StablePose, draw_pose

NOTHING, OBJECT, TABLE, OTHER = 0, 1, 2, 3


DISTANCE = (0.4, 1.6)
"""Distance from the camera to the object's centre [m]."""
ELEVATION = (0.2, 1.3)
"""Elevation of the camera above the table [rad]."""
IN_FRONT = 0.3
"""Share of the neighbours between the object and the camera."""
GAP = 0.12
"""Largest gap between a neighbour and the object [m]."""
HIDING_HEIGHT = (0.1, 0.8)
"""Height up to which a body in front hides the object, as a share of the object's."""
TALLEST = 0.35
"""Largest height of a body in front [m]."""
TABLE_RADIUS = (0.1, 1.0)
"""Distance from the object to the table's edge [m]."""
WALL_BEHIND = (0.3, 2.5)
"""Distance of the wall behind the object [m]."""
MARGIN = 0.45
"""Margin around the object's box in the image, as a share of its longer side."""


@dataclass(frozen=True)
class SceneConfig:
    """Distribution of scenes.

    Attributes:
        resting: Share of scenes in which the object rests on a table; in the others it is turned at
            random without one.
        leaning: Share of the objects on a table that are tilted out of their stable pose, as if
            they leaned on something.
        lean: Angle of this tilt [rad].
        neighbours: Largest number of bodies around the object.
        hiding: Share of the scenes with neighbours that have one more body in front, which hides
            the object's lower part.
        wall: Share of scenes with a wall; without one, space beyond the table returns no depth.
    """

    resting: float = 0.85
    leaning: float = 0.35
    lean: tuple[float, float] = (0.1, 0.9)
    neighbours: int = 3
    hiding: float = 0.5
    wall: float = 0.6


@dataclass(frozen=True)
class RenderedScene:
    """One scene in a window of the image.

    Attributes:
        window: Exact depth and incidence of everything; depth inf for empty pixels.
        label: u1 [h, w]: NOTHING, OBJECT, TABLE or OTHER.
        object_alone: bool [h, w], pixels of the object including hidden ones.
        T_camera_object: [4, 4].
        support_plane: f8 [4] in the camera frame (normal up, offset); None if the object does not
            rest on a table.
    """

    window: DepthWindow
    label: NDArray[np.uint8]
    object_alone: NDArray[np.bool_]
    T_camera_object: Array
    support_plane: Array | None


def draw_scene(
    caster: MeshCaster,
    vertices: Array,
    poses: list[StablePose],
    camera: Camera,
    config: SceneConfig,
    rng: np.random.Generator,
) -> RenderedScene:
    """Draw a random scene around the mesh.

    Args:
        caster: Ray caster of the mesh.
        vertices: [V, 3], mesh frame, m.
        poses: Resting poses of the mesh; without any it is turned at random.
        camera: Intrinsics.
        config: Distribution of the scenes.
        rng: Random generator.
    """
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    distance = rng.uniform(*DISTANCE)
    # Off the image's centre by up to a quarter of its half width.
    aim = rng.uniform(-0.25, 0.25, 2) * [camera.width / camera.fx, camera.height / camera.fy] / 2
    place = distance * np.array([*aim, 1.0])
    if not poses or rng.random() >= config.resting:
        rotation = random_rotation(rng)
        pose = transform(rotation, place - rotation @ centre)
        return _compose(caster, pose, place, None, [], camera, config, rng)
    index, _ = draw_pose(poses, 0.6, rng)
    T_table_object = _turned(rng.uniform(0, 2 * np.pi)) @ poses[index].T_table_object
    if rng.random() < config.leaning:
        angle, direction = rng.uniform(*config.lean), rng.uniform(0, 2 * np.pi)
        T_table_object = _leaning(T_table_object, vertices, angle, direction)
    resting = apply_transform(T_table_object, vertices)
    middle = (resting.min(axis=0) + resting.max(axis=0)) / 2
    T_camera_table = _camera_from_table(rng.uniform(*ELEVATION), rng.normal(0, 0.05))
    T_camera_table[:3, 3] = place - T_camera_table[:3, :3] @ middle
    bodies = _neighbours(resting, T_camera_table, config, rng)
    pose = T_camera_table @ T_table_object
    return _compose(caster, pose, place, T_camera_table, bodies, camera, config, rng)


def _turned(yaw: float) -> Array:
    c, s = np.cos(yaw), np.sin(yaw)
    return transform([[c, -s, 0], [s, c, 0], [0, 0, 1]], [0, 0, 0])


def _leaning(T_table_object: Array, vertices: Array, angle: float, direction: float) -> Array:
    """The pose tilted by an angle [rad] about a horizontal axis with a direction [rad] from the
    table's x axis, down to where the object touches the table."""
    c, s = np.cos(angle), np.sin(angle)
    tilt = transform([[1, 0, 0], [0, c, -s], [0, s, c]], [0, 0, 0])
    tilted = _turned(direction) @ tilt @ _turned(-direction) @ T_table_object
    tilted[2, 3] -= apply_transform(tilted, vertices)[:, 2].min()
    return tilted


def _camera_from_table(elevation: float, roll: float) -> Array:
    """A camera that looks down on z = 0 at an elevation [rad], x to the right, turned by a roll."""
    c, s = np.cos(elevation), np.sin(elevation)
    # Rows: the camera's axes in the table's frame, the camera standing towards −y.
    rotation = np.array([[1, 0, 0], [0, -s, -c], [0, c, -s]])
    turn = _turned(roll)[:3, :3]
    return transform(turn @ rotation, np.zeros(3))


def _neighbours(
    resting: Array, T_camera_table: Array, config: SceneConfig, rng: np.random.Generator
) -> list[trimesh.Trimesh]:
    """Boxes, cylinders and balls around the object, table frame."""
    middle = (resting.min(axis=0) + resting.max(axis=0))[:2] / 2
    reach = float(np.linalg.norm(resting[:, :2] - middle, axis=1).max())
    eye = invert_transform(T_camera_table)[:3, 3]
    towards = float(np.arctan2(*(eye[:2] - middle)[::-1]))
    bodies = []
    for _ in range(rng.integers(config.neighbours + 1)):
        body = _simple_body(rng.uniform(0.03, 0.16, 3), rng)
        in_front = rng.random() < IN_FRONT
        azimuth = towards + rng.normal(0, 0.5) if in_front else rng.uniform(0, 2 * np.pi)
        body.apply_transform(_turned(rng.uniform(0, 2 * np.pi)))
        _stand(body, middle, reach + rng.uniform(0.003, GAP), azimuth)
        bodies.append(body)
    # Drawn last: without it a seed gives the same scenes.
    if config.neighbours and config.hiding and rng.random() < config.hiding:
        bodies.append(_hiding_body(resting, eye, middle, reach, towards, rng))
    return bodies


def _simple_body(size: Array, rng: np.random.Generator) -> trimesh.Trimesh:
    """A box, cylinder or ball of a size [3] in m."""
    kind = rng.integers(3)
    if kind == 0:
        return trimesh.creation.box(size)
    if kind == 1:
        return trimesh.creation.cylinder(size[0] / 2, size[2], sections=24)
    return trimesh.creation.icosphere(2, size[0] / 2)


def _stand(body: trimesh.Trimesh, middle: Array, clear: float, azimuth: float) -> float:
    """Put the body on the table, `clear` [m] beyond its own reach from `middle` [2]; its distance
    from there."""
    away = clear + float(np.linalg.norm(body.vertices[:, :2], axis=1).max())
    foot = middle + away * np.array([np.cos(azimuth), np.sin(azimuth)])
    body.apply_translation([*foot, -body.vertices[:, 2].min()])
    return away


def _hiding_body(
    resting: Array,
    eye: Array,
    middle: Array,
    reach: float,
    towards: float,
    rng: np.random.Generator,
) -> trimesh.Trimesh:
    """A body before the object, as tall as hides the object up to a random height.

    The line of sight from there to the camera `eye` [3] rises over the body's foot.
    """
    body = _simple_body(np.array([*rng.uniform(0.03, 0.2, 2), 0.1]), rng)
    body.apply_transform(_turned(rng.uniform(0, 2 * np.pi)))
    azimuth = towards + rng.normal(0, 0.35)
    away = _stand(body, middle, reach + rng.uniform(0.003, GAP / 2), azimuth)
    hidden_to = rng.uniform(*HIDING_HEIGHT) * float(resting[:, 2].max())
    level = float(np.linalg.norm(eye[:2] - middle))
    rises = (float(eye[2]) - hidden_to) / max(level, 1e-3)
    height = np.clip(hidden_to + away * rises, 0.02, TALLEST)
    body.apply_scale([1.0, 1.0, height / float(body.vertices[:, 2].max())])
    return body


def _compose(
    caster: MeshCaster,
    T_camera_object: Array,
    middle: Array,
    T_camera_table: Array | None,
    bodies: list[trimesh.Trimesh],
    camera: Camera,
    config: SceneConfig,
    rng: np.random.Generator,
) -> RenderedScene:
    """The nearest of everything in each pixel; `middle` [3] is the object's, camera frame, m."""
    bounds = caster.window_around(T_camera_object, MARGIN)
    alone = caster.cast_window(T_camera_object, window=bounds)
    depth, cosine = alone.depth.copy(), alone.cosine.copy()
    label = np.where(np.isfinite(depth), OBJECT, NOTHING).astype(np.uint8)
    object_alone = label == OBJECT
    columns, rows = np.arange(bounds[0], bounds[1]), np.arange(bounds[2], bounds[3])
    rays = camera.back_project(columns, rows[:, None], 1.0)
    length = _length(rays)

    plane = None
    if T_camera_table is not None:
        normal, origin = T_camera_table[:3, 2], T_camera_table[:3, 3]
        plane = np.array([*normal, normal @ origin])
        down = rays @ normal
        with np.errstate(divide="ignore"):
            table = np.where(down < -1e-6, plane[3] / down, np.inf)
        foot = middle - (normal @ middle - plane[3]) * normal
        away = _length(rays * np.where(np.isfinite(table), table, 0)[..., None] - foot)
        radius = rng.uniform(*TABLE_RADIUS)
        table = np.where((table > 0) & (away < radius), table, np.inf)
        _put(depth, cosine, label, table, np.abs(down) / length, TABLE)
    if bodies:
        joined = trimesh.util.concatenate(bodies)
        others = MeshCaster(joined.vertices, joined.faces, camera).cast_window(
            np.eye(4) if T_camera_table is None else T_camera_table, window=bounds
        )
        _put(depth, cosine, label, others.depth, others.cosine, OTHER)
    if rng.random() < config.wall:
        behind = float(middle[2]) + rng.uniform(*WALL_BEHIND)
        _put(depth, cosine, label, np.full(depth.shape, behind), 1.0 / length, OTHER)
    window = DepthWindow(alone.origin, depth, cosine)
    return RenderedScene(window, label, object_alone, T_camera_object, plane)


def _length(vectors: Array) -> Array:
    """Lengths [...] of vectors [..., 3]: faster than a norm along a short axis."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.sqrt(x * x + y * y + z * z)


def _put(
    depth: NDArray[np.float32],
    cosine: NDArray[np.float32],
    label: NDArray[np.uint8],
    new_depth: NDArray[np.floating],
    new_cosine: NDArray[np.floating],
    new_label: int,
) -> None:
    """Draw another surface into the images wherever it is nearer."""
    nearer = new_depth < depth
    depth[nearer], cosine[nearer], label[nearer] = new_depth[nearer], new_cosine[nearer], new_label
