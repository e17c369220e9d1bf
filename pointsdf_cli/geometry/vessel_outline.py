"""Outline of a vessel's wall in the half plane of radius and height.

The outside is a radius at each height. The inside is star-shaped about the centre of the opening:
a distance at each angle from straight down to the rim. Where one side was not seen, it follows the
other at the wall's thickness.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from pointsdf_cli.geometry.arrays import Array, Mask

THINNEST, USUAL = 0.001, 0.003
"""Least thickness of a wall, and default thickness where it cannot be measured [m]."""
RIM = (0.002, 0.005)
"""Range [m] of thicknesses that a rim's width may tell."""
THICKEST, CROSSED = 0.35, 0.1
"""Largest thickness over the radius, and by how much errors of depth can move the inside beyond the
outside."""
SHALLOW = 0.05
"""Least depth of the seen inside over the radius."""
DISH = 0.25
"""Least depth of a seen floor over the radius: plates and lids are left to the network."""
ANGLES = 48
HEIGHTS = (8, 60)
"""Fewest and most bins of height."""
HEIGHT_BIN = 0.002


class NoVesselError(ValueError):
    """The points do not show a vessel of revolution."""


class Section(NamedTuple):
    """Points in the half plane.

    Attributes:
        radius, height: [N] m.
        inside, outside, level: [N], whether the normal points to the axis, away from it, upwards.
        agreeing: [N], whether points of other azimuths agree.
    """

    radius: Array
    height: Array
    inside: Mask
    outside: Mask
    level: Mask
    agreeing: Mask


class Outline(NamedTuple):
    """Outlines [K, 2] as `BodyOfRevolution` takes them.

    Attributes:
        wall: The wall and the floor.
        filled: The outside with the cavity filled.
        cavity: [C, 2], the inside from the axis to the rim.
        thickness: The wall's thickness [m].
    """

    wall: Array
    filled: Array
    cavity: Array
    thickness: float


def wall_outline(section: Section, base: float | None) -> Outline:
    """Outline of the wall.

    Args:
        section: The seen points.
        base: Height of the plane that the vessel stands on [m]; None if not known.

    Raises:
        NoVesselError: The points show no thin wall around a cavity.
    """
    section, rim, size = _below_rim(section)
    floor = section.agreeing & (section.inside | section.level)
    lowest = float(np.quantile(section.height[section.agreeing], 0.005))
    if base is None:
        bottom = min(lowest, float(np.quantile(section.height[floor], 0.02)) - 0.002)
    else:
        bottom = min(base, lowest + 0.003)
    if rim - bottom < 0.004:
        raise NoVesselError("it is flat")
    heights, outside = _outside(section, bottom, rim)
    angles, inside = _inside(section, floor, bottom, rim)
    measured = _thickness(heights, outside, angles, inside, rim)
    if measured > THICKEST * size:
        raise NoVesselError("the wall is thick")
    if measured < -CROSSED * size:
        raise NoVesselError("the inside lies beyond the outside")
    thickness = measured
    if not measured > THINNEST:  # none was measured, or errors of depth move the sides together
        thickness = _rim_width(section, rim)
        overlap = max(0.0, thickness - measured) if np.isfinite(measured) else 0.0
        outside, inside = outside + overlap / 2, inside - overlap / 2
    thickness = min(thickness, 0.2 * size)
    outside = _whole_outside(heights, outside, _curve(angles, inside, rim), thickness)
    below, above = [[0.0, bottom], [outside[0], bottom]], [[outside[-1], rim], [0.0, rim]]
    filled = np.concatenate([below, np.stack([outside, heights], axis=1), above])
    cavity = _whole_cavity(heights, outside, angles, inside, thickness, bottom, rim)
    top = min(float(cavity[-1, 0]), float(outside[-1]) - THINNEST)
    wall = np.concatenate([filled[:-1], [[top, rim]], cavity[::-1], [[0.0, cavity[0, 1]]]])
    return Outline(wall, filled, cavity, thickness)


def _below_rim(section: Section) -> tuple[Section, float, float]:
    """The section without what rises above the rim, such as a bucket's handle; the rim's height
    and the vessel's radius [m]."""
    size = float(np.quantile(section.radius[section.agreeing], 0.98))
    upper = float(np.quantile(section.height[section.inside], 0.98))
    at_rim = section.agreeing & (section.height < upper + max(0.003, 0.04 * size))
    rim = float(np.quantile(section.height[at_rim], 0.995))
    below = section.height < rim + 0.003
    section = section._replace(inside=section.inside & below, outside=section.outside & below)
    if rim - float(np.quantile(section.height[section.inside], 0.25)) < SHALLOW * size:
        raise NoVesselError("the inside is shallow")
    floor = section.agreeing & section.level & (section.radius < 0.5 * size)
    if floor.sum() >= 20 and rim - float(np.median(section.height[floor])) < DISH * size:
        raise NoVesselError("it is a dish")
    return section, rim, size


def _outside(section: Section, bottom: float, rim: float) -> tuple[Array, Array]:
    """Heights [H] and radii [H] of the outside, NaN where it was not seen."""
    count = int(np.clip((rim - bottom) / HEIGHT_BIN, *HEIGHTS))
    edges = np.linspace(bottom, rim, count + 1)
    seen = section.outside
    radii = _medians(section.height[seen], section.radius[seen], edges)
    return (edges[1:] + edges[:-1]) / 2, radii


def _inside(section: Section, floor: Mask, bottom: float, rim: float) -> tuple[Array, Array]:
    """Angles [A] at the opening's centre from straight down, and distances [A] of the inside."""
    seen = floor & (section.height < rim - 0.0005) & (section.height > bottom)
    down, radius = rim + 0.001 - section.height[seen], section.radius[seen]
    edges = np.linspace(0.0, np.pi / 2, ANGLES + 1)
    distances = _medians(np.arctan2(radius, down), np.hypot(radius, down), edges)
    if np.isfinite(distances).sum() < 3:
        raise NoVesselError("little of an inside is seen")
    return (edges[1:] + edges[:-1]) / 2, distances


def _curve(angles: Array, distances: Array, rim: float) -> Array:
    """Radii and heights [K, 2] of the finite distances."""
    seen = np.isfinite(distances)
    angle, distance = angles[seen], distances[seen]
    height = rim + 0.001 - distance * np.cos(angle)
    return np.stack([distance * np.sin(angle), height], axis=1)


def _thickness(heights: Array, outside: Array, angles: Array, inside: Array, rim: float) -> float:
    """Thickness [m] where both sides were seen, negative if they cross; NaN without such places."""
    found = []
    for radius, height in _curve(angles, inside, rim):
        near = (np.abs(heights - height) < 2.5 * (heights[1] - heights[0])) & np.isfinite(outside)
        at = int(np.argmin(np.abs(heights - height)))
        if not np.isfinite(outside[at]):
            continue
        slope = np.polyfit(heights[near], outside[near], 1)[0] if near.sum() >= 3 else 0.0
        if abs(slope) < 3:
            found.append((outside[at] - radius) / np.hypot(1.0, slope))
    if len(found) < 3:
        return np.nan
    thickness = float(np.quantile(found, 0.35))
    spread = float(np.median(np.abs(np.array(found) - np.median(found))))
    if spread > 0.5 * max(thickness, 0.004):
        raise NoVesselError("the wall's thickness varies")
    return thickness


def _rim_width(section: Section, rim: float) -> float:
    """Thickness [m] of the wall at the rim, or the usual one."""
    ring = section.agreeing & (np.abs(section.height - rim + 0.0005) < 0.0015)
    if ring.sum() <= 10:
        return USUAL
    low, high = np.quantile(section.radius[ring], [0.05, 0.95])
    return float(np.clip(high - low, *RIM))


def _whole_outside(heights: Array, radii: Array, cavity: Array, thickness: float) -> Array:
    """Radii [H] of the outside at all heights: where it was not seen, by the inside [K, 2]."""
    way = np.gradient(cavity, axis=0)
    normal = np.stack([way[:, 1], -way[:, 0]], axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    normal *= np.where(normal[:, :1] + 1e-3 * (normal[:, 1:] < 0) < 0, -1.0, 1.0)
    behind = cavity + thickness * normal
    order = np.argsort(behind[:, 1])
    by_inside = np.interp(heights, behind[order, 1], behind[order, 0], left=np.nan, right=np.nan)
    radii = np.where(np.isfinite(radii), radii, by_inside)
    known = np.flatnonzero(np.isfinite(radii))
    if len(known) < 3:
        raise NoVesselError("little of a wall is seen")
    whole = np.interp(heights, heights[known], radii[known])
    first, low = known[0], known[:6]
    if first > 0:
        slope = np.clip(np.polyfit(heights[low], radii[low], 1)[0], -0.3, 1.0)
        straight = radii[first] + slope * (heights[:first] - heights[first])
        whole[:first] = np.maximum(straight, 0.3 * radii[first])
    smooth = ndimage.median_filter(whole, 3, mode="nearest")
    return np.asarray(ndimage.gaussian_filter1d(smooth, 0.7, mode="nearest"))


def _whole_cavity(
    heights: Array,
    outside: Array,
    angles: Array,
    distances: Array,
    thickness: float,
    bottom: float,
    rim: float,
) -> Array:
    """Radii and heights [C, 2] of the inside, from the axis to the rim: where it was not seen, the
    wall's thickness from the outside."""
    slope = np.clip(np.gradient(outside, heights), -3.0, 3.0)
    radii = np.maximum(outside - thickness * np.hypot(1.0, slope), 0.0005)
    top = rim + 0.001
    above = heights > bottom + thickness
    floor = [[0.0, bottom + thickness], [radii[0], bottom + thickness]]
    side = np.stack([radii, heights], axis=1)[above]
    line = np.concatenate([floor, side, [[radii[-1], top]]])
    to_wall = np.array([_ray_length(angle, line, top) for angle in angles])
    seen = np.isfinite(distances)
    most = np.where(np.isfinite(to_wall), to_wall + thickness - THINNEST, distances)
    whole = np.where(seen, np.minimum(distances, most), to_wall)
    known = np.isfinite(whole)
    whole = np.interp(angles, angles[known], whole[known])
    cavity = np.stack([whole * np.sin(angles), top - whole * np.cos(angles)], axis=1)
    return cavity[cavity[:, 1] < rim - 1e-4]


def _ray_length(angle: float, line: Array, top: float) -> float:
    """Distance from the opening's centre to a polyline [K, 2] at this angle; NaN if none."""
    ray = np.array([np.sin(angle), -np.cos(angle)])
    begin, way = line[:-1] - [0.0, top], np.diff(line, axis=0)
    cross = ray[0] * way[:, 1] - ray[1] * way[:, 0]
    cross = np.where(np.abs(cross) < 1e-12, 1e-12, cross)
    length = (begin[:, 0] * way[:, 1] - begin[:, 1] * way[:, 0]) / cross
    share = (begin[:, 0] * ray[1] - begin[:, 1] * ray[0]) / cross
    hit = (share >= -1e-6) & (share <= 1 + 1e-6) & (length > 0)
    return float(length[hit].min()) if hit.any() else np.nan


def _medians(keys: Array, values: Array, edges: Array) -> Array:
    """Median of the values [N] in each bin of the keys [N]; NaN where fewer than three are."""
    index = np.digitize(keys, edges) - 1
    found = np.full(len(edges) - 1, np.nan)
    for one in np.unique(index[(index >= 0) & (index < len(found))]):
        chosen = values[index == one]
        if len(chosen) >= 3:
            found[one] = np.median(chosen)
    return found
