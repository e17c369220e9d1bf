"""Distances to the table and between links, against a physics engine and against plain geometry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from pointsdf_cli.robot.collision import SelfCollision, table_clearance
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.simulation.bullet_urdf import bullet_urdf

GRIPPER = Path(__file__).parent / "robots" / "gripper.yaml"


def test_table_clearance_of_the_gripper_by_hand() -> None:
    robot = load_robot(GRIPPER)
    q = torch.tensor([[0.3, 0.0, -0.3, 0.0, 0.0, 0.0]], dtype=torch.float64)
    links, heights = table_clearance(robot, *Kinematics(robot)(q))
    by_link = dict(zip(links, heights[0].tolist(), strict=True))
    assert "rail" not in by_link  # it stands on the table
    assert by_link["carriage"] == pytest.approx(0.1 + 0.3 - 0.03)
    assert by_link["elbow"] == pytest.approx(0.1 + 0.3 + 0.08 - 0.03, abs=1e-6)
    assert by_link["wrist"] == pytest.approx(0.1 + 0.3 + 0.08)
    assert by_link["left"] == pytest.approx(0.7 - 0.01)


def test_self_distances_agree_with_pybullet(tmp_path: Path) -> None:
    bullet = pytest.importorskip("pybullet")
    robot = load_robot()
    rng = np.random.default_rng(4)
    q = rng.uniform(robot.hard_lower, robot.hard_upper, (60, len(robot.joint_names)))
    kinematics = Kinematics(robot)
    collision = SelfCollision(kinematics, spacing=0.004)
    ours = collision(*kinematics(torch.from_numpy(q))).numpy()
    client = bullet.connect(bullet.DIRECT)
    try:
        file = bullet_urdf(robot, tmp_path, 0.001)
        body = bullet.loadURDF(str(file), useFixedBase=True, physicsClientId=client)
        index = {robot.tree.links[0]: -1}
        joints = {}
        for i in range(bullet.getNumJoints(body, physicsClientId=client)):
            info = bullet.getJointInfo(body, i, physicsClientId=client)
            joints[info[1].decode()], index[info[12].decode()] = i, i
        compared = 0
        for k, configuration in enumerate(q):
            for name, value in zip(robot.joint_names, configuration, strict=True):
                bullet.resetJointState(body, joints[name], value, physicsClientId=client)
            for p, (a, b) in enumerate(collision.pairs):
                if ours[k, p] >= collision.exact_to:
                    continue
                close = bullet.getClosestPoints(
                    body, body, 0.05, index[a], index[b], physicsClientId=client
                )
                theirs = min((c[8] for c in close), default=0.05)
                if theirs > 0:
                    # Samples 4 mm apart never see the very nearest pair of points, so they are
                    # never closer; the engine rounds edges by less than a millimetre.
                    assert -1e-3 < ours[k, p] - theirs < 4e-3, (a, b)
                    compared += 1
                elif theirs < -3e-3:
                    assert ours[k, p] < 0, (a, b)
    finally:
        bullet.disconnect(client)
    assert compared > 50


def test_home_and_open_hand_are_free_and_a_folded_finger_is_not() -> None:
    robot = load_robot()
    kinematics = Kinematics(robot)
    collision = SelfCollision(kinematics)
    q = np.stack([robot.home, robot.home])
    # The thumb opposed and all joints of index and thumb closed: they meet.
    for name, value in (
        ("thumb_joint_0", 1.396),
        ("thumb_joint_2", 1.2),
        ("thumb_joint_3", 1.2),
        ("index_joint_1", 1.5),
        ("index_joint_2", 1.5),
        ("index_joint_3", 1.0),
    ):
        q[1, robot.joint_names.index(name)] = value
    free, folded = collision(*kinematics(torch.from_numpy(q))).amin(dim=1).tolist()
    assert free > 0
    assert folded < 0


def test_clearances_have_gradients() -> None:
    robot = load_robot()
    kinematics = Kinematics(robot)
    q = torch.from_numpy(robot.home.copy())[None].requires_grad_(True)
    _, heights = table_clearance(robot, *kinematics(q))
    (gradient,) = torch.autograd.grad(heights[0, -1], q)
    step = 1e-6
    moved = q.detach().clone()
    moved[0, 1] += step
    _, higher = table_clearance(robot, *kinematics(moved))
    slope = float(higher[0, -1] - heights[0, -1].detach()) / step
    assert float(gradient[0, 1]) == pytest.approx(slope, abs=1e-4)
    distance = SelfCollision(kinematics)(*kinematics(q))
    (gradient,) = torch.autograd.grad(distance.sum(), q)
    assert torch.isfinite(gradient).all()
