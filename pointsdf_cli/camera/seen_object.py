"""Erroneous segmentation of the object in one depth image of a simulated scene.

Every segmentation errs by a few pixels, and each kind in its own way. One that removes the table's
plane keeps what stands above it, flying pixels at the silhouette included, and loses the foot. One
that draws a mask loses a rim of uneven width or takes in a rim of the background.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.camera.table_scene import OBJECT, OTHER, RenderedScene
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.visibility import PLANE_BAND, ViewEvidence, visibility_image


@dataclass(frozen=True)
class SegmentationErrors:
    """Errors of a segmentation.

    Attributes:
        masked: Share of views that are segmented by a mask; the others by the table's plane, where
            there is a table.
        offset: By how much a mask is too small (below 0) or too large [sensor px]. A sensor pixel
            is that of a depth camera with a focal length of `sensor_focal`: images of a longer one
            were enlarged.
        sensor_focal: [px].
        uneven: Standard deviation of the offset along the silhouette, as a share of the offset.
        ragged: Further standard deviation, independent of the offset [sensor px].
        height: Standard deviation of the error of the plane's height [m].
        tilt: Tilt of its direction [rad].
        cut: Share of views in which nothing returns from one side of the object, as from dark or
            shiny parts.
        most_cut: Largest share of the object's pixels that lies on this side.
        holed: Share of views in which nothing returns from an ellipse in the object's image.
    """

    masked: float = 0.75
    offset: tuple[float, float] = (-3.0, 1.0)
    sensor_focal: float = 570.0
    uneven: float = 0.4
    ragged: float = 0.5
    height: float = 0.001
    tilt: float = 0.004
    cut: float = 0.12
    most_cut: float = 0.35
    holed: float = 0.2

    def __post_init__(self) -> None:
        if not 0 <= self.masked <= 1 or self.offset[0] > self.offset[1]:
            raise InputError(
                f"masked = {self.masked}, offset = {self.offset}",
                allowed="a share from 0 to 1, and two numbers of pixels, the lower one first",
            )


@dataclass(frozen=True)
class SeenObject:
    """One object as measured and segmented, camera frame, m.

    Attributes:
        points: [N, 3], taken for the object's.
        others: [M, 3], all other measured points of the window.
        support_plane: [4], as it is known, errors included; None if there is none.
        rays: [K, 2], tangents x/z, y/z of the mask's pixels without depth; none where no mask is
            known.
    """

    points: Array
    others: Array
    support_plane: Array | None
    rays: Array

    def evidence(self, pitch: float) -> ViewEvidence:
        """Observed space besides the points; `pitch` as in `visibility_image`."""
        image = visibility_image(self.points, self.others, self.support_plane, pitch, self.rays)
        return ViewEvidence(image, self.support_plane)


def segment_scene(
    scene: RenderedScene,
    measured: NDArray[np.float32],
    camera: Camera,
    errors: SegmentationErrors,
    rng: np.random.Generator,
) -> SeenObject:
    """The object of a scene, segmented with errors.

    Args:
        scene: The exact scene.
        measured: f4 [h, w], what a sensor gives of its window, 0 where nothing returned.
        camera: Intrinsics.
        errors: Errors of the segmentation.
        rng: Random generator of the errors.
    """
    returned = (measured > 0) & ~_without_return(scene, errors, rng)
    rows, columns = np.nonzero(returned)
    left, top = scene.window.origin
    points = camera.back_project(columns + left, rows + top, measured[rows, columns])
    plane = _known_plane(scene.support_plane, scene.T_camera_object[:3, 3], errors, rng)
    above = np.ones(len(points), dtype=bool)
    if plane is not None:
        above = points @ plane[:3] - plane[3] > PLANE_BAND
    rays = np.zeros((0, 2))
    if plane is None or rng.random() < errors.masked:
        mask = _erring_mask(scene, camera, errors, rng)
        rays = camera.rays_of(mask & ~returned, scene.window.origin)
    else:
        # The object's pixels and those up to a few pixels beside it: flying ones.
        near = ndimage.binary_dilation(scene.label == OBJECT, iterations=3)
        mask = near & (scene.label != OTHER)
    kept = mask[rows, columns] & above
    return SeenObject(points[kept], points[~kept], plane, rays)


def _without_return(
    scene: RenderedScene, errors: SegmentationErrors, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """bool [h, w]: pixels of the object from which nothing returns, whatever the sensor."""
    visible = scene.label == OBJECT
    missing = np.zeros_like(visible)
    pixels = np.argwhere(visible).astype(float)
    if len(pixels) == 0:
        return missing
    rows, columns = np.indices(visible.shape)
    if rng.random() < errors.cut:
        angle = rng.uniform(0.0, 2.0 * np.pi)
        across = np.array([np.cos(angle), np.sin(angle)])
        limit = np.quantile(pixels @ across, 1.0 - rng.uniform(0.05, errors.most_cut))
        missing |= rows * across[0] + columns * across[1] > limit
    if rng.random() < errors.holed:
        middle = pixels[rng.integers(len(pixels))]
        size = np.sqrt(len(pixels))
        radii = np.maximum(rng.uniform(0.04, 0.2, 2) * size, 1.0)
        down, right = (rows - middle[0]) / radii[0], (columns - middle[1]) / radii[1]
        missing |= down**2 + right**2 < 1
    return missing & visible


def _known_plane(
    plane: Array | None, place: Array, errors: SegmentationErrors, rng: np.random.Generator
) -> Array | None:
    """The support plane as a fit would give it: off in height below `place` [3] and in tilt."""
    if plane is None:
        return None
    height, tilt = rng.normal(0.0, errors.height), rng.normal(0.0, errors.tilt, 3)
    foot = place - (plane[:3] @ place - plane[3]) * plane[:3]
    normal = plane[:3] + tilt
    normal /= np.linalg.norm(normal)
    return np.array([*normal, normal @ foot + height])


def _erring_mask(
    scene: RenderedScene, camera: Camera, errors: SegmentationErrors, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """bool [h, w]: the object's visible pixels, too few or too many at the silhouette."""
    visible = scene.label == OBJECT
    sensor_pixel = max(1.0, camera.fx / errors.sensor_focal)
    offset = rng.uniform(*errors.offset) * sensor_pixel
    # No mask loses more than most of a thin object.
    depth_inside = ndimage.distance_transform_edt(visible)
    offset = max(offset, -0.6 * float(depth_inside.max()))
    signed = depth_inside - ndimage.distance_transform_edt(~visible)
    coarse = rng.normal(0.0, errors.uneven * abs(offset) + errors.ragged * sensor_pixel, (8, 8))
    zoom = np.array(visible.shape) / 8
    uneven = ndimage.zoom(coarse, zoom, order=1, grid_mode=True, mode="nearest")
    uneven = uneven[: visible.shape[0], : visible.shape[1]]
    return np.asarray(signed + offset + uneven > 0.0)
