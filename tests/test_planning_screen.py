"""The first look at drawn grasps: the hand alone, lifted out of the table, and in the object."""

from __future__ import annotations

import numpy as np
import torch
from planning_worlds import SphereField

from pointsdf_cli.planning.screen import HandOutline, depth_in, lifted, narrowest
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.robot.surface import robot_surface

ROBOT = load_robot()
KINEMATICS = Kinematics(ROBOT)
OUTLINE = HandOutline(KINEMATICS)
MIDDLE = ROBOT.preshape_ranges.mean(axis=1)


def test_the_outline_moves_with_the_palm() -> None:
    """At any arm configuration the hand's surface is the outline carried by the palm."""
    rng = np.random.default_rng(0)
    arm = rng.uniform(ROBOT.lower[ROBOT.arm], ROBOT.upper[ROBOT.arm])
    q = torch.from_numpy(ROBOT.configuration(arm, MIDDLE))
    surface = robot_surface(ROBOT, 0.015)
    links = [(link, torch.tensor(surface[link])) for link in ROBOT.hand_links if link in surface]
    points = torch.cat(KINEMATICS.points(q, links)).numpy()
    palm = KINEMATICS.palm(q).numpy()
    carried = OUTLINE(MIDDLE[None])[0] @ palm[:3, :3].T + palm[:3, 3]
    np.testing.assert_allclose(carried, points, atol=1e-9)


def test_hands_in_the_table_are_lifted_and_others_stay() -> None:
    outline = OUTLINE(np.tile(MIDDLE, (2, 1)))
    palm = np.tile(np.eye(4), (2, 1, 1))
    palm[:, :3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]  # palm down
    palm[:, 2, 3] = 0.05, 0.9
    raised = lifted(outline, palm, 0.004)
    lowest = (outline[0] @ raised[0, 2, :3]).min() + raised[0, 2, 3]
    np.testing.assert_allclose(lowest, 0.004, atol=1e-12)
    np.testing.assert_array_equal(raised[1], palm[1])
    np.testing.assert_array_equal(raised[:, :2], palm[:, :2])


def test_depth_is_that_of_the_deepest_point() -> None:
    outline = OUTLINE(np.tile(MIDDLE, (2, 1)))
    palm = np.tile(np.eye(4), (2, 1, 1))
    palm[1, 0, 3] = 5.0
    centre = outline[0, 7]
    depth = depth_in(SphereField(0.03, tuple(centre)), outline, palm)
    np.testing.assert_allclose(depth, [0.03, 0.0], atol=1e-9)


def test_the_narrowest_width_does_not_depend_on_yaw() -> None:
    box = np.array([[x, y, z] for x in (0, 0.3) for y in (0, 0.1) for z in (0, 0.2)])
    c, s = np.cos(0.6981317), np.sin(0.6981317)  # 40 degrees, a multiple of the step
    turned = box @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    for points in (box, turned):
        np.testing.assert_allclose(narrowest(points), 0.1, atol=1e-6)
    np.testing.assert_allclose(narrowest(box * [1, 1, 0.1]), 0.02, atol=1e-9)


def test_the_hand_spans_more_than_its_palm() -> None:
    # The Allegro's palm is 11 cm wide and its fingers reach 15 cm beyond.
    assert 0.15 < OUTLINE.span < 0.3
