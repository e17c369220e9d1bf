"""The pinhole camera: OpenCV axes (+z forward, +y down), `K` in pixels, depth along z."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pointsdf_cli.errors import InputError

LARGEST_IMAGE = 8192


@dataclass(frozen=True)
class Camera:
    """Intrinsics of an ideal camera.

    Attributes:
        width, height: Image size [px].
        fx, fy: Focal lengths [px].
        cx, cy: Principal point [px]; pixel centres are at whole numbers.

    Raises:
        InputError: A value is not finite or out of its range.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            if not 1 <= getattr(self, name) <= LARGEST_IMAGE:
                what = f"{name} is {getattr(self, name)}"
                raise InputError(what, where="camera", allowed=f"1 to {LARGEST_IMAGE} pixels")
        numbers = (self.fx, self.fy, self.cx, self.cy)
        if not all(map(math.isfinite, numbers)) or self.fx <= 0 or self.fy <= 0:
            raise InputError(
                f"K holds fx, fy, cx, cy = {numbers}",
                where="camera",
                allowed="finite numbers, focal lengths above 0, in pixels",
            )

    @property
    def K(self) -> NDArray[np.float64]:
        """The intrinsic matrix [3, 3]."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    def project(self, points: ArrayLike) -> NDArray[np.float64]:
        """Pixels [N, 2] (u, v) of points [N, 3] in the camera frame, z > 0."""
        points = np.asarray(points, dtype=np.float64)
        focal, centre = np.array([self.fx, self.fy]), np.array([self.cx, self.cy])
        return points[..., :2] / points[..., 2:] * focal + centre

    def back_project(self, u: ArrayLike, v: ArrayLike, depth: ArrayLike) -> NDArray[np.float64]:
        """Points [..., 3] in the camera frame of pixels (u, v) at `depth` [m] along z."""
        u, v, depth = np.broadcast_arrays(
            np.asarray(u, np.float64), np.asarray(v, np.float64), np.asarray(depth, np.float64)
        )
        x, y = (u - self.cx) / self.fx * depth, (v - self.cy) / self.fy * depth
        return np.stack([x, y, depth], axis=-1)

    def rays_of(
        self, mask: NDArray[np.bool_], origin: tuple[int, int] = (0, 0)
    ) -> NDArray[np.float64]:
        """Tangents (x/z, y/z) [K, 2] of the pixels of a mask [h, w].

        Args:
            mask: Part of the image.
            origin: Column and row of its first pixel.
        """
        v, u = np.nonzero(mask)
        return self.back_project(u + origin[0], v + origin[1], 1.0)[:, :2]


def from_field_of_view(width: int, height: int, vertical: float) -> Camera:
    """A camera with square pixels, centred, of a vertical field of view [rad]."""
    focal = height / 2 / math.tan(vertical / 2)
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


CAMERAS = {
    # The paper's simulated camera (640×480, vertical field of view 0.820305 rad).
    "reference": from_field_of_view(640, 480, 0.820305),
    # The depth camera of a Kinect 2: nominal values of its factory calibration.
    "kinect2": Camera(512, 424, 365.456, 365.456, 254.878, 205.395),
    # Nominal depth cameras of an Asus Xtion and of a RealSense D415.
    "xtion": Camera(640, 480, 575.0, 575.0, 319.5, 239.5),
    "realsense": Camera(640, 480, 617.0, 617.0, 319.5, 239.5),
}
