"""A small world of grasps with a known rule: balls on a table, held where the palm is near."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.io.grasps import LAYOUT, Grasps, GraspsMeta, write_grasps
from pointsdf_cli.robot.description import RobotDescription

REACH = 0.02
"""Held if the palm is closer to the ball than this [m]."""


def camera_pose(centre: np.ndarray, azimuth: float = np.pi, distance: float = 1.0) -> np.ndarray:
    """T_world_camera of a camera that looks at `centre` from 40 degrees above (z forward)."""
    up = np.deg2rad(40)
    away = np.array([np.cos(azimuth) * np.cos(up), np.sin(azimuth) * np.cos(up), np.sin(up)])
    z = -away
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return transform(np.stack([x, np.cross(z, x), z], axis=1), centre + distance * away)


def seen_ball(
    centre: np.ndarray, radius: float, pose: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """1000 points of the half of a ball that the camera sees, camera frame."""
    directions = rng.normal(size=(8000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = centre + radius * directions
    seen = ((pose[:3, 3] - points) * directions).sum(1) > 0
    return (points[seen][:1000] - pose[:3, 3]) @ pose[:3, :3]


def side_palm(centre: np.ndarray, gap: float, radius: float, azimuth: float) -> np.ndarray:
    """A palm level with the ball, thumb up, `gap` from its surface, looking along `azimuth`."""
    inward = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    rotation = np.stack([inward, up, np.cross(inward, up)], axis=1)
    return transform(rotation, centre - (radius + gap) * inward)


def top_palm(centre: np.ndarray, gap: float, radius: float, azimuth: float) -> np.ndarray:
    """A palm above the ball, fingers along `azimuth`."""
    fingers = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    inward = np.array([0.0, 0.0, -1.0])
    rotation = np.stack([inward, np.cross(fingers, inward), fingers], axis=1)
    return transform(rotation, centre - (radius + gap) * inward)


def write_balls(
    folder: Path,
    robot: RobotDescription,
    objects: int = 6,
    scenes: int = 2,
    each: int = 10,
    rule: bool = True,
) -> None:
    """One grasps file for each of several balls; every fourth is held out."""
    for number in range(objects):
        rng = np.random.default_rng([number, 5])
        radius = float(rng.uniform(0.03, 0.05))
        columns: dict[str, list[np.ndarray]] = {}

        def add(columns: dict[str, list[np.ndarray]] = columns, **values: object) -> None:
            for name, value in values.items():
                columns.setdefault(name, []).append(np.asarray(value))

        for scene in range(scenes):
            centre = np.array([rng.uniform(0.5, 0.7), rng.uniform(-0.1, 0.1), radius])
            pose = camera_pose(centre, np.pi + rng.uniform(-0.5, 0.5))
            cloud = seen_ball(centre, radius, pose, rng)
            for k in range(each):
                gap = float(rng.uniform(0.0, 2 * REACH))
                kind = k % 2
                palm = (side_palm, top_palm)[kind](centre, gap, radius, rng.uniform(0.5, 2.5))
                joints = rng.uniform(*robot.preshape_ranges.T)
                held = gap < REACH if rule else True
                add(
                    cloud=cloud,
                    T_world_camera=pose,
                    T_world_object=transform(np.eye(3), centre),
                    T_world_palm=palm,
                    q=robot.configuration(robot.home[robot.arm], joints),
                    label=1 if held else 0,
                    kind=kind,
                    cause=0 if held else 1,
                    lift_height=0.15 if held else 0.0,
                    slip=0.0,
                    attempt=scene * each + k,
                    scene=scene,
                    unshaken=-1,
                )
        # An attempt without a motion: nothing may be learned from it.
        for name, values in columns.items():
            values.append(values[-1] if name != "label" else np.asarray(-1))
        types = {"cloud": "f4", "label": "i1", "kind": "i1", "cause": "i1"}
        types |= {"lift_height": "f4", "slip": "f4", "attempt": "i4", "scene": "i4"}
        types |= {"unshaken": "i1"}
        grasps = Grasps(
            **{name: np.array(v).astype(types.get(name, "f8")) for name, v in columns.items()}
        )
        meta = GraspsMeta(
            f"ball{number}.ply",
            f"{number:064d}",
            "test" if number % 4 == 3 else "train",
            robot.name,
            robot.joint_names,
            robot.preshape_joints,
        )
        write_grasps(folder / "balls" / f"{number}.h5", grasps, meta, seed=0)


def assert_same_grasps(first: Grasps, second: Grasps) -> None:
    """Every array and all evidence is equal."""
    for name in LAYOUT:
        assert np.array_equal(getattr(first, name), getattr(second, name), equal_nan=True), name
    assert len(first.evidence) == len(second.evidence)
    for one, other in zip(first.evidence, second.evidence, strict=True):
        assert (one.visibility is None) == (other.visibility is None)
        if one.visibility is not None and other.visibility is not None:
            for a, b in zip(one.visibility, other.visibility, strict=True):
                assert np.array_equal(a, b)
        assert np.array_equal(one.support_plane, other.support_plane)
