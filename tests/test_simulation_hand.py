"""The hand alone is where the whole arm would have it, moves as it would, and touches the same."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.io.meshes import LoadedMesh
from pointsdf_cli.robot.cartesian_path import FollowConfig, follow, straight
from pointsdf_cli.robot.description import RobotDescription, load_robot
from pointsdf_cli.robot.inverse_kinematics import InverseKinematics
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.simulation.sim_object import prepare_object
from pointsdf_cli.simulation.world import World

pytest.importorskip("pybullet")
GRIPPER = Path(__file__).parent / "robots" / "gripper.yaml"


@pytest.fixture(scope="module", params=[None, GRIPPER], ids=["lbr4_allegro", "gripper"])
def world(request: pytest.FixtureRequest) -> Iterator[World]:
    with World(load_robot(request.param)) as opened:
        yield opened


def anywhere(robot: RobotDescription, count: int) -> np.ndarray:
    return np.random.default_rng(3).uniform(robot.lower, robot.upper, (count, len(robot.lower)))


def hand_in_bullet(world: World) -> dict[str, tuple[np.ndarray, float]]:
    """Place and quaternion [7] and mass of every link of the hand."""
    bullet = world._bullet
    found = {}
    for name in world.robot.hand_links:
        body, link = world.joints.links[name]
        state = bullet.getLinkState(body, link, computeForwardKinematics=True)
        turn = np.array(state[5]) * np.sign(state[5][np.argmax(np.abs(state[5]))])
        mass = bullet.getDynamicsInfo(body, link)[0]
        found[name] = np.array([*state[4], *turn]), mass
    return found


def test_every_link_of_the_hand_is_where_the_whole_arm_has_it(world: World) -> None:
    for q in anywhere(world.robot, 8):
        world.reset(q=q, robot="whole")
        whole = hand_in_bullet(world)
        world.reset(q=q, robot="hand")
        hand = hand_in_bullet(world)
        assert world.configuration() == pytest.approx(q, abs=1e-12)
        for name, (pose, mass) in whole.items():
            assert hand[name][0] == pytest.approx(pose, abs=1e-6), name
            assert hand[name][1] == pytest.approx(mass), name


def test_of_the_arm_only_the_flange_is_there(world: World) -> None:
    world.reset(robot="hand")
    robot = world.robot
    flange = {"lbr4_link_7"} if "lbr4_link_7" in robot.tree.links else set()
    here = set(robot.tree.links) & set(world.joints.links)
    assert here == set(robot.hand_links) | flange


def test_it_is_placed_as_the_whole_arm_is(world: World) -> None:
    start, there = anywhere(world.robot, 2)
    world.reset(q=there, robot="hand")
    expected = hand_in_bullet(world)
    world.reset(q=start, robot="hand")
    world.joints.place(there)
    for name, (pose, _) in hand_in_bullet(world).items():
        assert pose == pytest.approx(expected[name][0], abs=1e-9), name


def test_it_touches_itself_where_the_whole_arm_does(world: World) -> None:
    robot = world.robot
    q = anywhere(robot, 60)
    q[:, robot.arm] = robot.home[robot.arm]
    world.reset(robot="whole")
    # The same links of the hand: what the arm touches besides is not the hand's.
    whole = [world.collisions(one) & {"self"} for one in q]
    world.reset(robot="hand")
    hand = [world.collisions(one) & {"self"} for one in q]
    assert hand == whole
    if len(robot.hand_joints) > 2:
        assert 3 < sum("self" in one for one in hand) < 57


def test_a_hand_that_is_not_driven_stays(world: World) -> None:
    """Links that overlap by design do not push each other away, and nothing sags."""
    robot = world.robot
    q = robot.home.copy()
    world.reset(q=q, robot="hand")
    world.step(240)
    assert world.configuration() == pytest.approx(q, abs=2e-3)
    assert np.abs(world.joints.state()[1]).max() < 2e-3


def palm_height(world: World) -> float:
    return float(hand_in_bullet(world)[world.robot.palm_link][0][2])


def path_of(robot: RobotDescription, steps: int) -> np.ndarray:
    """From home [A] to 0.2 rad or m off in every joint, [K, A]."""
    s = np.linspace(0, 1, steps + 1)[1:, None]
    return robot.home[robot.arm] + 0.2 * s * np.where(robot.home[robot.arm] > 0, -1, 1)


def test_it_follows_the_arms_path_and_stands_at_its_end(world: World) -> None:
    robot = world.robot
    arm = path_of(robot, 120)
    q = np.tile(robot.home, (len(arm), 1))
    q[:, robot.arm] = arm
    with torch.no_grad():
        poses = Kinematics(robot).palm(torch.from_numpy(q)).numpy()
    palms = poses @ np.linalg.inv(robot.T_link_palm)
    world.reset(q=robot.home, robot="hand")
    for k, _ in enumerate(world.joints.follow(arm)):
        world.step()
        if k % 40 == 39:
            found = hand_in_bullet(world)[robot.palm_link][0]
            assert found[:3] == pytest.approx(palms[k, :3, 3], abs=1e-5)
    end = hand_in_bullet(world)
    world.step(100)
    for name, (pose, _) in hand_in_bullet(world).items():
        assert pose[:3] == pytest.approx(end[name][0][:3], abs=1e-3), name
    world.reset(q=q[-1], robot="whole")
    whole = hand_in_bullet(world)
    for name, (pose, _) in end.items():
        # The fingers give way a little to a palm that turns.
        assert pose[:3] == pytest.approx(whole[name][0][:3], abs=3e-3), name


def test_a_path_that_is_left_early_leaves_the_hand_at_rest(world: World) -> None:
    robot = world.robot
    world.reset(q=robot.home, robot="hand")
    steps = world.joints.follow(path_of(robot, 120))
    for _ in range(30):
        next(steps)
        world.step()
    steps.close()
    before = palm_height(world)
    world.step(100)
    assert palm_height(world) == pytest.approx(before, abs=1e-9)


def test_what_lies_on_the_palm_rides_with_it(tmp_path: Path) -> None:
    """Contacts know how fast the palm moves: friction takes a box along, as a tray would."""
    robot = load_robot()
    solver = InverseKinematics(robot)
    # The palm's x upward, its fingers along the world's y.
    start = transform(np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]), [0.55, -0.05, 0.5])
    solved = solver.solve(start)
    arm = solved.arm[0][solved.reached[0]][:1]
    poses = straight(start, [[0, 0.1, 0]], 240)
    path, reached = follow(solver.chain, arm, poses, FollowConfig(1e-4, 1e-3, jump=0.1))
    assert reached[0] == 240
    q = robot.home.copy()
    q[robot.arm] = arm[0]
    box = trimesh.creation.box((0.05, 0.05, 0.02))
    item = prepare_object(
        LoadedMesh("box", box.vertices, box.faces.astype(np.int32), "box", "none"), tmp_path
    )
    with World(robot) as world:
        world.reset(item, transform(np.eye(3), [0.55, -0.07, 0.53]), q, "hand")
        world.step(240)
        before = world.object.pose()[:3, 3]
        assert world.robot_contact().hand_links > 0
        for _ in world.joints.follow(path[0, 1:]):
            world.step()
        after = world.object.pose()[:3, 3]
        assert after - before == pytest.approx([0.0, 0.1, 0.0], abs=0.01)
        assert world.robot_contact().hand_links > 0


def test_it_says_what_it_touches(tmp_path: Path) -> None:
    robot = load_robot()
    solved = InverseKinematics(robot).solve(
        transform(np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), [0.6, 0.0, 0.01])
    )
    assert solved.any.all()
    q = robot.home.copy()
    q[robot.arm] = solved.arm[0][solved.reached[0]][0]
    ball = trimesh.creation.icosphere(2, 0.02)
    item = prepare_object(
        LoadedMesh("ball", ball.vertices, ball.faces.astype(np.int32), "ball", "none"), tmp_path
    )
    with World(robot) as world:
        for there in ("whole", "hand"):
            world.reset(item, transform(np.eye(3), [0.6, 0.0, 0.01]), robot.home, there)
            assert world.collisions(robot.home) == set()
            assert {"table", "object"} <= world.collisions(q)
