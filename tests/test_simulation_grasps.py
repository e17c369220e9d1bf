"""Whole grasps whose outcome is known beforehand: centred ones hold, those beside do not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.io.meshes import LoadedMesh
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.simulation.attempt import AttemptConfig
from pointsdf_cli.simulation.attempter import Attempter
from pointsdf_cli.simulation.executor import PUSH_TIME, SQUEEZE, Executor, ExecutorConfig
from pointsdf_cli.simulation.film import Recorder
from pointsdf_cli.simulation.physics import GRAVITY
from pointsdf_cli.simulation.sim_object import SimObject, prepare_object
from pointsdf_cli.simulation.verdict import UNTRIED, Outcome, Seen, cause_of
from pointsdf_cli.simulation.world import World

pytest.importorskip("pybullet")

PALM = (0.52, 0.03, 0.09)
"""Where the palm is in every test here [m], level, thumb up, the fingers along -y: one inverse
kinematics for all. The opened hand reaches 7 cm below it."""
REACH = 0.03
"""How far along the fingers an object's middle is put [m]."""
FLOATING = 0.09
"""Height [m] of a ball that floats until the hand has closed: on the table the hand, 11 cm wide,
cannot be centred on a ball that fits it."""
SHAPES = {
    "can 5 cm": (trimesh.creation.cylinder(0.025, 0.14), 0.025),
    "can 6.4 cm": (trimesh.creation.cylinder(0.032, 0.14), 0.032),
    "can 8 cm": (trimesh.creation.cylinder(0.04, 0.16), 0.04),
    "box 4 x 5 cm": (trimesh.creation.box([0.04, 0.05, 0.15]), 0.02),
    "box 6 x 4 cm": (trimesh.creation.box([0.06, 0.04, 0.16]), 0.03),
    "box 7 x 7 cm": (trimesh.creation.box([0.07, 0.07, 0.14]), 0.035),
    "ball 7 cm": (trimesh.creation.icosphere(3, 0.035), 0.035),
    "ball 8.4 cm": (trimesh.creation.icosphere(3, 0.042), 0.042),
    "ball 10 cm": (trimesh.creation.icosphere(3, 0.05), 0.05),
}
"""A mesh, and how far its near face is from its middle [m]."""
UNDER = 0.2
"""Height [m] of what the hand is put under; its thumb is lower."""
CREEP = 0.005
"""Farthest that an object at rest may move in the hand in 5 s [m]."""
GAPS, TURNS = (0.02, 0.04), (0.0, 0.1)
"""From the palm to the near face [m]; of the object about the vertical [rad]."""


@dataclass(frozen=True)
class Grip:
    """A hand that is about to close: the configuration [J] and the lift [K, A]."""

    q: np.ndarray
    lift: np.ndarray


@pytest.fixture(scope="module")
def attempter() -> Iterator[Attempter]:
    made = Attempter(load_robot(), AttemptConfig())
    yield made
    made.close()


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


def item_of(name: str, mesh: trimesh.Trimesh, cache: Path) -> SimObject:
    loaded = LoadedMesh(
        name, np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32), name, "none"
    )
    return prepare_object(loaded, cache)


@pytest.fixture(scope="module")
def grip(attempter: Attempter) -> Grip:
    """An open hand by hand: fingers straight and parallel, thumb across."""
    values = {"thumb_joint_0": 1.35, "thumb_joint_1": 0.5}
    joints = np.array([values.get(name, 0.0) for name in attempter.robot.preshape_joints])
    palm = transform(np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]), PALM)
    attempter.checks.reset()
    reach = attempter._path_to(palm, joints)
    assert reach.label == 0
    return Grip(reach.q, reach.lift)


def beside_the_palm(
    item: SimObject, ahead: float, along: float = REACH, turn: float = 0.0, floats: bool = False
) -> np.ndarray:
    """Where the object is: its middle so far out of the palm and along the fingers [m]."""
    c, s = np.cos(turn), np.sin(turn)
    height = FLOATING if floats else -float(item.mesh.vertices[:, 2].min())
    place = [PALM[0] + ahead, PALM[1] - along, height]
    return transform(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), place)


def float_till_closed(world: World, phase: str) -> None:
    """No weight while the hand closes."""
    world.set_gravity([0.0, 0.0, 0.0 if phase == "close" else -GRAVITY])


def test_centred_side_grasps_of_balls_boxes_and_cylinders_hold(
    attempter: Attempter, grip: Grip, cache: Path
) -> None:
    outcomes: dict[str, list[str]] = {}
    for name, (mesh, depth) in SHAPES.items():
        item = item_of(name, mesh, cache)
        floats = name.startswith("ball")
        watch = float_till_closed if floats else None
        for gap in GAPS:
            for turn in TURNS if name.startswith("box") else TURNS[:1]:
                place = beside_the_palm(item, gap + depth, turn=turn, floats=floats)
                outcome = attempter.execute(item, place, grip.q, grip.lift, watch)
                outcomes.setdefault(name.split()[0], []).append(outcome.cause)
    for kind, causes in outcomes.items():
        assert len(causes) >= 6
        assert causes.count("held") >= 0.8 * len(causes), (kind, outcomes)


def test_the_whole_arm_does_what_the_hand_alone_does(
    attempter: Attempter, grip: Grip, cache: Path
) -> None:
    whole = Attempter(load_robot(), AttemptConfig().with_the_whole_arm())
    try:
        for name, along, cause in (
            ("can 6.4 cm", REACH, "held"),
            ("box 6 x 4 cm", REACH, "held"),
            ("can 5 cm", 0.24, "missed"),
        ):
            mesh, depth = SHAPES[name]
            item = item_of(name, mesh, cache)
            place = beside_the_palm(item, 0.02 + depth, along)
            hand, arm = (one.execute(item, place, grip.q, grip.lift) for one in (attempter, whole))
            assert hand.cause == arm.cause == cause, name
            # The simulated arm gives way a little under the weight.
            assert hand.lift_height == pytest.approx(arm.lift_height, abs=0.006), name
    finally:
        whole.close()


@pytest.mark.parametrize("name", ["can 5 cm", "box 7 x 7 cm"])
@pytest.mark.parametrize(
    ("ahead", "along"),
    [(0.05, 0.24), (0.0, 0.24), (0.22, REACH), (0.18, 0.2)],
    ids=["past the fingertips", "past them, level with the palm", "too far ahead", "both"],
)
def test_hand_that_closes_beside_the_object_never_counts(
    attempter: Attempter, grip: Grip, cache: Path, name: str, ahead: float, along: float
) -> None:
    item = item_of(name, SHAPES[name][0], cache)
    place = beside_the_palm(item, ahead, along)
    recorder = Recorder()
    outcome = attempter.execute(item, place, grip.q, grip.lift, recorder)
    assert outcome.valid
    assert not outcome.held
    assert outcome.cause == "missed"
    assert abs(outcome.lift_height) < 0.005
    assert outcome.links == 0
    # A hand that cannot meet the object on its way up is not lifted.
    assert {moment.phase for moment in recorder.moments} == {"close", "grip"}


def test_a_stalled_finger_closes_on_when_its_way_is_free(
    attempter: Attempter, grip: Grip, cache: Path
) -> None:
    """A fixed can stops the fingers for half a second; then it is gone."""
    mesh, depth = SHAPES["can 8 cm"]
    item = item_of("can 8 cm", mesh, cache)
    place, away = beside_the_palm(item, 0.03 + depth), beside_the_palm(item, 0.3)
    columns = attempter.robot.closing_columns

    def closed(blocked: float) -> tuple[np.ndarray, np.ndarray]:
        """Closing joints when the can goes, and at the end."""
        courses = []

        def watch(world: World, phase: str) -> None:
            if phase == "close":
                world.object.place(place if world.time < blocked else away)
                courses.append((world.time, world.configuration()[columns]))

        attempter.execute(item, away, grip.q, grip.lift, watch)
        return min(courses, key=lambda one: abs(one[0] - 0.5))[1], courses[-1][1]

    then, end = closed(blocked=0.5)
    stalled = closed(blocked=0.0)[0] - then > 0.2
    assert stalled.sum() >= 3
    assert ((end - then)[stalled] > 0.2).all()


def test_a_hand_under_the_object_is_lifted_into_it(
    attempter: Attempter, grip: Grip, cache: Path
) -> None:
    """A board on two posts over the hand, which touches nothing until it rises."""
    board = trimesh.creation.box([0.4, 0.1, 0.02])
    board.apply_translation([0, 0, 0.01 + UNDER])
    posts = [trimesh.creation.box([0.02, 0.1, UNDER]) for _ in range(2)]
    for post, side in zip(posts, (-1, 1), strict=True):
        post.apply_translation([side * 0.19, 0, UNDER / 2])
    item = item_of("bridge", trimesh.boolean.union([board, *posts], engine="manifold"), cache)
    recorder = Recorder()
    place = beside_the_palm(item, 0.05)
    outcome = attempter.execute(item, place, grip.q, grip.lift, recorder)
    assert outcome.valid
    heights = [moment.T_world_object[2, 3] for moment in recorder.moments]
    gripped = [moment for moment in recorder.moments if moment.phase == "grip"]
    assert abs(gripped[-1].T_world_object[2, 3] - heights[0]) < 1e-3
    assert max(heights) > heights[0] + 0.02


def test_object_that_is_shot_out_is_invalid(attempter: Attempter, grip: Grip, cache: Path) -> None:
    """A grasp that holds, but for the object leaving the hand at 4 m/s, as bad contacts do it."""
    mesh, depth = SHAPES["can 5 cm"]
    item = item_of("can", mesh, cache)
    place = beside_the_palm(item, 0.03 + depth)
    assert attempter.execute(item, place, grip.q, grip.lift).cause == "held"
    shot = []

    def shoot(world: World, phase: str) -> None:
        if phase == "lift" and not shot:
            shot.append(True)
            body = world._object_body
            out_of_the_hand = [0.9, 0.0, 0.3]
            world._bullet.resetBasePositionAndOrientation(body, out_of_the_hand, [0, 0, 0, 1])
            world._bullet.resetBaseVelocity(body, [4.0, 0.0, 0.0])

    outcome = attempter.execute(item, place, grip.q, grip.lift, shoot)
    assert shot
    assert outcome.cause == "flung"
    assert not outcome.valid
    assert not outcome.held


def test_object_that_ends_inside_a_link_is_invalid(
    attempter: Attempter, grip: Grip, cache: Path
) -> None:
    mesh, depth = SHAPES["can 5 cm"]
    item = item_of("can", mesh, cache)

    def press_in(world: World, phase: str) -> None:
        """The can's axis at the palm's face, so that the palm lies 2 cm deep in it."""
        if phase == "settle":
            palm = world.palm_pose()
            world._bullet.resetBasePositionAndOrientation(
                world._object_body, palm[:3, 3].tolist(), [0, 0, 0, 1]
            )
            world._bullet.performCollisionDetection()

    place = beside_the_palm(item, 0.03 + depth)
    outcome = attempter.execute(item, place, grip.q, grip.lift, press_in)
    assert not outcome.valid
    assert not outcome.held
    assert outcome.cause in ("penetration", "flung")


def carried_out(attempter: Attempter, item: SimObject, grip: Grip, **settings: float) -> Outcome:
    """A grasp of the can of 6.4 cm with other settings of the execution."""
    kept = attempter.config
    attempter.config = replace(kept, execution=replace(kept.execution, **settings))
    try:
        place = beside_the_palm(item, 0.03 + SHAPES["can 6.4 cm"][1])
        return attempter.execute(item, place, grip.q, grip.lift)
    finally:
        attempter.config = kept


def test_a_firm_grasp_withstands_small_pushes_and_a_great_one_takes_the_can_away(
    attempter: Attempter, grip: Grip, cache: Path
) -> None:
    can = replace(item_of("can", SHAPES["can 6.4 cm"][0], cache), mass=0.2)
    alone = carried_out(attempter, can, grip)
    assert (alone.lifted, alone.held, alone.unshaken, alone.lost_in) == (True, True, UNTRIED, "")
    small = carried_out(attempter, can, grip, push=0.5)
    assert (small.held, small.unshaken, small.lost_in) == (True, 1, "")
    assert small.duration == pytest.approx(alone.duration + 6 * PUSH_TIME, abs=0.01)
    great = carried_out(attempter, can, grip, push=100.0)
    assert (great.held, great.unshaken, great.lost_in) == (True, 0, "push +x")
    # Pushes come after the verdict that labels count: it is the same with and without them.
    for other in (small, great):
        assert replace(other, unshaken=UNTRIED, lost_in="", duration=alone.duration) == alone


def test_what_slides_out_in_the_hold_was_lifted_and_is_not_held(
    attempter: Attempter, grip: Grip, cache: Path
) -> None:
    """Fingers that open once the object rests in them, as a slow slip would end."""
    can = replace(item_of("can", SHAPES["can 6.4 cm"][0], cache), mass=0.2)

    def let_go(world: World, phase: str) -> None:
        if phase == "hold":
            robot = world.robot
            speeds = -robot.closing_speeds * 8
            world.joints.drive_at(
                speeds, robot.closing_columns, robot.effort[robot.closing_columns]
            )

    place = beside_the_palm(can, 0.03 + SHAPES["can 6.4 cm"][1])
    kept = attempter.config
    attempter.config = replace(kept, execution=replace(kept.execution, hold=2.0, push=2.5))
    try:
        outcome = attempter.execute(can, place, grip.q, grip.lift, let_go)
    finally:
        attempter.config = kept
    assert (outcome.lifted, outcome.held, outcome.unshaken) == (True, False, 0)
    assert outcome.lost_in == "hold"
    assert outcome.cause in ("dropped", "slipped")
    assert outcome.valid


def test_weak_fingers_lose_what_strong_ones_hold(
    attempter: Attempter, grip: Grip, cache: Path
) -> None:
    mesh, depth = SHAPES["can 6.4 cm"]
    item = replace(item_of("can", mesh, cache), mass=0.6)
    place = beside_the_palm(item, 0.03 + depth)
    assert attempter.execute(item, place, grip.q, grip.lift).held
    weak = ExecutorConfig(closing_effort=0.01, grip_effort=0.01)
    kept, attempter.config = attempter.config, replace(attempter.config, execution=weak)
    try:
        assert not attempter.execute(item, place, grip.q, grip.lift).held
    finally:
        attempter.config = kept


def test_fingers_do_not_push_an_object_through_the_hand(
    attempter: Attempter, grip: Grip, cache: Path
) -> None:
    """After the grip no finger closes farther than `SQUEEZE`, so what rests stays at rest."""
    mesh, depth = SHAPES["can 8 cm"]
    item = item_of("can", mesh, cache)
    joints: dict[str, list[np.ndarray]] = {"grip": [], "hold": []}
    places: list[np.ndarray] = []

    def note(world: World, phase: str) -> None:
        if phase in joints:
            joints[phase].append(world.configuration()[world.robot.closing_columns])
        if phase == "hold":
            places.append(world.object.centre())

    place = beside_the_palm(item, 0.03 + depth)
    kept = attempter.config
    attempter.config = replace(kept, execution=replace(kept.execution, hold=5.0))
    try:
        outcome = attempter.execute(item, place, grip.q, grip.lift, note)
    finally:
        attempter.config = kept
    assert outcome.held, outcome
    assert np.max(np.array(joints["hold"]) - joints["grip"][-1]) < SQUEEZE + 0.01
    assert np.linalg.norm(places[-1] - places[0]) < CREEP


def test_what_still_touches_the_table_is_not_held() -> None:
    # 12 cm of a lift of 15 cm: more than 0.7 of it.
    seen = Seen(rise=0.12, hand_links=2, depth=0.0, on_table=False, fastest=0.1)
    assert cause_of(seen, 0.15, True) == "held"
    assert cause_of(replace(seen, on_table=True), 0.15, True) == "slipped"


def test_an_object_is_shaken_out_of_the_hand(attempter: Attempter, grip: Grip, cache: Path) -> None:
    mesh, depth = SHAPES["can 6.4 cm"]
    item = replace(item_of("can", mesh, cache), mass=0.6)
    place = beside_the_palm(item, 0.03 + depth)
    kept = attempter.config
    attempter.config = replace(kept, execution=ExecutorConfig(shake=100.0))
    try:
        assert not attempter.execute(item, place, grip.q, grip.lift).held
    finally:
        attempter.config = kept


def test_shaking_pulls_along_x_and_then_along_y() -> None:
    pulls: list[list[float]] = []
    executor = Executor.__new__(Executor)
    physics = SimpleNamespace(step=1 / 240)
    executor._world = SimpleNamespace(  # type: ignore[assignment]
        physics=physics, set_gravity=lambda g: pulls.append([float(v) for v in g])
    )
    executor._config = ExecutorConfig(shake=3.0)
    executor._advance = executor._wait = lambda *_: None  # type: ignore[method-assign, assignment]
    executor._shake()
    # 4 Hz at 240 steps a second: a quarter of a period is 15 steps.
    np.testing.assert_allclose(pulls[15], [3, 0, -GRAVITY], atol=1e-9)
    np.testing.assert_allclose(pulls[120 + 15], [0, 3, -GRAVITY], atol=1e-9)
    assert pulls[-1] == [0, 0, -GRAVITY]
