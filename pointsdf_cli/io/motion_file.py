"""The motion of a plan as JSON, with the fields of ROS's trajectory_msgs/JointTrajectory."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.io.atomic import write_text_atomic
from pointsdf_cli.io.plans import Plan

CORNER = 0.2
"""Change of the direction of motion [rad, about] from which a point is a corner."""


def velocities_of(times: Array, positions: Array) -> Array:
    """Velocities [T, J] at the points of a polyline, zero at its ends and corners.

    A cubic interpolation with them (ros2_control's) has continuous velocities and stays on the
    polyline: within 0.1 mrad for planned motions, where the mean velocity at a corner leaves it by
    5 mrad.

    Args:
        times: [T], increasing, s.
        positions: [T, J], joint positions.
    """
    if len(times) < 3:
        return np.zeros_like(positions)
    # Of second order, so exact for constant acceleration along a leg.
    velocities = np.gradient(positions, times, axis=0)
    velocities[1:-1][is_corner(positions)] = 0.0
    velocities[[0, -1]] = 0.0
    return velocities


def is_corner(positions: Array) -> NDArray[np.bool_]:
    """Corners [T − 2] among the inner points of a polyline [T, J]."""
    legs = np.diff(positions, axis=0)
    ways = legs / np.maximum(np.linalg.norm(legs, axis=1, keepdims=True), 1e-12)
    found: NDArray[np.bool_] = np.linalg.norm(np.diff(ways, axis=0), axis=1) > CORNER
    return found


def trajectory_as_json(plan: Plan) -> dict[str, Any]:
    """The motion with the fields of ROS's trajectory_msgs/JointTrajectory.

    Raises:
        InputError: The plan holds no motion.
    """
    if not len(plan.times):
        raise InputError("the plan holds no motion", allowed="a plan whose status is ok")
    points = []
    velocities = velocities_of(plan.times, plan.trajectory)
    for time, positions, speeds in zip(plan.times, plan.trajectory, velocities, strict=True):
        # Rounded once as a whole: a fraction of 0.9999999999 must not become 1e9 nanoseconds.
        nanoseconds = round(float(time) * 1e9)
        since = {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}
        point = {"positions": positions.tolist(), "velocities": speeds.tolist()}
        points.append(point | {"time_from_start": since})
    header = {"frame_id": "world"}
    return {"header": header, "joint_names": list(plan.joint_names), "points": points}


def write_trajectory(path: Path | str, plan: Plan) -> None:
    """Write `trajectory_as_json` to a file."""
    write_text_atomic(path, json.dumps(trajectory_as_json(plan), indent=1) + "\n")
