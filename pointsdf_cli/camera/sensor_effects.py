"""Errors of depth cameras, one by one, as functions of images.

Depth z is handled as its inverse w = 1/z, f4 [h, w] in 1/m, 0 where there is nothing: disparity
is f·b·w, and w is linear in the pixel over any plane.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.geometry.arrays import Mask

Image = NDArray[np.float32]

INCIDENCES = np.arccos((np.arange(64) + 0.5) / 64)
"""Angles of incidence [rad] at 64 equal steps of the cosine."""

_ROUNDING = 0.01
"""Largest distance [px] of columns that count as the same one."""

_FEW_STEPS = 6
"""Number of comparisons up to which they are faster than a running maximum."""

_AVERAGED = 4
"""Most distances at which `averaged` takes neighbours."""

STEEPEST = 1.4
"""Incidence [rad] beyond which the axial noise is constant: its formula diverges."""

_BOUNDED = np.minimum(INCIDENCES, STEEPEST)
_GROWS: Image = (_BOUNDED**2 / (np.pi / 2 - _BOUNDED) ** 2).astype(np.float32)


def inverse_depth(depth: Image) -> Image:
    """Inverse depths [1/m] of depths [m]; 0 for 0 and inf."""
    seen = (depth > 0) & np.isfinite(depth)
    inverse = np.zeros_like(depth)
    np.divide(np.float32(1), depth, out=inverse, where=seen)
    return inverse


def gradient(inverse: Image) -> tuple[Image, Image]:
    """Slopes of w along columns and rows [1/(m·px)].

    The smaller of the differences to both sides is used: it does not cross an edge.
    """
    return _smaller_difference(inverse, 1), _smaller_difference(inverse, 0)


def cos_incidence(
    inverse: Image, slopes: tuple[Image, Image], camera: Camera, origin: tuple[int, int] = (0, 0)
) -> Image:
    """Cosine of the angle between ray and surface normal; 1 where there is nothing.

    On a plane n·p = c, w = (n/c)·(x, y, 1) with x, y the ray's slopes, so that the gradient of w
    over x and y gives the normal.
    """
    rows, columns = inverse.shape
    x = ((np.arange(columns) + origin[0] - camera.cx) / camera.fx).astype(np.float32)
    y = ((np.arange(rows) + origin[1] - camera.cy) / camera.fy).astype(np.float32)[:, None]
    along_x, along_y = slopes[0] * np.float32(camera.fx), slopes[1] * np.float32(camera.fy)
    along_z = inverse - along_x * x - along_y * y
    length = (along_x * along_x + along_y * along_y + along_z * along_z) * (x * x + y * y + 1)
    np.sqrt(length, out=length)
    cosine = inverse / np.maximum(length, np.float32(1e-12), out=length)
    cosine[inverse <= 0] = 1
    return np.minimum(cosine, np.float32(1), out=cosine)


def incidence_index(cosine: Image) -> NDArray[np.int32]:
    """Place in `INCIDENCES` of each cosine, 0 to 1."""
    steps = len(INCIDENCES)
    return np.minimum((cosine * np.float32(steps)).astype(np.int32), np.int32(steps - 1))


def _smaller_difference(values: Image, axis: int) -> Image:
    """Difference to the next or from the last pixel along an axis, whichever is smaller."""
    found = np.zeros_like(values)
    if values.shape[axis] < 2:
        return found
    # Views whose first axis is that of the difference; results keep the order of `values` in
    # memory, which later products with it depend on for their speed.
    into, of = found.swapaxes(0, axis), values.swapaxes(0, axis)
    step = of[1:] - of[:-1]
    into[0], into[-1] = step[0], step[-1]
    before, after = step[:-1], step[1:]
    into[1:-1] = np.where(np.abs(before) < np.abs(after), before, after)
    return found


def smooth_noise(shape: tuple[int, ...], window: float, rng: np.random.Generator) -> Image:
    """Gaussian noise of unit variance, correlated over about `window` pixels.

    Args:
        shape: [..., h, w].
        window: Distance of the cubic B-splines [px]; 1 or less gives white noise.
    """
    if window <= 1:
        return rng.standard_normal(shape, dtype=np.float32)
    down, across = _splines(shape[-2], window), _splines(shape[-1], window)
    drawn = rng.standard_normal((*shape[:-2], down.shape[1], across.shape[1]), dtype=np.float32)
    return np.asarray(down @ drawn @ across.T, dtype=np.float32)


def _splines(pixels: int, window: float) -> Image:
    """Cubic B-splines [pixels, knots], a knot every `window` pixels, rows of unit norm."""
    # Cached by rounded-up size: the rows of a larger window are the same.
    larger = _spline_table(-(-pixels // 128) * 128, window)
    return larger[:pixels, : math.ceil((pixels - 1) / window) + 3]


@lru_cache(maxsize=64)
def _spline_table(pixels: int, window: float) -> Image:
    knots = np.arange(-1, math.ceil((pixels - 1) / window) + 2)
    away = np.abs(np.arange(pixels)[:, None] / window - knots)
    weight = np.where(away < 1, 2 / 3 - away**2 + away**3 / 2, np.clip(2 - away, 0, None) ** 3 / 6)
    weight /= np.linalg.norm(weight, axis=1, keepdims=True)
    found: Image = weight.astype(np.float32)
    found.flags.writeable = False
    return found


def displaced(
    inverse: Image, slopes: tuple[Image, Image], edges: Image, whole: Image
) -> tuple[Image, NDArray[np.int32]]:
    """Displace inverse depths.

    Args:
        inverse: Inverse depths.
        slopes: Their gradient.
        edges: Displacement (u, v) [2, h, w] of edges alone [px]: the plane of the surface at the
            displaced pixel is extrapolated to the pixel itself, up to the rounding of the
            displaced pixel: half a pixel of the plane's slope remains as noise.
        whole: Displacement (u, v) [2, h, w] of surfaces and edges [px].

    Returns:
        Inverse depths, and the flat index of the pixel that each came from.
    """
    rows, columns = inverse.shape
    shift = np.rint(edges + whole).astype(np.int32)
    u = np.arange(columns, dtype=np.int32) + shift[0]
    v = np.arange(rows, dtype=np.int32)[:, None] + shift[1]
    for place, last in ((u, columns - 1), (v, rows - 1)):
        np.maximum(place, np.int32(0), out=place)
        np.minimum(place, np.int32(last), out=place)
    at = v * np.int32(columns) + u
    taken = inverse.take(at)
    found = taken - slopes[0].take(at) * edges[0] - slopes[1].take(at) * edges[1]
    # Limit the extrapolation to a factor in depth.
    np.maximum(found, taken / np.float32(1.5), out=found)
    return np.minimum(found, taken * np.float32(1.5), out=found), at


def grown(inverse: Image, radius: float, relative: float) -> Image:
    """Inverse depths [1/m] with near surfaces grown by `radius` pixels over surfaces farther by
    `relative` of their depth."""
    found = inverse
    for _ in range(round(radius)):
        near = _dilated(found)
        found = np.where(near > found * np.float32(1 + relative), near, found)
    return found


def averaged(inverse: Image, radius: float, relative: float) -> Image:
    """Inverse depths averaged within surfaces, as by the window in which disparities are matched.

    Near a silhouette only the near side of the window is left, so that round surfaces look flatter
    there. Rows and columns are averaged in turn, at up to `_AVERAGED` distances to each side.

    Args:
        inverse: Inverse depths.
        radius: Half the window's side [px].
        relative: Difference of a pixel, as a share of its depth, beyond which a neighbouring one
            is another surface.
    """
    count = min(round(radius), _AVERAGED)
    if count < 1:
        return inverse
    distances = np.unique(np.rint(np.linspace(radius / count, radius, count)).astype(int))
    found = inverse
    for axis in (0, 1):
        total, weight = found.copy(), np.ones_like(found)
        values = found.swapaxes(0, axis)
        sums, weights = total.swapaxes(0, axis), weight.swapaxes(0, axis)
        for away in distances[distances < len(values)]:
            one, other = values[away:], values[:-away]
            lesser = np.minimum(one, other)
            same = np.abs(one - other) <= np.float32(relative * away) * lesser
            same &= lesser > 0
            share = same.astype(np.float32)
            sums[away:] += other * share
            sums[:-away] += one * share
            weights[away:] += share
            weights[:-away] += share
        found = total / weight
    return found


def _dilated(values: NDArray[Any]) -> NDArray[Any]:
    """Maximum over each pixel and its four neighbours."""
    found = values.copy()
    for axis in (0, 1):
        into, of = found.swapaxes(0, axis), values.swapaxes(0, axis)
        np.maximum(into[1:], of[:-1], out=into[1:])
        np.maximum(into[:-1], of[1:], out=into[:-1])
    return found


def shadow(inverse: Image, factor: float, side: str) -> Mask:
    """Surfaces that a projector or second imager beside the camera does not reach.

    A point at column u lies at u ± f·b·w in the other's image. It is hidden if a nearer point, on
    the side of the other, lies farther along.

    Args:
        inverse: Inverse depths.
        factor: f·b [px·m].
        side: Side of an object on which the shadow falls, `left` or `right`.
    """
    there = inverse > 0
    seen = inverse[there]
    # Nothing farther away than the difference of two disparities throws a shadow.
    reach = int(factor * (seen.max() - seen.min())) if len(seen) else 0
    step = 1 if side == "right" else -1
    ordered = inverse[:, ::step]
    other = np.arange(inverse.shape[1], dtype=np.float32) + np.float32(factor) * ordered
    limit = other + np.float32(_ROUNDING)
    if reach > _FEW_STEPS:
        hidden = limit < np.maximum.accumulate(other, axis=1)
    else:
        hidden = np.zeros(inverse.shape, dtype=bool)
        for k in range(1, min(reach + 1, inverse.shape[1])):
            hidden[:, k:] |= limit[:, k:] < other[:, :-k]
    return hidden[:, ::step] & there


def widened(shadow: Mask, margin: Image, side: str) -> Mask:
    """A shadow that reaches farther along the rows, over the object that casts it.

    Args:
        shadow: bool [h, w].
        margin: By how much [h, w], px.
        side: As in `shadow`.
    """
    step = -1 if side == "right" else 1
    columns = np.arange(shadow.shape[1], dtype=np.float32)
    last = np.where(shadow[:, ::step], columns, np.float32(-np.inf))
    away = columns - np.maximum.accumulate(last, axis=1)
    found: Mask = away[:, ::step] <= margin
    return found


def depth_edges(inverse: Image, relative: float) -> Mask:
    """Pixels beside a neighbour whose depth differs by more than `relative` of it."""
    found = np.zeros(inverse.shape, dtype=bool)
    for near, far in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        one, other = inverse[near], inverse[far]
        jump = np.abs(one - other) > np.float32(relative) * np.minimum(one, other)
        found[near] |= jump
        found[far] |= jump
    return found


def edge_distance(edges: Mask, farthest: int) -> NDArray[np.uint16]:
    """Distance [h, w] to the nearest edge in steps along rows and columns [px], at most
    `farthest`."""
    near = edges.astype(np.uint8)
    distance = np.full(edges.shape, farthest, dtype=np.uint16)
    for step in range(farthest):
        if step:
            near = _dilated(near)
        distance -= near
    return distance


@lru_cache(maxsize=64)
def missing_limits(at_edge: float, reach: float, grazing: float, angle: float) -> Image:
    """Normally distributed numbers below these limits [D, 64] are pixels without a return, by
    distance from a depth edge [px] and by incidence, in the steps of `INCIDENCES`.

    Args:
        at_edge: Probability at an edge.
        reach: Distance at which it has fallen to 1/e [px].
        grazing: Probability at an incidence of 90°.
        angle: Incidence from which returns are lost [rad].
    """
    farthest = math.ceil(2 * reach) + 1 if at_edge else 0
    by_distance = at_edge * np.exp(-((np.arange(farthest + 1) / reach) ** 2))
    by_distance[-1] = 0.0
    by_incidence = grazing * np.clip((INCIDENCES - angle) / (np.pi / 2 - angle), 0, 1)
    probability = 1 - np.multiply.outer(1 - by_distance, 1 - by_incidence)
    limits: Image = scipy.special.ndtri(np.clip(probability, 1e-12, 1 - 1e-12)).astype(np.float32)
    limits.flags.writeable = False
    return limits


def flying_pixels(inverse: Image, edges: Mask, share: float, rng: np.random.Generator) -> Image:
    """Replace a `share` of the inverse depths at edges by values between both sides."""
    at = np.flatnonzero(edges)
    at = at[rng.random(len(at), dtype=np.float32) < share]
    if not len(at):
        return inverse
    v, u = np.divmod(at, inverse.shape[1])
    padded = np.pad(inverse, 1, "edge")
    steps = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))
    around = np.stack([padded[v + 1 + down, u + 1 + right] for down, right in steps])
    nearest, farthest = around.max(axis=0), around.min(axis=0)
    found = inverse.copy()
    between = rng.random(len(at), dtype=np.float32)
    # At an edge to empty space there is no depth between.
    mixed = np.where(farthest > 0, farthest + between * (nearest - farthest), around[0])
    found[v, u] = mixed
    return found


def nguyen_deviation(
    depth: Image, incidence: NDArray[np.int32], floor: float, by_depth: float, by_incidence: float
) -> Image:
    """σ_z [m] = floor + by_depth·(z − 0.4)² + by_incidence/√z·θ²/(π/2 − θ)².

    Nguyen, Izadi and Lovell 2012, "Modeling Kinect sensor noise for improved 3D reconstruction
    and tracking", eq. 5; θ is given by its place in `INCIDENCES` and bounded by `STEEPEST`.
    """
    away = depth - np.float32(0.4)
    deviation: Image = np.float32(floor) + np.float32(by_depth) * away * away
    if by_incidence:
        deviation += np.float32(by_incidence) * _GROWS.take(incidence) / np.sqrt(depth)
    return deviation


def quantised(depth: Image, factor: float, step: float) -> Image:
    """Round the disparities factor/z [px] of depths to whole steps.

    Args:
        depth: [h, w], m.
        factor: f·b [px·m].
        step: Step of the disparity [px].
    """
    scaled = np.float32(factor / step)
    steps = np.rint(scaled / np.maximum(depth, np.float32(1e-3)))
    return np.asarray(scaled / np.maximum(steps, np.float32(1)), dtype=np.float32)
