"""Plans made by hand, for tests that read plan files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pointsdf_cli.io.plans import Plan, RejectedSeeds, write_plan
from pointsdf_cli.robot.description import RobotDescription


def turning_plan(robot: RobotDescription, steps: int = 11, turn: float = 1.0) -> Plan:
    """The robot at home turns its first joint by `turn` rad within two seconds."""
    trajectory = np.repeat(robot.home[None], steps, axis=0)
    trajectory[:, 0] += np.linspace(0, turn, steps)
    links = tuple(link for link in robot.tree.links if robot.tree.shapes[link])
    joints = len(robot.joint_names)
    return Plan(
        status="ok",
        reason="",
        sentence="",
        joint_names=robot.joint_names,
        q=trajectory[-1],
        trajectory=trajectory,
        times=np.linspace(0, 2, steps),
        T_world_palm=np.eye(4),
        success_probability=0.75,
        objective=1.5,
        seeds_tried=8,
        timings={"field": 0.1, "solve": 0.25, "configuration": 0.6, "motion": 0.3},
        link_names=links,
        link_clearance_object=np.linspace(0.001, 0.3, len(links)),
        link_clearance_table=np.full(len(links), 0.05),
        rejected=RejectedSeeds(
            q=np.zeros((2, joints)),
            reasons=("object_collision", "motion"),
            success_probability=np.array([0.7, 0.65]),
            objective=np.array([2.0, 3.0]),
            slack=np.array([[-0.004, 0.1, np.inf, 0.02], [0.001, 0.1, np.inf, 0.02]]),
        ),
        kind="side",
    )


def turning_plan_file(folder: Path, robot: RobotDescription) -> Path:
    """`turning_plan` as a file."""
    path = folder / "plan.h5"
    write_plan(path, turning_plan(robot), seed=0)
    return path
