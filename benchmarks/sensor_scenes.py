"""Cluttered tables as exact depth, and a sensor's errors on them counted by bins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.camera.raycast import MeshCaster
from pointsdf_cli.camera.sensor import DepthSensor
from pointsdf_cli.geometry.frames import apply_transform, invert_transform
from pointsdf_cli.io.meshes import LoadedMesh
from pointsdf_cli.viz.shading import look_at

XTION = Camera(640, 480, 1066.778, 1067.487, 312.9869, 241.3109)
"""Camera of YCB-Video: a depth image that is registered to the colour image."""

EDGE_BINS = (1.5, 2.5, 3.5, 5.5, 10.0)
"""Distances from the edge of the object's mask [px] that part the bins."""
ANGLE_BINS = (20, 40, 60, 70, 80, 90)
"""Angles of incidence [°] that bound the bins."""

# Seven frames of YCB-Video (Xtion, about 1 m) against registered meshes of 13 objects.
MEASURED = {
    "nothing returned": (0.33, 0.29, 0.25, 0.19, 0.11, 0.04),
    "> 10 mm behind": (0.16, 0.14, 0.11, 0.08, 0.05, 0.02),
    "> 10 mm before": (0.09, 0.05, 0.03, 0.01, 0.01, 0.01),
}
MEASURED_MISSING_BY_ANGLE = (0.03, 0.02, 0.11, 0.22, 0.39)
MEASURED_SIGMA_BY_ANGLE = (1.4, 2.0, 2.6, 5.2, 6.0)

OUTLIER = 0.01
"""A depth that is off by more [m] is behind or before the surface."""
GROSS = 0.05
"""A depth that is off by more [m] is of another surface and not counted in σ or bias."""
FEWEST = 500
"""Objects of which fewer pixels are seen are not counted."""


@dataclass(frozen=True)
class Clutter:
    """A table with objects, seen exactly.

    Attributes:
        depth: f4 [h, w], m.
        cosine: f4 [h, w], of the incidence.
        label: i8 [h, w], which object; -1 for the table.
    """

    depth: NDArray[np.float32]
    cosine: NDArray[np.float32]
    label: NDArray[np.int64]


@dataclass
class ErrorCounts:
    """Errors summed over objects.

    Attributes:
        pixels: Pixels of all objects by distance from the edge [6].
        errors: Wrong pixels among them, by kind as in `MEASURED` [6].
        pixels_by_angle, missing_by_angle: By incidence [5].
        residuals: Errors [mm] less their median over the object, by incidence.
        bias: Median error of each object [mm].
    """

    pixels: NDArray[np.int64] = field(default_factory=lambda: np.zeros(6, dtype=np.int64))
    errors: dict[str, NDArray[np.int64]] = field(
        default_factory=lambda: {name: np.zeros(6, dtype=np.int64) for name in MEASURED}
    )
    pixels_by_angle: NDArray[np.int64] = field(default_factory=lambda: np.zeros(5, dtype=np.int64))
    missing_by_angle: NDArray[np.int64] = field(default_factory=lambda: np.zeros(5, dtype=np.int64))
    residuals: list[list[NDArray[np.float32]]] = field(
        default_factory=lambda: [[] for _ in range(5)]
    )
    bias: list[float] = field(default_factory=list)

    def add(
        self,
        measured: NDArray[np.float32],
        exact: NDArray[np.float32],
        cosine: NDArray[np.float32],
        mask: NDArray[np.bool_],
    ) -> None:
        """Count one object's visible pixels `mask`; all images are [h, w]."""
        edge = ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1][mask]
        bins = np.digitize(edge, EDGE_BINS)
        degrees = np.degrees(np.arccos(np.clip(cosine[mask], 0, 1)))
        angle = np.digitize(degrees, ANGLE_BINS) - 1
        returned, error = measured[mask] > 0, measured[mask] - exact[mask]
        self.pixels += np.bincount(bins, minlength=6)
        kinds = (~returned, returned & (error > OUTLIER), returned & (error < -OUTLIER))
        for name, kind in zip(MEASURED, kinds, strict=True):
            self.errors[name] += np.bincount(bins[kind], minlength=6)
        steep = (angle >= 0) & (angle < 5)
        self.pixels_by_angle += np.bincount(angle[steep], minlength=5)
        self.missing_by_angle += np.bincount(angle[steep & ~returned], minlength=5)
        near = returned & (np.abs(error) < GROSS)
        if near.any():
            self.bias.append(1e3 * float(np.median(error[near])))
        for k in range(5):
            chosen = error[near & (angle == k)]
            if len(chosen) > 5:
                self.residuals[k].append(1e3 * (chosen - np.median(chosen)))

    def shares(self, name: str) -> NDArray[np.float64]:
        """Share of pixels with an error of this kind, by distance from the edge [6]."""
        return self.errors[name] / np.maximum(self.pixels, 1)

    def missing(self) -> NDArray[np.float64]:
        """Share of pixels without a return, by incidence [5]."""
        return self.missing_by_angle / np.maximum(self.pixels_by_angle, 1)

    def sigma(self) -> NDArray[np.float64]:
        """1.4826 · median |error| [mm], by incidence [5]."""
        joined = [np.concatenate([*some, np.zeros(0)]) for some in self.residuals]
        return np.array([1.4826 * np.median(np.abs(e)) if len(e) else np.nan for e in joined])


def clutter(
    meshes: Sequence[LoadedMesh], rng: np.random.Generator, most: int = 6, camera: Camera = XTION
) -> Clutter:
    """A random table with up to `most` of the meshes close together, about 1 m from the camera."""
    elevation, azimuth = rng.uniform(0.45, 0.95), rng.uniform(0, 2 * np.pi)
    level = np.cos(elevation)
    toward = np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    middle = np.array([0, 0, 0.04])
    T_camera_world = invert_transform(look_at(middle + rng.uniform(0.85, 1.1) * toward, middle))
    depth, cosine = _table(T_camera_world, camera)
    label = np.full(depth.shape, -1)
    taken: list[set[tuple[int, ...]]] = []
    for k in rng.permutation(len(meshes)):
        placed = _placed(meshes[k].vertices, taken, rng)
        if placed is None:
            continue
        caster = MeshCaster(placed, meshes[k].faces, camera)
        seen = caster.cast_window(T_camera_world, window=(0, camera.width, 0, camera.height))
        nearer = seen.depth < depth
        depth[nearer], cosine[nearer] = seen.depth[nearer], seen.cosine[nearer]
        label[nearer] = len(taken) - 1
        if len(taken) == most:
            break
    return Clutter(depth, cosine, label)


def count_errors(
    sensor: DepthSensor, scenes: Sequence[Clutter], seed: int = 0, camera: Camera = XTION
) -> ErrorCounts:
    """Errors of a sensor on all objects of the scenes."""
    rng = np.random.default_rng(seed)
    counts = ErrorCounts()
    for scene in scenes:
        measured = sensor.observe(scene.depth, camera, rng, cos_incidence=scene.cosine)
        for k in range(scene.label.max() + 1):
            mask = scene.label == k
            if mask.sum() >= FEWEST:
                counts.add(measured, scene.depth, scene.cosine, mask)
    return counts


def _placed(
    vertices: NDArray[np.float64], taken: list[set[tuple[int, ...]]], rng: np.random.Generator
) -> NDArray[np.float64] | None:
    """The vertices upright or on a side where no other object stands; None if there is no room."""
    lying = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]) if rng.random() < 0.3 else np.eye(3)
    yaw = rng.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    turned = vertices @ (turn @ lying).T
    low, high = turned.min(axis=0), turned.max(axis=0)
    turned = turned - [*(low + high)[:2] / 2, low[2]]
    for _ in range(50):
        place = np.array([*rng.uniform(-0.16, 0.16, 2), 0.0])
        cells = set(map(tuple, np.floor((turned + place)[:, :2] / 0.01).astype(int).tolist()))
        if not any(cells & other for other in taken):
            taken.append(cells)
            return np.asarray(turned + place)
    return None


def _table(
    T_camera_world: NDArray[np.float64], camera: Camera
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Depth and cosine of the plane z = 0 in every pixel."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = camera.back_project(u, v, np.ones(u.shape))
    normal = T_camera_world[:3, 2]
    along = rays @ normal
    offset = float(normal @ apply_transform(T_camera_world, np.zeros((1, 3)))[0])
    with np.errstate(divide="ignore"):
        depth = offset / along
    depth[(depth <= 0) | (depth > 3)] = np.inf
    cosine = np.abs(along) / np.linalg.norm(rays, axis=-1)
    return depth.astype(np.float32), cosine.astype(np.float32)
