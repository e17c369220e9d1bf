"""Attempts: they replay, they are the same whoever makes them, and their labels are believable."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from grasp_worlds import assert_same_grasps, side_palm

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import apply_transform, invert_transform
from pointsdf_cli.io.grasps import (
    HELD,
    LOST,
    NO_CONFIGURATION,
    Grasps,
    GraspsMeta,
    read_grasps,
    write_grasps,
)
from pointsdf_cli.io.meshes import LoadedMesh, save_mesh
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.inverse_kinematics import InverseKinematics
from pointsdf_cli.simulation.attempt import (
    Attempt,
    AttemptConfig,
    ObservedScene,
    PlannedPreshape,
    as_grasps,
)
from pointsdf_cli.simulation.attempter import Attempter
from pointsdf_cli.simulation.collect import (
    CollectTask,
    collect_object,
    first_quotas,
    next_quotas,
    split_of,
)
from pointsdf_cli.simulation.film import Recorder
from pointsdf_cli.simulation.heuristic import SIDE, draw_preshape, hand_of
from pointsdf_cli.simulation.preshape_path import interpolate
from pointsdf_cli.simulation.sim_object import SimObject, prepare_object

pytest.importorskip("pybullet")


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


def item_of(name: str, mesh: trimesh.Trimesh, cache: Path) -> SimObject:
    loaded = LoadedMesh(
        name, np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32), name, "none"
    )
    return prepare_object(loaded, cache)


@pytest.fixture(scope="module")
def can(cache: Path) -> SimObject:
    return item_of("can", trimesh.creation.cylinder(0.03, 0.15), cache)


@pytest.fixture(scope="module")
def attempter() -> Iterator[Attempter]:
    made = Attempter(load_robot(), seed=1)
    yield made
    made.close()


def test_scene_shows_a_standing_object_where_it_says(attempter: Attempter, can: SimObject) -> None:
    scene = attempter.scene(can, 0)
    points = apply_transform(scene.T_world_camera, scene.cloud)
    local = apply_transform(invert_transform(scene.T_world_object), points)
    # Every segmented point lies on the can, within the camera's noise.
    radial = np.hypot(local[:, 0], local[:, 1])
    on_side = np.abs(radial - 0.03) < 0.005
    on_cap = (np.abs(np.abs(local[:, 2]) - 0.075) < 0.005) & (radial < 0.035)
    assert (on_side | on_cap).mean() > 0.99
    assert len(points) > 300


def test_attempts_do_not_depend_on_what_came_before(can: SimObject) -> None:
    first = Attempter(load_robot(), seed=1)
    second = Attempter(load_robot(), seed=1)
    try:
        run = [first.attempt(can, i) for i in range(4)]
        again = second.attempt(can, 3)
    finally:
        first.close()
        second.close()
    assert any(one.reach.label == 0 for one in run)
    one, two = as_grasps(run[3:]), as_grasps([again])
    for name in ("cloud", "T_world_object", "T_world_palm", "q", "label", "lift_height", "slip"):
        assert np.array_equal(getattr(one, name), getattr(two, name), equal_nan=True), name


def test_a_planner_proposes_for_a_scene_and_what_it_cannot_know_counts_as_lost(
    can: SimObject,
) -> None:
    robot = load_robot()
    inverse = InverseKinematics(robot)

    def propose(scene: ObservedScene, rng: np.random.Generator) -> list[PlannedPreshape]:
        """Palms from the side at two distances from the can's axis: in it, and right."""
        axis = scene.T_world_object[:3, 3]
        made = []
        for gap in (0.02, 0.10):
            palms = [side_palm(axis, gap, 0.0, turn) for turn in rng.uniform(-1.5, 1.5, 24)]
            found = inverse.solve(np.stack(palms))
            arm = found.arm[found.reached][0]
            q = robot.configuration(arm, robot.preshape_ranges.mean(axis=1))
            made.append(PlannedPreshape("side", inverse.chain.palm(q), q))
        return made

    made = Attempter(robot, seed=1, propose=propose)
    try:
        run = [made.attempt(can, i) for i in range(3)]
        again = made.attempt(can, 1)
    finally:
        made.close()
    inside, right, none = run
    assert (inside.cause, inside.label, inside.unshaken) == ("start_in_object", LOST, -1)
    assert right.outcome is not None
    assert right.label == again.label
    assert np.array_equal(right.reach.q, again.reach.q)
    assert (none.cause, none.label, none.unshaken) == ("no_plan", NO_CONFIGURATION, -1)
    stored = as_grasps(run)
    assert stored.executed.tolist() == [True, True, False]
    assert stored.simulated.tolist() == [False, True, False]
    assert np.isfinite(stored.T_world_palm).all()


def side_grasps(
    attempter: Attempter, item: SimObject, wanted: int, beside: float = 0.0
) -> tuple[int, int]:
    """Held and executed grasps from the side, well centred, or `beside` the object by so much."""
    config = replace(
        attempter.config.heuristic,
        side_standoff=0.05,
        standoff_noise=0.0,
        position_noise=0.0,
        turn_noise=0.0,
    )
    hand = hand_of(attempter.robot)
    held = executed = 0
    for i in range(30):
        scene = attempter.scene(item, i)
        points = apply_transform(scene.T_world_camera, scene.cloud)
        camera, rng = scene.T_world_camera[:3, 3], np.random.default_rng(i)
        preshape = draw_preshape(points, camera, np.zeros(3), hand, config, rng, SIDE)
        palm = preshape.T_world_palm.copy()
        palm[:3, 3] += beside * palm[:3, 2]
        attempter.checks.show(item, scene.T_world_object)
        reach = attempter._path_to(palm, preshape.joints)
        if reach.label != 0:
            continue
        outcome = attempter.execute(item, scene.T_world_object, reach.q, reach.lift)
        executed += 1
        held += outcome.held
        if executed == wanted:
            break
    return held, executed


def test_well_centred_side_grasps_hold_and_grasps_beside_do_not(
    attempter: Attempter, can: SimObject
) -> None:
    held, executed = side_grasps(attempter, can, 5)
    assert executed == 5
    assert held >= 4
    held, executed = side_grasps(attempter, can, 3, beside=-0.18)
    assert executed >= 1
    assert held == 0


def test_stored_grasps_replay_with_the_same_label(
    attempter: Attempter, can: SimObject, tmp_path: Path
) -> None:
    attempts = [attempter.attempt(can, i) for i in range(8)]
    grasps = as_grasps(attempts)
    joints = tuple(f"joint_{k}" for k in range(grasps.q.shape[1]))
    meta = GraspsMeta("can.ply", "hash", "train", "robot", joints, joints[:8])
    write_grasps(tmp_path / "can.h5", grasps, meta, seed=1)
    stored, kept = read_grasps(tmp_path / "can.h5")
    assert kept == meta
    assert_same_grasps(stored, grasps)
    # The camera saw the table around the can, and the table is what the can stands on.
    known = stored.evidence[0]
    assert known.visibility is not None
    assert np.isinf(known.visibility.free).mean() > 0.2
    up, camera = stored.T_world_camera[0][2, :3], stored.T_world_camera[0][2, 3]
    np.testing.assert_allclose(known.support_plane, [*up, -camera], atol=0.003)
    rows = np.flatnonzero(stored.executed)
    assert len(rows)
    for row in rows:
        outcome = attempter.replay(can, stored, int(row))
        assert (HELD if outcome.held else LOST) == stored.label[row]
        assert np.float32(outcome.lift_height) == stored.lift_height[row]
    blocked = np.flatnonzero(~stored.executed)
    with pytest.raises(InputError, match="never executed"):
        attempter.replay(can, stored, int(blocked[0]))


def test_watching_changes_nothing(attempter: Attempter, can: SimObject) -> None:
    attempts = (attempter.attempt(can, i) for i in range(20))
    attempt = next(attempt for attempt in attempts if attempt.outcome is not None)
    place, reach, recorder = attempt.scene.T_world_object, attempt.reach, Recorder()
    watched = attempter.execute(can, place, reach.q, reach.lift, recorder)
    assert watched == attempt.outcome
    last = {moment.phase: moment for moment in recorder.moments}
    assert last.keys() >= {"close", "grip", "lift"}
    assert last["grip"].time > last["close"].time


def test_executed_approach_is_free_of_collisions(attempter: Attempter, can: SimObject) -> None:
    for i in range(12):
        attempt = attempter.attempt(can, i)
        if attempt.outcome is None:
            continue
        path = attempt.reach.approach
        robot = attempter.robot
        assert path[0][robot.arm] == pytest.approx(robot.home[robot.arm])
        assert path[-1] == pytest.approx(attempt.reach.q)
        attempter.world.reset(can, attempt.scene.T_world_object)
        share = np.linspace(0, 1, 60)[:, None]
        for first, second in itertools.pairwise(path):
            for q in first + share * (second - first):
                assert not attempter.world.collisions(q, clearance=-1e-3)
        palm = attempter.world.chain.palm(attempt.reach.q)
        assert np.abs(palm - attempt.T_world_palm).max() < 2e-3
        return
    pytest.fail("no attempt was executed")


def test_too_large_for_the_hand_is_refused(attempter: Attempter, cache: Path) -> None:
    with pytest.raises(InputError, match="too large"):
        attempter.check(item_of("crate", trimesh.creation.box([0.3, 0.3, 0.3]), cache))


@pytest.fixture
def task(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> CollectTask:
    """To grasp a can three times, with nothing cut before."""
    monkeypatch.setenv("RGRASP_CACHE", str(tmp_path / "cache"))
    can = trimesh.creation.cylinder(0.03, 0.15)
    save_mesh(tmp_path / "can.ply", can.vertices, can.faces)
    out = tmp_path / "whole.h5"
    return CollectTask("can", tmp_path / "can.ply", out, 3, "train", AttemptConfig(), 2)


def test_collection_resumes_to_what_an_uninterrupted_one_makes(
    task: CollectTask, tmp_path: Path
) -> None:
    whole = task
    causes = collect_object(whole)
    assert causes is not None
    assert read_grasps(whole.out)[0].executed.sum() == 3
    assert collect_object(whole) is None
    part = replace(whole, out=tmp_path / "part.h5", quota=1)
    collect_object(part)
    collect_object(replace(part, quota=3))
    first, second = read_grasps(whole.out)[0], read_grasps(part.out)[0]
    assert_same_grasps(first, second)
    with pytest.raises(InputError, match="other options"):
        collect_object(replace(whole, seed=3))


def test_a_killed_collection_keeps_its_attempts(
    task: CollectTask, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, meta = collected(task)
    assert len(whole) > 3
    part = replace(task, out=tmp_path / "part.h5")
    honest, killed_at = Attempter.attempt, [3]
    made: list[int] = []

    def killed(self: Attempter, item: SimObject, index: int) -> Attempt:
        if index in killed_at:
            raise KeyboardInterrupt
        made.append(index)
        return honest(self, item, index)

    monkeypatch.setattr("pointsdf_cli.simulation.collect.ATTEMPTS_A_WRITE", 2, raising=False)
    monkeypatch.setattr(Attempter, "attempt", killed)
    with pytest.raises(KeyboardInterrupt):
        collect_object(part)
    kept, there = read_grasps(part.out)
    assert (len(kept), there.complete) == (2, False)
    killed_at.clear()
    resumed, there = collected(part)
    assert made == [0, 1, 2, *range(2, len(whole))]
    assert there == meta
    assert_same_grasps(resumed, whole)
    assert collect_object(part) is None


def test_a_mesh_in_millimetres_is_the_same_object(task: CollectTask, tmp_path: Path) -> None:
    metres, _ = collected(replace(task, quota=1))
    can = trimesh.creation.cylinder(30, 150)
    save_mesh(tmp_path / "large.ply", can.vertices, can.faces)
    large = replace(task, mesh=tmp_path / "large.ply", out=tmp_path / "mm.h5", quota=1, unit="mm")
    with pytest.raises(InputError, match="150 m"):
        collect_object(replace(large, unit="m"))
    millimetres, _ = collected(large)
    np.testing.assert_array_equal(millimetres.label, metres.label)
    np.testing.assert_allclose(millimetres.cloud, metres.cloud, atol=1e-3)
    # Read in another unit it would be another object: what is there is not continued so.
    with pytest.raises(InputError):
        collect_object(replace(large, unit="cm"))


def collected(task: CollectTask) -> tuple[Grasps, GraspsMeta]:
    collect_object(task)
    return read_grasps(task.out)


def test_an_object_that_is_not_seen_again_keeps_what_it_gave(
    task: CollectTask, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    honest = Attempter.attempt

    def from_the_sixth_on_unseen(self: Attempter, item: SimObject, index: int) -> Attempt:
        if index >= 5:
            raise InputError("is not seen by the camera")
        return honest(self, item, index)

    monkeypatch.setattr(Attempter, "attempt", from_the_sixth_on_unseen)
    task = replace(task, quota=40)
    causes = collect_object(task)
    assert causes is not None
    assert sum(causes.values()) == 5
    assert collect_object(task) is None  # nothing more to have, and nothing is lost
    parts = replace(task, out=tmp_path / "parts.h5", quota=1)
    collect_object(parts)
    collect_object(replace(parts, quota=40))
    assert_same_grasps(read_grasps(task.out)[0], read_grasps(parts.out)[0])
    monkeypatch.setattr(Attempter, "attempt", lambda *_: (_ for _ in ()).throw(InputError("no")))
    with pytest.raises(InputError, match="no"):  # never seen at all: it is refused
        collect_object(replace(task, out=tmp_path / "none.h5"))


def test_sliding_joints_are_looked_at_as_finely_as_turning_ones() -> None:
    path = np.array([[0.0, 0.0], [0.2, 0.005], [0.2, 0.1]])
    dense = interpolate(path, np.array([0.05, 0.01]))
    steps = np.abs(np.diff(dense, axis=0))
    assert steps[:, 0].max() <= 0.05 + 1e-12
    assert steps[:, 1].max() <= 0.01 + 1e-12
    assert len(dense) == 1 + 4 + 10


def test_quotas_make_the_papers_counts_and_make_up_for_the_weak() -> None:
    names = [f"object{i:03d}" for i in range(100)]
    splits = split_of(names, 0)
    assert sum(split == "test" for split in splits.values()) == 20
    assert splits == split_of(names[::-1], 0)
    quotas = first_quotas(splits, 9111)
    held_out = sum(quotas[n] for n in names if splits[n] == "test")
    assert (sum(quotas.values()) - held_out, held_out) == (7290, 1821)
    wanted = {"train": 7290, "test": 1821}
    executed = dict(quotas)
    weak = next(n for n in names if splits[n] == "train")
    executed[weak] = 5
    more = next_quotas(quotas, executed, splits, wanted)
    assert more is not None
    assert more[weak] == quotas[weak]
    assert sum(more.values()) - sum(quotas.values()) == quotas[weak] - 5
    # Asked again after the others gave more, the same is wanted of them.
    assert next_quotas(quotas, more | {weak: 5}, splits, wanted) == more
    assert next_quotas(more, more | {weak: 5}, splits, wanted) is None
    assert next_quotas(quotas, {}, splits, wanted) is None
    # What the first quotas did not ask at all is asked where the others give too little.
    few, none = {"a": 1, "b": 0}, {"train": 1, "test": 0}
    both = {"a": "train", "b": "train"}
    assert next_quotas(few, {}, both, none) == {"a": 1, "b": 1}
    assert next_quotas({"a": 1, "b": 1}, {"b": 1}, both, none) is None
