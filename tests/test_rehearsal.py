"""Rehearsals: a good grasp of a can holds in them, a palm in the air does not; lifts go up."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from trial_worlds import CAN_AT, can_grasp, can_in_world

from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.robot import lift as lift_module
from pointsdf_cli.robot.arm_chain import ArmChain
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.lift import lift_path
from pointsdf_cli.simulation.mass import DENSITY
from pointsdf_cli.simulation.rehearsal import (
    Rehearsal,
    Rehearsed,
    believed_object,
    best_first,
)
from pointsdf_cli.simulation.world import World

pytest.importorskip("pybullet")


@pytest.fixture(scope="module")
def rehearsal() -> Iterator[Rehearsal]:
    made = Rehearsal(load_robot(), repeats=3)
    yield made
    made.close()


@pytest.fixture(scope="module")
def grasp() -> NDArray[np.float64]:
    return can_grasp()


def test_the_believed_can_weighs_and_turns_like_a_cylinder() -> None:
    can = can_in_world()
    item = believed_object(can.vertices, can.faces)
    mass = DENSITY * np.pi * 0.03**2 * 0.15
    assert item.mass == pytest.approx(mass, rel=0.05)
    np.testing.assert_allclose(item.T_mesh_body[:3, 3], [*CAN_AT, 0.075], atol=2e-3)
    along, across = mass * 0.03**2 / 2, mass * (3 * 0.03**2 + 0.15**2) / 12
    np.testing.assert_allclose(np.sort(item.inertia), [along, across, across], rtol=0.15)


def test_what_hovers_over_the_table_is_put_down() -> None:
    can = can_in_world()
    can.apply_translation([0, 0, 0.006])
    item = believed_object(can.vertices, can.faces)
    lowest = min((item.T_mesh_body[2, :3] @ corners.T).min() for corners, _ in item.pieces) + float(
        item.T_mesh_body[2, 3]
    )
    assert lowest == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("height", [-0.02, 0.0, 0.03])
def test_the_believed_can_stands_on_its_table(rehearsal: Rehearsal, height: float) -> None:
    can = can_in_world()
    can.apply_translation([0, 0, height])
    item = believed_object(can.vertices, can.faces, height)
    world = World(load_robot())
    world.table_height = height
    world.reset(item, np.eye(4), robot="none")
    stood = world.object_centre()
    world.step(240)
    np.testing.assert_allclose(world.object_centre(), stood, atol=1e-3)
    world.close()


def test_a_flat_object_keeps_a_body() -> None:
    sheet = trimesh.creation.box([0.15, 0.07, 0.009])
    sheet.apply_translation([0.6, 0, 0.0045])
    item = believed_object(sheet.vertices, sheet.faces)
    corners = np.concatenate([corners for corners, _ in item.pieces])
    heights = corners @ item.T_mesh_body[2, :3] + item.T_mesh_body[2, 3]
    assert heights.min() == pytest.approx(0.0, abs=1e-9)
    assert heights.max() == pytest.approx(0.009, abs=1e-6)


def test_a_good_grasp_holds_and_a_palm_in_the_air_does_not(
    rehearsal: Rehearsal, grasp: NDArray[np.float64]
) -> None:
    can = can_in_world()
    away = can_grasp(shift=(-0.05, -0.1, 0.05))
    likely = np.array([0.6, 0.6])
    tried = rehearsal(can.vertices, can.faces, np.stack([away, grasp]), likely, seed=0)
    assert tried[1] == (3, 3, pytest.approx(0.15, abs=0.02))
    assert tried[0][:2] == (1, 0)
    assert best_first(tried, likely, [1.0, 1.0]) == [1, 0]
    assert rehearsal(can.vertices, can.faces, np.stack([away, grasp]), likely, seed=0) == tried
    # What cannot become better than the best before is not tried.
    tried = rehearsal(can.vertices, can.faces, np.stack([grasp, grasp]), [0.6, 0.5], seed=0)
    assert [one.tries for one in tried] == [3, 0]
    tried = rehearsal(can.vertices, can.faces, np.stack([grasp, grasp]), [0.5, 0.6], seed=0)
    assert [one.tries for one in tried] == [3, 3]


def test_order_prefers_many_tries_and_keeps_equals() -> None:
    once, often, never, unable = (
        Rehearsed(1, 1, 0.15),
        Rehearsed(5, 5, 0.15),
        Rehearsed(5, 0, 0.0),
        Rehearsed(0, 0, 0.0),
    )
    equal, sure = [0.6] * 4, [1.0] * 4
    assert best_first([unable, never, once, often], equal, sure) == [3, 2, 1, 0]
    assert best_first([once, once], equal, sure) == [0, 1]
    # A reconstruction that is hardly right at the contacts.
    assert best_first([often, once], equal, [0.5, 1.0]) == [1, 0]
    assert best_first([often, never], equal, [0.8, 1.0]) == [0, 1]
    # The network counts, too: it knows contacts that a rehearsal only guesses.
    assert best_first([often, never], [0.2, 0.9], sure) == [1, 0]
    assert often.chance(0.6) > often.chance(0.3) > never.chance(0.3)
    assert 0.0 < never.chance(0.0) < often.chance(1.0) < 1.0


def test_the_lift_is_straight_and_keeps_the_palm(grasp: NDArray[np.float64]) -> None:
    robot = load_robot()
    chain = ArmChain(robot)
    path = lift_path(chain, grasp, 0.15)
    assert path is not None
    rotation, position, _ = chain.palm_and_jacobian(path)
    np.testing.assert_allclose(
        position[:, :2], position[0, :2] + np.zeros((len(path), 2)), atol=3e-3
    )
    np.testing.assert_allclose(position[-1, 2] - position[0, 2], 0.15, atol=3e-3)
    np.testing.assert_allclose(rotation[-1], rotation[0], atol=0.01)
    assert np.abs(np.diff(path, axis=0)).max() < 0.3
    assert (path >= robot.lower[robot.arm] - 1e-9).all()
    assert (path <= robot.upper[robot.arm] + 1e-9).all()


def test_near_the_robot_the_palm_moves_outwards_as_it_rises() -> None:
    robot = load_robot()
    chain = ArmChain(robot)
    path = lift_path(chain, can_grasp(shift=(-0.08, 0.0, 0.0)), 0.15)
    assert path is not None
    rotation, position, _ = chain.palm_and_jacobian(path)
    np.testing.assert_allclose(position[-1, 2] - position[0, 2], 0.15, atol=3e-3)
    assert 0.04 < position[-1, 0] - position[0, 0] < 0.11
    np.testing.assert_allclose(rotation[-1], rotation[0], atol=0.01)


def test_there_is_no_lift_out_of_reach(grasp: NDArray[np.float64]) -> None:
    robot = load_robot()
    assert lift_path(ArmChain(robot), grasp, 3.0) is None


@pytest.mark.filterwarnings("error::RuntimeWarning")  # a line of a library's on the terminal
def test_a_surface_below_the_table_cannot_be_rehearsed_on(rehearsal: Rehearsal) -> None:
    from pointsdf_cli.errors import InputError

    sunk = trimesh.creation.box((0.1, 0.1, 0.1))
    sunk.apply_translation([0.6, 0, -0.2])
    with pytest.raises(InputError, match="above the table"):
        rehearsal(sunk.vertices, sunk.faces, np.zeros((1, 23)), np.zeros(1))


def test_a_lift_leads_away_from_where_the_robot_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    ways: list[NDArray[np.float64]] = []

    def nowhere(chain: object, arm: object, poses: NDArray[np.float64], config: object) -> object:
        ways.append(poses[0, -1, :3, 3] - palm[:3, 3])
        return np.zeros((1, 16, 1)), np.array([0])

    monkeypatch.setattr(lift_module, "follow", nowhere)
    palm, base = transform(np.eye(3), [0.6, 0, 0.3]), transform(np.eye(3), [1.2, 0, 0])
    robot = SimpleNamespace(arm=slice(0, 1), T_world_base=base)
    chain = SimpleNamespace(robot=robot, palm=lambda q: palm)
    assert lift_path(chain, np.zeros(1)) is None  # type: ignore[arg-type]
    # Straight up first, then outwards: the robot stands on the far side.
    np.testing.assert_allclose(ways[0], [0, 0, 0.15], atol=1e-12)
    np.testing.assert_allclose(ways[1], [-0.05, 0, 0.15], atol=1e-12)
