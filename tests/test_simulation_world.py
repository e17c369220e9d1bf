"""The physics world: falling, resting, sliding, collisions and joints behave as physics says."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import trimesh
from trial_worlds import can_grasp

from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.io.meshes import LoadedMesh
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.simulation.physics import PhysicsConfig
from pointsdf_cli.simulation.settle import REST_TIME, SPEED, settle
from pointsdf_cli.simulation.sim_object import SimObject, prepare_object
from pointsdf_cli.simulation.world import World

pytest.importorskip("pybullet")
GRIPPER = Path(__file__).parent / "robots" / "gripper.yaml"


def item_of(name: str, mesh: trimesh.Trimesh, cache: Path) -> SimObject:
    loaded = LoadedMesh(
        name, np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32), name, "none"
    )
    return prepare_object(loaded, cache)


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    with World(load_robot()) as opened:
        yield opened


@pytest.fixture
def box(tmp_path: Path) -> SimObject:
    return item_of("box", trimesh.creation.box([0.06, 0.06, 0.12]), tmp_path)


def test_falling_object_falls_as_galilei_says(world: World, box: SimObject) -> None:
    world.reset(box, transform(np.eye(3), [0.6, 0, 1.0]))
    dt = world.physics.step
    steps = round(0.25 / dt)
    world.step(steps)
    fallen = 1.0 - world.object.pose()[2, 3]
    # Bullet steps semi-implicitly, g t (t + dt) / 2, and damps a little.
    t = steps * dt
    assert fallen == pytest.approx(9.81 * t * (t + dt) / 2, rel=0.01)
    assert world.time == pytest.approx(t)


def test_a_push_accelerates_the_centre_and_turns_nothing(world: World, box: SimObject) -> None:
    """Newton: v = F t / m along the force, without gravity."""
    world.reset(box, transform(np.eye(3), [0.6, 0, 1.0]))
    world.set_gravity([0.0, 0.0, 0.0])
    force = np.array([0.0, 0.3, 0.4])
    for _ in range(round(0.1 / world.physics.step)):
        world.object.push(force)
        world.step()
    moved = world.object.pose()[:3, 3] - [0.6, 0, 1.0]
    speed, turning = world.object.speed()
    assert speed == pytest.approx(0.5 * 0.1 / box.mass, rel=0.01)
    assert turning < 1e-6
    np.testing.assert_allclose(moved / np.linalg.norm(moved), force / 0.5, atol=1e-6)
    # It acts during the steps it is given for, and no longer.
    world.step(10)
    assert world.object.speed()[0] == pytest.approx(speed, rel=0.01)


def test_standing_box_stays(world: World, box: SimObject) -> None:
    start = transform(np.eye(3), [0.6, 0.1, 0.06])
    world.reset(box, start)
    world.step(960)
    assert world.object_on_table()
    assert np.abs(world.object.pose() - start).max() < 2e-3
    assert world.object.speed()[0] < 1e-3
    assert world.robot_contact().links == 0


def test_what_leans_on_the_arm_is_not_in_the_hand(world: World, box: SimObject) -> None:
    world.reset(box, transform(np.eye(3), [0.0, 0.0, 0.35]))
    world.step(2)
    touching = world.robot_contact()
    assert touching.links > 0
    assert touching.hand_links == 0


def test_friction_holds_on_a_slope_below_its_angle_and_not_above(
    world: World, box: SimObject
) -> None:
    # Tilting gravity is tilting the table. μ = 0.6 · 0.8 = 0.48, that is 25.6°.
    for degrees, moves in ((15, False), (35, True)):
        lying = transform([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], [0.6, 0, 0.03])
        world.reset(box, lying)
        slope = np.deg2rad(degrees)
        world.set_gravity([0, 9.81 * np.sin(slope), -9.81 * np.cos(slope)])
        world.step(240)
        assert (world.object.pose()[1, 3] > 0.05) == moves


def test_mesh_frame_away_from_the_centre_of_mass_is_kept(world: World, tmp_path: Path) -> None:
    mesh = trimesh.creation.box([0.04, 0.06, 0.1])
    mesh.apply_translation([0.2, -0.1, 0.3])
    item = item_of("shifted", mesh, tmp_path)
    start = transform(np.eye(3), [0.4, 0.1, -0.25])
    world.reset(item, start)
    assert world.object.pose() == pytest.approx(start, abs=1e-6)
    assert world.object.centre() == pytest.approx([0.6, 0.0, 0.05], abs=1e-6)


def test_collisions_are_named(world: World, box: SimObject) -> None:
    robot = world.robot
    world.reset(box, transform(np.eye(3), [0.6, 0, 0.06]))
    assert world.collisions(robot.home) == set()
    down = robot.home.copy()
    down[1] = -1.9  # lean right over: the arm goes into the table
    assert "table" in world.collisions(down)
    folded = robot.home.copy()
    for name, value in (("thumb_joint_0", 1.396), ("thumb_joint_2", 1.2), ("thumb_joint_3", 1.2)):
        folded[robot.joint_names.index(name)] = value
    for name, value in (("index_joint_1", 1.5), ("index_joint_2", 1.5), ("index_joint_3", 1.0)):
        folded[robot.joint_names.index(name)] = value
    assert "self" in world.collisions(folded)


def test_what_is_shown_again_is_as_if_built_anew(box: SimObject, tmp_path: Path) -> None:
    ball = item_of("ball", trimesh.creation.icosphere(2, 0.04), tmp_path)
    robot = load_robot()
    reach = robot.home.copy()
    reach[1] = -1.9
    with World(robot) as fresh, World(robot) as kept:
        fresh.reset()
        tip = fresh.chain.palm(reach)[:3, 3]
        seen = []
        # Each twice, in an order in which the object only moves, changes, and is looked at before.
        for item in (box, box, ball, box):
            for place in (tip, [0.6, 0.4, 0.06], tip + [0.0, 0.12, 0.0]):
                T_world_object = transform(np.eye(3), place)
                kept.show(item, T_world_object)
                fresh.reset(item, T_world_object)
                assert np.array_equal(kept.object.pose(), fresh.object.pose())
                assert np.array_equal(kept.configuration(), fresh.configuration())
                for q in (reach, robot.home):
                    touched = kept.collisions(q)
                    assert touched == fresh.collisions(q)
                    seen.append("object" in touched)
        assert any(seen)
        assert not all(seen)
        # What physics has moved is built anew.
        kept.step(20)
        kept.show(box, transform(np.eye(3), [0.6, 0.0, 0.06]))
        assert kept.time == 0.0
        assert kept.configuration() == pytest.approx(robot.home, abs=1e-12)


def test_a_hand_rises_into_what_is_over_it_and_not_into_what_is_below_or_aside(
    world: World, box: SimObject
) -> None:
    q = can_grasp()
    world.reset(None, None, q, "hand")
    lows, highs = zip(
        *(world._bullet.getAABB(body, number) for body, number in world.joints.links.values()),
        strict=True,
    )
    low, high = np.min(lows, axis=0), np.max(highs, axis=0)
    x, y, top = *world.chain.palm(q)[:2, 3], 0.06
    for place, meets in (
        ([x, y, high[2] + 0.02 + top], True),  # the hand is under it
        ([x, y, low[2] - 0.01 - top], False),  # ... above it
        ([high[0] + 0.04, y, high[2] - 0.05], False),  # ... beside it, by 1 cm
        ([high[0] + 0.02, y, high[2] - 0.05], True),  # their boxes overlap
    ):
        world.reset(box, transform(np.eye(3), place), q, "hand")
        assert world.rises_into_object(0.005) is meets, place
    world.reset(box, transform(np.eye(3), [high[0] + 0.04, y, high[2] - 0.05]), q, "hand")
    assert world.rises_into_object(0.015)  # for a hand that moves aside on its way


def test_arm_holds_its_own_weight(world: World) -> None:
    q = world.robot.home
    world.reset(q=q)
    world.step(960)
    assert np.abs(world.configuration() - q).max() < 0.01


def test_can_that_is_stood_up_rests_standing(world: World, tmp_path: Path) -> None:
    item = item_of("can", trimesh.creation.cylinder(0.033, 0.1), tmp_path)
    standing = max(item.poses, key=lambda pose: pose.height if pose.margin > 0.17 else 0)
    pose = settle(world, item, standing)
    assert pose is not None
    assert abs(pose[2, 2]) == pytest.approx(1.0, abs=1e-3)
    assert pose[2, 3] == pytest.approx(0.05, abs=2e-3)


class Rocking:
    """A world whose object moves at given times only."""

    def __init__(self, moving: Callable[[float], bool]) -> None:
        self.physics, self.time, self.object = PhysicsConfig(), 0.0, self
        self._moving = moving

    def reset(self, *_: Any, **__: Any) -> None:
        self.time = 0.0

    def step(self, count: int) -> None:
        self.time += count * self.physics.step

    def speed(self) -> tuple[float, float]:
        return (2 * SPEED if self._moving(self.time) else 0.0), 0.0

    def object_on_table(self) -> bool:
        return True

    def pose(self) -> np.ndarray:
        return transform(np.eye(3), [0, 0, self.time])


def test_an_object_rests_after_a_quarter_of_a_second_without_a_move(box: SimObject) -> None:
    # It moves every 0.2 s until 1 s: the time at rest begins anew with each move.
    now: Any = Rocking(lambda t: t < 1.02 and round(t / 0.05) % 4 == 0)
    pose = settle(now, box, box.poses[0])
    assert pose is not None
    assert pose[2, 3] == pytest.approx(1.0 + REST_TIME, abs=0.06)
    assert settle(cast(Any, Rocking(lambda t: round(t / 0.05) % 4 == 0)), box, box.poses[0]) is None


def test_another_robot_needs_no_code(box: SimObject) -> None:
    with World(load_robot(GRIPPER)) as small:
        small.reset(box, transform(np.eye(3), [0.6, 0, 0.06]))
        assert small.collisions(small.robot.home) == set()
        small.step(10)
        assert len(small.configuration()) == 6


def test_a_world_that_nobody_holds_is_disconnected() -> None:
    """A planner that a server drops takes its physics client along."""
    world = World(load_robot())
    bullet, folder = world._bullet, world._folder
    assert bullet.getConnectionInfo()["isConnected"]
    assert folder.exists()
    del world
    gc.collect()
    assert not bullet.getConnectionInfo()["isConnected"]
    assert not folder.exists()


def test_reset_forgets_everything(box: SimObject) -> None:
    start = transform(np.eye(3), [0.6, 0, 0.3])
    ends = []
    with World(load_robot(), PhysicsConfig(iterations=30)) as one:
        for disturb in (0, 37, 111):
            one.reset(box, transform(np.eye(3), [0.55, 0.05, 0.2]))
            one.step(disturb)
            one.reset(box, start)
            one.step(200)
            ends.append(one.object.pose())
    assert np.array_equal(ends[0], ends[1])
    assert np.array_equal(ends[0], ends[2])


@pytest.mark.parametrize("per_second", [240, 480, 960])
def test_a_joint_takes_back_its_error_at_a_rate_that_the_step_does_not_change(
    per_second: int,
) -> None:
    # e^(−96 t) of the error is left, up to what a step can resolve: after 12.5 ms 0.6³, 0.8⁶ and
    # 0.9¹² of it.
    robot = load_robot()
    with World(robot, PhysicsConfig(step=1 / per_second)) as world:
        world.reset()
        q = robot.home.copy()
        q[6] += 0.02
        world.joints.drive_to(q, np.arange(len(q)), robot.effort)
        world.step(per_second // 80)
        left = (q[6] - world.configuration()[6]) / 0.02
    assert left == pytest.approx((1 - 96 / per_second) ** (per_second // 80), abs=0.02)
