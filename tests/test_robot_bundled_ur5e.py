"""The bundled UR5e with Robotiq 2F-85: its makers' numbers, its linkage, and what it lifts."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from can_attempts import causes_with_a_can

from pointsdf_cli.assets import asset_path
from pointsdf_cli.robot.check import check_robot
from pointsdf_cli.robot.closing import fingertips
from pointsdf_cli.robot.description import RobotDescription, load_robot
from pointsdf_cli.robot.jaws import jaws_of
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.simulation.world import World

ARM, BASE = 6, "robotiq_arg2f_base_link"


@pytest.fixture(scope="module")
def ur5e() -> RobotDescription:
    return load_robot("ur5e_2f85")


def poses(robot: RobotDescription, q: np.ndarray, *links: str) -> list[np.ndarray]:
    """T_world_link [4, 4] of links."""
    rotation, position = Kinematics(robot)(torch.from_numpy(robot.follow(q)))
    found = []
    for link in links:
        pose, k = np.eye(4), robot.tree.links.index(link)
        pose[:3, :3], pose[:3, 3] = rotation[k].numpy(), position[k].numpy()
        found.append(pose)
    return found


def test_forward_kinematics_are_those_of_the_dh_table(ur5e: RobotDescription) -> None:
    # d1 0.1625, a2 -0.425, a3 -0.3922, d4 0.1333, d5 0.0997, d6 0.0996 m; x and y of the maker's
    # base frame are turned by half a turn in its URDF.
    q = np.zeros(12)
    (wrist,) = poses(ur5e, q, "wrist_3_link")
    flat = [0.425 + 0.3922, 0.1333 + 0.0996, 0.1625 - 0.0997]
    assert wrist[:3, 3] == pytest.approx(flat, abs=1e-8)
    assert wrist[:3, 2] == pytest.approx([0, 1, 0], abs=1e-8)
    q[1] = -math.pi / 2  # upper arm and forearm straight up
    (wrist,) = poses(ur5e, q, "wrist_3_link")
    up = [0.0997, 0.1333 + 0.0996, 0.1625 + 0.425 + 0.3922]
    assert wrist[:3, 3] == pytest.approx(up, abs=1e-8)


def test_it_passes_its_check_and_its_speeds_are_the_makers(ur5e: RobotDescription) -> None:
    found = check_robot(ur5e)
    assert found.findings == ()
    assert found.reached > 0.95
    assert ur5e.velocity[:ARM] == pytest.approx([math.pi] * ARM)
    assert ur5e.effort[:ARM].tolist() == [150.0] * 3 + [28.0] * 3


def test_knuckles_that_cross_are_told_with_the_line_to_write(
    ur5e: RobotDescription, tmp_path: Path
) -> None:
    text = asset_path("robots/ur5e_2f85.yaml").read_text()
    text = text.replace(", [left_inner_knuckle, left_outer_knuckle]", "")
    (tmp_path / "robot.yaml").write_text(text.replace("urdf: ", f"urdf: {ur5e.urdf.parent}/"))
    (finding,) = check_robot(load_robot(tmp_path / "robot.yaml")).findings
    assert "left_outer_knuckle and left_inner_knuckle overlap" in finding.what
    assert "may_touch: [[left_outer_knuckle, left_inner_knuckle]]" in finding.fix


@pytest.mark.parametrize("angle", [0.0, 0.3, 0.6, 0.8])
def test_the_pads_stay_parallel_on_the_linkages_circle(
    ur5e: RobotDescription, angle: float
) -> None:
    q = ur5e.home.copy()
    q[ARM] = angle
    base, left, right = poses(ur5e, q, BASE, "left_inner_finger", "right_inner_finger")
    left, right = np.linalg.inv(base) @ left, np.linalg.inv(base) @ right
    assert left[:3, :3] == pytest.approx(np.diag([-1.0, -1.0, 1.0]), abs=1e-8)
    assert right[:3, :3] == pytest.approx(np.eye(3), abs=1e-8)
    # A crank from (30.6, 54.9) mm to (37.6, 43.0) mm beyond, turned inwards; the pad's face is
    # 25.2 mm inside of its pivot.
    sine, cosine = math.sin(angle), math.cos(angle)
    half = 0.0306011 + 0.0376 * cosine - 0.0430 * sine - 0.02202 - 0.00635 / 2
    face = right[1, 3] - 0.02202 - 0.00635 / 2
    assert face == pytest.approx(half, abs=1e-8)
    assert right[2, 3] == pytest.approx(0.054904 + 0.0376 * sine + 0.0430 * cosine, abs=1e-8)
    assert left[1, 3] == pytest.approx(-right[1, 3], abs=1e-8)


def test_inner_knuckles_are_no_fingertips(ur5e: RobotDescription) -> None:
    assert fingertips(ur5e) == ("left_inner_finger", "right_inner_finger")
    jaws = jaws_of(ur5e)
    assert jaws is not None
    assert jaws.opening == pytest.approx(0.086, abs=5e-4)  # 85 mm by the data sheet
    # The last 3.8 cm of fingers that stand 4.1 cm out of the palm.
    assert 0.003 < jaws.pads[0] < jaws.pads[1] < 0.0415


@pytest.mark.parametrize("there", ["whole", "hand"])
def test_the_simulated_linkage_moves_as_one(ur5e: RobotDescription, there: str) -> None:
    pytest.importorskip("pybullet")
    with World(ur5e) as world:
        world.reset(None, None, ur5e.home, there)
        columns = ur5e.closing_columns
        world.joints.drive_at(ur5e.closing_speeds, columns, ur5e.effort[columns])
        world.step(240)
        q = world.joints.state()[0]
    assert 0.15 < q[ARM] < 0.6
    assert q[ARM:] == pytest.approx(ur5e.follow(q)[ARM:], abs=0.01)


def test_it_lifts_a_can(ur5e: RobotDescription, tmp_path: Path) -> None:
    pytest.importorskip("pybullet")
    causes = causes_with_a_can(ur5e, 0.12, tmp_path)
    assert causes.count("held") >= 3, causes
