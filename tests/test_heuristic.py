"""The heuristic planner's faces and palms, against a box whose faces are known."""

from __future__ import annotations

import numpy as np
import pytest

from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.simulation.heuristic import (
    LOW_OBJECT,
    SIDE,
    TABLE_GAP,
    TOP,
    TOP_STANDOFF,
    Hand,
    HeuristicConfig,
    draw_preshape,
    graspable_faces,
    hand_of,
    upright_box,
)

QUIET = HeuristicConfig(standoff_noise=0.0, position_noise=0.0, turn_noise=0.0)
CAMERA, BASE = np.array([1.6, 0.0, 0.6]), np.zeros(3)


def box_cloud(yaw: float = 0.0, size: tuple[float, float, float] = (0.06, 0.1, 0.2)) -> np.ndarray:
    """A grid on all faces of a box that stands at (0.6, 0, 0), turned by yaw."""
    line = np.linspace(-0.5, 0.5, 9)
    grid = np.stack(np.meshgrid(line, line, line), -1).reshape(-1, 3)
    shell = grid[np.abs(grid).max(axis=1) > 0.49] * size
    c, s = np.cos(yaw), np.sin(yaw)
    return shell @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + (0.6, 0.0, size[2] / 2)


def point_hand() -> Hand:
    """A hand that takes no room, so that nothing is raised above the table."""
    return Hand(np.zeros((8, 2)), lambda joints: np.zeros((1, 3)))


@pytest.mark.parametrize("yaw", [0.0, 0.3, -0.7])
def test_box_is_found_whatever_its_yaw(yaw: float) -> None:
    box = upright_box(box_cloud(yaw))
    assert sorted(2 * box.half) == pytest.approx([0.06, 0.1, 0.2], abs=1e-9)
    assert box.centre == pytest.approx([0.6, 0, 0.1], abs=1e-9)
    along = box.axes[int(np.argmax(box.half[:2]))]
    assert abs(along @ [-np.sin(yaw), np.cos(yaw), 0]) == pytest.approx(1.0, abs=1e-9)


def test_top_and_two_sides_remain_between_camera_and_robot() -> None:
    faces = graspable_faces(upright_box(box_cloud()), CAMERA, BASE, LOW_OBJECT)
    assert [face.kind for face in faces] == [TOP, SIDE, SIDE]
    normals = sorted(tuple(np.round(face.normal, 6) + 0.0) for face in faces[1:])
    assert normals == [(0.0, -1.0, 0.0), (0.0, 1.0, 0.0)]


def test_low_object_is_grasped_from_the_top_only() -> None:
    flat = box_cloud(size=(0.06, 0.1, 0.025))
    faces = graspable_faces(upright_box(flat), CAMERA, BASE, LOW_OBJECT)
    assert [face.kind for face in faces] == [TOP]


def test_side_palm_faces_the_object_thumb_up_at_its_standoff() -> None:
    rng = np.random.default_rng(0)
    for _ in range(10):
        preshape = draw_preshape(box_cloud(), CAMERA, BASE, point_hand(), QUIET, rng, SIDE)
        palm = preshape.T_world_palm
        assert preshape.kind == SIDE
        side = np.sign(palm[1, 3])
        assert palm[:3, 0] == pytest.approx([0, -side, 0], abs=1e-9)
        assert palm[:3, 1] == pytest.approx([0, 0, 1], abs=1e-9)
        assert abs(palm[1, 3]) == pytest.approx(0.05 + QUIET.side_standoff, abs=1e-9)
        # The object's middle lies along the fingers, where they close.
        local = palm[:3, :3].T @ (np.array([0.6, 0, 0.1]) - palm[:3, 3])
        assert local == pytest.approx([0.05 + QUIET.side_standoff, 0, QUIET.finger_reach], abs=1e-9)


def test_top_palm_looks_down_with_fingers_along_a_diagonal_away_from_the_robot() -> None:
    rng = np.random.default_rng(1)
    for _ in range(10):
        preshape = draw_preshape(box_cloud(), CAMERA, BASE, point_hand(), QUIET, rng, TOP)
        palm = preshape.T_world_palm
        assert palm[:3, 0] == pytest.approx([0, 0, -1], abs=1e-9)
        assert palm[2, 3] == pytest.approx(0.2 + TOP_STANDOFF, abs=1e-9)
        fingers = palm[:3, 2]
        assert np.abs(fingers) == pytest.approx([0.5**0.5, 0.5**0.5, 0], abs=1e-9)
        assert fingers[0] > 0


def test_side_hand_stays_above_the_table() -> None:
    robot = load_robot()
    hand = hand_of(robot)
    rng = np.random.default_rng(2)
    low = box_cloud(size=(0.06, 0.1, 0.05))
    for _ in range(5):
        preshape = draw_preshape(low, CAMERA, BASE, hand, QUIET, rng, SIDE)
        outline = hand.outline(preshape.joints) @ preshape.T_world_palm[:3, :3].T
        lowest = (outline + preshape.T_world_palm[:3, 3])[:, 2].min()
        assert lowest == pytest.approx(TABLE_GAP, abs=1e-9)


def test_above_a_flat_object_a_hand_rises_over_it_but_not_beside_it() -> None:
    # A box of 2.5 cm; the palm's x looks down, so a point at x = 0.1 is that far below the palm.
    flat = box_cloud(size=(0.06, 0.1, 0.025))
    heights = {}
    for name, y in (("over", 0.0), ("beside", 0.1)):
        points = np.array([[0.1, y, QUIET.finger_reach]])
        hand = Hand(np.zeros((8, 2)), lambda joints, points=points: points)
        palm = draw_preshape(flat, CAMERA, BASE, hand, QUIET, np.random.default_rng(0)).T_world_palm
        heights[name] = palm[2, 3]
    assert heights["over"] == pytest.approx(0.1 + 0.025 + TABLE_GAP)
    assert heights["beside"] == pytest.approx(0.1 + TABLE_GAP)
    high = box_cloud(size=(0.06, 0.1, 0.05))
    hand = Hand(np.zeros((8, 2)), lambda joints: np.array([[0.1, 0.0, 0.0]]))
    palm = draw_preshape(high, CAMERA, BASE, hand, QUIET, np.random.default_rng(0), "top")
    assert palm.T_world_palm[2, 3] == pytest.approx(0.05 + TOP_STANDOFF)


def test_noise_has_the_deviations_that_it_says() -> None:
    rng = np.random.default_rng(3)
    # Three deviations from touching, so nothing is cut off.
    config = HeuristicConfig(side_standoff=0.09)
    distances, shifts = [], []
    for _ in range(400):
        palm = draw_preshape(
            box_cloud(), CAMERA, BASE, point_hand(), config, rng, SIDE
        ).T_world_palm
        distances.append(abs(palm[1, 3]) - 0.05)
        shifts.append(palm[2, 3] - 0.1)
    assert np.mean(distances) == pytest.approx(0.09, abs=0.006)
    assert np.std(distances) == pytest.approx(0.03, abs=0.005)
    assert np.std(shifts) == pytest.approx(0.005, abs=0.001)


def test_preshape_joints_stay_in_their_ranges() -> None:
    robot = load_robot()
    hand = hand_of(robot)
    rng = np.random.default_rng(4)
    joints = np.array(
        [draw_preshape(box_cloud(), CAMERA, BASE, hand, QUIET, rng).joints for _ in range(50)]
    )
    assert (joints >= robot.preshape_ranges[:, 0]).all()
    assert (joints <= robot.preshape_ranges[:, 1]).all()
    assert (np.ptp(joints, axis=0) > 0.5 * np.ptp(robot.preshape_ranges, axis=1)).all()


def test_equal_seeds_draw_equal_preshapes() -> None:
    first, second = (
        draw_preshape(box_cloud(), CAMERA, BASE, point_hand(), HeuristicConfig(), r)
        for r in (np.random.default_rng(5), np.random.default_rng(5))
    )
    assert np.array_equal(first.T_world_palm, second.T_world_palm)
