"""What a robot does with a plan, as trajectory_msgs/JointTrajectory: motion, closing, grip, lift.

Nothing here imports ROS or rgrasp. The message classes are passed in, so that the same code builds
messages for rclpy and, in the tests, for the message definitions of the rosbags package.
"""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import yaml
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Trajectory(NamedTuple):
    """Joint positions over time.

    names: the J joints; times: [T], s from the start; positions: [T, J], rad or m; velocities:
    [T, J], with which a controller interpolates by cubics, or None.
    """

    names: tuple[str, ...]
    times: Array
    positions: Array
    velocities: Array | None = None

    def of(self, names: Sequence[str]) -> Trajectory:
        """The columns of some joints, in their order: those that one controller moves."""
        columns = [self.names.index(name) for name in names]
        velocities = None if self.velocities is None else self.velocities[:, columns]
        return Trajectory(tuple(names), self.times, self.positions[:, columns], velocities)


class Hand(NamedTuple):
    """How the hand closes.

    speeds: of each closing joint [rad/s or m/s], negative towards the lower limit; limits: where
    each of them ends; followers: joints of the robot that follow others (<mimic>).
    """

    speeds: dict[str, float]
    limits: dict[str, float]
    followers: frozenset[str] = frozenset()


class Grasp(NamedTuple):
    """What a plan says of its grasp.

    status: "ok", or "no_plan"; success: its probability; names: the J joints; q: [J], the grasp.
    """

    status: str
    success: float
    names: tuple[str, ...]
    q: Array


class MessageTypes(NamedTuple):
    """Message classes, and what makes a float64[] of a list (rclpy: list, rosbags: np.array)."""

    trajectory: Callable[..., Any]
    point: Callable[..., Any]
    header: Callable[..., Any]
    time: Callable[..., Any]
    duration: Callable[..., Any]
    floats: Callable[[list[float]], Any]


def read_motion(path: Path | str) -> Trajectory:
    """Read the motion that `rgrasp plan --trajectory` wrote."""
    motion = json.loads(Path(path).read_text(encoding="utf-8"))
    times = [p["time_from_start"] for p in motion["points"]]
    return Trajectory(
        tuple(motion["joint_names"]),
        np.array([t["sec"] + 1e-9 * t["nanosec"] for t in times]),
        np.array([p["positions"] for p in motion["points"]], dtype=np.float64),
        np.array([p["velocities"] for p in motion["points"]], dtype=np.float64),
    )


def read_grasp(path: Path | str) -> Grasp:
    """Read a plan's grasp, with which its motion ends and its lift begins."""
    with h5py.File(path) as file:
        names = tuple(name.decode() for name in file["joint_names"][()])
        q = np.asarray(file["q"][()], dtype=np.float64)
        return Grasp(str(file.attrs["status"]), float(file.attrs["success_probability"]), names, q)


def read_lift(path: Path | str, speed: float) -> Trajectory | None:
    """Read a plan's lift, from rest to rest, no joint faster than `speed` [rad/s]; None if it has
    none."""
    with h5py.File(path) as file:
        names = tuple(name.decode() for name in file["joint_names"][()])
        lift = np.asarray(file["lift"][()], dtype=np.float64)
    if not len(lift):
        return None
    steps = np.abs(np.diff(lift, axis=0)).max(axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    # The share s of the way is 3 t² − 2 t³ at the share t of the time: its steepest slope is 1.5.
    t = np.linspace(0.0, 1.0, 1001)
    times = np.interp(way / way[-1], t * t * (3 - 2 * t), t) * 1.5 * way[-1] / speed
    velocities = np.gradient(lift, times, axis=0)
    velocities[[0, -1]] = 0.0
    return Trajectory(names, times, lift, velocities)


def read_hand(path: Path | str) -> tuple[tuple[str, ...], Hand]:
    """Read the arm's joints, and how the hand closes, from a robot's YAML and its URDF."""
    robot = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    urdf = ET.parse(Path(path).parent / robot["urdf"])
    speeds = {name: float(speed) for name, speed in robot["closing_joints"].items()}
    # The hardware moves joints that follow others.
    led = [joint for joint in urdf.iter("joint") if joint.find("mimic") is not None]
    followers = frozenset(joint.get("name", "") for joint in led)
    speeds = {name: speed for name, speed in speeds.items() if name not in followers}
    limits = {name: math.copysign(math.pi, speed) for name, speed in speeds.items()}
    for joint in urdf.iter("joint"):
        name, limit = joint.get("name"), joint.find("limit")
        if name in speeds and limit is not None and joint.get("type") != "continuous":
            limits[name] = float(limit.get("upper" if speeds[name] > 0 else "lower", 0.0))
    return tuple(robot["arm_joints"]), Hand(speeds, limits, followers)


def farthest_from(
    motion: Trajectory, point: int, measured: Mapping[str, float]
) -> tuple[str, float]:
    """The joint that is farthest from a point of the motion, and by how much [rad or m]."""
    there = zip(motion.names, motion.positions[point], strict=True)
    off = {name: abs(measured[name] - q) for name, q in there}
    return max(off.items(), key=lambda item: item[1])


def farthest_share(way: Trajectory, measured: Mapping[str, float]) -> float:
    """Largest share of its way from first to last point that a joint has gone: 0 at its start."""
    there = np.array([measured[name] for name in way.names])
    first, last = way.positions[0], way.positions[-1]
    moving = first != last
    return float(np.max((there - first)[moving] / (last - first)[moving], initial=0.0))


def apart(motion: Trajectory, grasp: Grasp) -> float:
    """Largest difference of a joint [rad or m] between the end of the motion and the grasp: 0 for
    the files of one plan."""
    return float(np.abs(motion.of(grasp.names).positions[-1] - grasp.q).max())


def closing(hand: Hand, names: Sequence[str], q: Sequence[float]) -> Trajectory:
    """Every closing joint from q [J] to its end at its own speed; the other joints stay."""
    start = np.asarray(q, dtype=np.float64)
    end, speed = start.copy(), np.zeros(len(start))
    for k, name in enumerate(names):
        if name in hand.speeds:
            end[k], speed[k] = hand.limits[name], abs(hand.speeds[name])
    span = np.where(speed > 0, np.abs(end - start), 0.0)
    needed = np.divide(span, speed, out=np.zeros_like(span), where=speed > 0)
    times = np.unique(np.concatenate([[0.0], needed]))
    travelled = np.minimum(times[:, None] * speed, span)
    return Trajectory(tuple(names), times, start + np.sign(end - start) * travelled)


def stalled(hand: Hand, velocities: Mapping[str, float], share: float = 0.1) -> bool:
    """Whether every closing joint is slower than this share of its closing speed."""
    return all(abs(velocities[name]) < share * abs(s) for name, s in hand.speeds.items())


def grip(
    hand: Hand, names: Sequence[str], q: Sequence[float], squeeze: float, time: float
) -> Trajectory:
    """Targets `squeeze` [rad or m] beyond q in the closing direction, so that the fingers press."""
    target = np.asarray(q, dtype=np.float64).copy()
    for k, name in enumerate(names):
        if name in hand.speeds:
            way = hand.limits[name] - target[k]
            target[k] += np.sign(way) * min(abs(way), squeeze)
    return Trajectory(tuple(names), np.array([time]), target[None])


def message(trajectory: Trajectory, types: MessageTypes) -> Any:
    """A JointTrajectory. A point at time 0 is left out: the robot is there already."""
    points = []
    for k, (time, positions) in enumerate(zip(trajectory.times, trajectory.positions, strict=True)):
        if time <= 0:
            continue
        speeds = [] if trajectory.velocities is None else trajectory.velocities[k]
        sec, nanosec = divmod(round(float(time) * 1e9), 10**9)
        points.append(
            types.point(
                positions=types.floats([float(p) for p in positions]),
                velocities=types.floats([float(v) for v in speeds]),
                accelerations=types.floats([]),
                effort=types.floats([]),
                time_from_start=types.duration(sec=sec, nanosec=nanosec),
            )
        )
    header = types.header(stamp=types.time(sec=0, nanosec=0), frame_id="")
    return types.trajectory(header=header, joint_names=list(trajectory.names), points=points)
