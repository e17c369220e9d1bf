"""Times of a path's configurations, within the joints' speed limits.

The path is a polyline and is kept exactly: the result only adds points on it and times. Let τ be
the time that the path would take with the fastest joint always at its limit. The speed u = dτ/dt is
at most `CRUISE` and changes by at most 1/`RAMP` per second. It is zero at corners, where the
exported velocities are, and so low at slighter bends that a cubic interpolation needs hardly a
larger acceleration there than on a ramp.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.io.motion_file import is_corner

RAMP = 0.5
"""Time from rest to full speed [s]."""
CRUISE = 0.985
"""Share of full speed that is used: between points a cubic interpolation is up to 1.2% faster."""
STEP = 0.05
"""Longest piece of the path between two points of the result, as time at full speed [s]."""


@dataclass(frozen=True)
class Trajectory:
    """Timed configurations.

    Attributes:
        times: [T], increasing from 0, s.
        positions: [T, J], joint positions.
    """

    times: Array
    positions: Array


def time_path(path: Array, velocity: Array, speed: float) -> Trajectory:
    """Compute the times of a path that begins and ends at rest.

    Args:
        path: [T, J], corners in joint space.
        velocity: [J], speed limits.
        speed: Share of the limits to use.
    """
    path = np.asarray(path, dtype=np.float64)
    limit = velocity * speed
    moves = (np.abs(np.diff(path, axis=0)) > 1e-12).any(axis=1)
    path = path[np.concatenate([[True], moves])]
    if len(path) == 1:
        return Trajectory(np.zeros(1), path)
    legs = np.diff(path, axis=0)
    full = (np.abs(legs) / limit).max(axis=1)
    pieces = np.maximum(2, np.ceil(full / STEP)).astype(int)
    points, tau, top = [path[:1]], [np.zeros(1)], [np.zeros(1)]
    corners = np.append(is_corner(path), True)
    for i, (leg, count) in enumerate(zip(legs, pieces, strict=True)):
        share = np.arange(1, count + 1)[:, None] / count
        points.append(path[i] + share * leg)
        tau.append(np.full(count, full[i] / count))
        corner = 0.0
        if not corners[i]:
            change = np.abs(legs[i + 1] / full[i + 1] - leg / full[i]) / limit
            gap = (full[i : i + 2] / pieces[i : i + 2]).min()
            # A cubic over a piece of duration gap / u turns by half the change: 2 u² change / gap,
            # and by a quarter more where the pieces differ.
            corner = min(CRUISE, np.sqrt(gap / (2.5 * RAMP * max(float(change.max()), 1e-12))))
        top.append(np.append(np.full(count - 1, CRUISE), corner))
    positions, gap = np.concatenate(points), np.concatenate(tau)[1:]
    positions[-1] = path[-1]
    rate = np.concatenate(top)
    for k in range(len(gap)):
        rate[k + 1] = min(rate[k + 1], np.sqrt(rate[k] ** 2 + 2 * gap[k] / RAMP))
    for k in reversed(range(len(gap))):
        rate[k] = min(rate[k], np.sqrt(rate[k + 1] ** 2 + 2 * gap[k] / RAMP))
    duration = 2 * gap / np.maximum(rate[:-1] + rate[1:], 1e-9)
    return Trajectory(np.concatenate([[0.0], np.cumsum(duration)]), positions)
