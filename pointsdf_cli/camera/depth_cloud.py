"""Back-projection of depth images to point clouds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.errors import InputError
from pointsdf_cli.io.clouds import Cloud, DepthImage

OFF_CENTRE = 0.22
"""Distance of the principal point from the image's middle, as a share of its size, above which a
warning is given: intrinsics of half or twice the resolution make 0.25 or more."""


def cloud_of_depth(
    depth: NDArray[np.float64],
    camera: Camera,
    T_world_camera: NDArray[np.float64] | None = None,
    colours: NDArray[np.uint8] | None = None,
    nearest: float = 0.05,
    farthest: float = 5.0,
    scale: float | None = None,
) -> Cloud:
    """Back-project every pixel with a valid depth; camera frame.

    Args:
        depth: [height, width], m along z; 0 without a measurement.
        camera: Intrinsics of the depth image.
        T_world_camera: [4, 4], stored with the cloud; None if it is not known.
        colours: [height, width, 3], registered to the depth image; None for none.
        nearest, farthest: Range of valid depths [m].
        scale: Metres per unit of the image's file, for messages; None if it is not known.

    Raises:
        InputError: The sizes differ, the limits are in the wrong order, or no pixel has a depth
            within them.
    """
    if not 0 <= nearest < farthest:
        what = f"depths from {nearest} to {farthest} m"
        raise InputError(what, where="--near, --far", allowed="0 or more, the nearer one first")
    if depth.shape != (camera.height, camera.width):
        raise InputError(
            f"a depth image of {depth.shape[::-1]} for a camera of {camera.width, camera.height}"
        )
    if colours is not None and colours.shape[:2] != depth.shape:
        raise InputError(
            f"the colour image has {colours.shape[1]} × {colours.shape[0]} pixels and the depth "
            f"image {depth.shape[1]} × {depth.shape[0]}",
            where="--color",
            allowed="a colour image registered to the depth image, pixel by pixel",
        )
    v, u = np.nonzero((depth >= nearest) & (depth <= farthest) & (depth > 0))
    if not len(v):
        raise _nothing_seen(depth, nearest, farthest, scale)
    return Cloud(
        points=camera.back_project(u, v, depth[v, u]),
        colours=None if colours is None else np.ascontiguousarray(colours[v, u]),
        frame="camera",
        T_world_camera=T_world_camera,
        pixels=np.stack([u, v], axis=1).astype(np.float64),
        image=DepthImage(depth, camera.K),
        notes=_off_centre(camera),
    )


def _nothing_seen(
    depth: NDArray[np.float64], nearest: float, farthest: float, scale: float | None
) -> InputError:
    """Error for an image [height, width] without any depth from `nearest` to `farthest` [m]."""
    seen = depth[depth > 0]
    if not len(seen):
        return InputError(
            "the depth image is 0 everywhere: the camera saw nothing",
            allowed="depths above 0 where something was seen",
            hint="was the camera covered, or too near? Is it the depth stream's image?",
        )
    found = f"{seen.min():.4g} to {seen.max():.4g} m"
    return InputError(
        f"no depth between {nearest:g} and {farthest:g} m (there is {found})",
        allowed="depths of a table-top scene",
        hint=_scale_hint(seen, nearest, farthest, scale),
    )


FACTORS = (0.1, 0.2, 0.25, 10.0, 0.001, 1000.0)
"""Units of depth images beside 1 mm and 1 m, in these: 0.1 mm (RealSense), 1/5000 m (TUM), 0.25 mm
(ToF), 1 cm; and millimetres taken for metres, or the reverse."""


def _scale_hint(
    seen: NDArray[np.float64], nearest: float, farthest: float, scale: float | None
) -> str:
    """Hint about --depth-scale for measured depths [N] out of range, m."""
    ranges = {factor: (factor * seen.min(), factor * seen.max()) for factor in FACTORS}
    fits = {f: r for f, r in ranges.items() if nearest <= r[0] and r[1] <= farthest}
    if scale is None or not fits:
        return "check --depth-scale: 0.001 if the numbers are millimetres, 1 for metres"
    named = [f"--depth-scale {f * scale:g} ({a:.2g} to {b:.2g} m)" for f, (a, b) in fits.items()]
    far = "; a scene truly that far: rgrasp cloud --far" if seen.min() > farthest else ""
    return " or ".join(named) + far


def _off_centre(camera: Camera) -> tuple[str, ...]:
    """Warning that the intrinsics seem to be of another resolution; empty if they do not."""
    off = abs(camera.cx / camera.width - 0.5), abs(camera.cy / camera.height - 0.5)
    if max(off) <= OFF_CENTRE:
        return ()
    return (
        f"the principal point ({camera.cx:g}, {camera.cy:g}) is far from the middle of the image "
        f"of {camera.width} × {camera.height}: are the intrinsics of another resolution?",
    )
