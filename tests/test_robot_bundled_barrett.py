"""The bundled BarrettHand: its maker's numbers, and that it closes around things and lifts them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from can_attempts import causes_with_a_can

from pointsdf_cli.robot.check import check_robot
from pointsdf_cli.robot.closing import closing_of
from pointsdf_cli.robot.description import RobotDescription, load_robot
from pointsdf_cli.robot.jaws import jaws_of
from pointsdf_cli.robot.kinematics import Kinematics

HEIGHT, BASE, FINGER, TIP = 0.0754, 0.050, 0.070, 0.049
"""Finger joints above the flange; A1, A2, and A3 up to the middle of the ball at its end [m]."""


@pytest.fixture(scope="module")
def barrett() -> RobotDescription:
    return load_robot("lbr4_barrett")


def tip_in_palm(robot: RobotDescription, name: str, joints: tuple[float, float]) -> np.ndarray:
    """Middle of the ball at a fingertip's end, in the palm link's frame, for a finger's joints."""
    q = robot.home.copy()
    for part, value in zip(("link", "tip"), joints, strict=True):
        q[robot.joint_names.index(f"{name}_{part}_joint")] = value
    rotation, position = Kinematics(robot)(torch.from_numpy(q))
    palm, tip = (robot.tree.links.index(link) for link in ("barrett_palm", f"{name}_tip"))
    place = position[tip] + rotation[tip] @ torch.tensor([TIP, 0.0, 0.0], dtype=torch.float64)
    return (rotation[palm].T @ (place - position[palm])).numpy()


@pytest.mark.parametrize(
    ("name", "side", "y"), [("left", -1, 0.025), ("right", -1, -0.025), ("middle", 1, 0.0)]
)
def test_fingers_are_where_the_makers_table_has_them(
    barrett: RobotDescription, name: str, side: int, y: float
) -> None:
    bend = math.radians(42)
    flat = [side * (BASE + FINGER + TIP * math.cos(bend)), y, HEIGHT + TIP * math.sin(bend)]
    assert tip_in_palm(barrett, name, (0, 0)) == pytest.approx(flat, abs=1e-6)
    # The finger straight up, its tip bent inwards by 42° and 48° more: level, towards the middle.
    level = [side * (BASE - TIP), y, HEIGHT + FINGER]
    assert tip_in_palm(barrett, name, (math.pi / 2, math.radians(48))) == pytest.approx(
        level, abs=1e-6
    )


def test_ranges_are_the_makers_and_the_description_passes_its_check(
    barrett: RobotDescription,
) -> None:
    degrees = np.degrees(barrett.hard_upper[7:])
    assert degrees == pytest.approx([140, 48] * 3)
    assert (barrett.hard_lower[7:] == 0).all()
    assert check_robot(barrett).findings == ()


def test_it_closes_from_both_sides(barrett: RobotDescription) -> None:
    jaws = jaws_of(barrett)
    assert jaws is not None
    assert 0.12 < jaws.opening < 0.25
    ends = closing_of(barrett).paths[-1]
    assert (np.abs(ends[:, 2]) < 0.03).all()  # all three over the palm's middle
    assert (ends[:, 0] > 0).all()


def test_it_lifts_a_can(barrett: RobotDescription, tmp_path: Path) -> None:
    pytest.importorskip("pybullet")
    causes = causes_with_a_can(barrett, 0.15, tmp_path)
    assert causes.count("held") >= 2, causes
