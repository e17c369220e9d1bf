"""Times of a path's configurations, within the joints' speed limits.

The path is a polyline and is kept exactly: the result only adds points on it and times. Let τ be
the time that the path would take with the fastest joint always at its limit. The speed u = dτ/dt is
at most 1, changes by at most 1/ramp per second, and is so low at a corner that no joint's speed
jumps by more than `jump` of its limit there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pointsdf_cli.geometry.arrays import Array

RAMP = 0.5
"""Time from rest to full speed [s]."""
JUMP = 0.1
"""Largest jump of a joint's speed at a corner, as a share of its limit."""
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


def time_path(path: Array, velocity: Array, speed: float = 0.5) -> Trajectory:
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
    for i, (leg, count) in enumerate(zip(legs, pieces, strict=True)):
        share = np.arange(1, count + 1)[:, None] / count
        points.append(path[i] + share * leg)
        tau.append(np.full(count, full[i] / count))
        corner = 0.0
        if i + 1 < len(legs):
            change = np.abs(legs[i + 1] / full[i + 1] - leg / full[i]) / limit
            corner = min(1.0, JUMP / max(float(change.max()), 1e-12))
        top.append(np.concatenate([np.ones(count - 1), [corner]]))
    positions, gap = np.concatenate(points), np.concatenate(tau)[1:]
    positions[-1] = path[-1]
    rate = np.concatenate(top)
    for k in range(len(gap)):
        rate[k + 1] = min(rate[k + 1], np.sqrt(rate[k] ** 2 + 2 * gap[k] / RAMP))
    for k in reversed(range(len(gap))):
        rate[k] = min(rate[k], np.sqrt(rate[k + 1] ** 2 + 2 * gap[k] / RAMP))
    duration = 2 * gap / np.maximum(rate[:-1] + rate[1:], 1e-9)
    return Trajectory(np.concatenate([[0.0], np.cumsum(duration)]), positions)
