"""A robot from a public package, described by the YAML of docs/your-robot.md alone, grasps."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from doc_blocks import blocks
from planning_worlds import AroundObject, CylinderField, NearPalm

from pointsdf_cli.planning.plan_artifact import plan_of
from pointsdf_cli.planning.planner import Planner, PlannerConfig
from pointsdf_cli.planning.seeds import SeedConfig
from pointsdf_cli.planning.synthesis import SynthesisConfig
from pointsdf_cli.planning.target import Target
from pointsdf_cli.robot.check import check_robot
from pointsdf_cli.robot.description import RobotDescription, load_robot
from pointsdf_cli.robot.jaws import jaws_of
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.simulation.heuristic import HeuristicConfig, draw_preshape, hand_of

PAGE = Path(__file__).resolve().parents[1] / "docs" / "your-robot.md"
YAML = next(block.text for block in blocks(PAGE) if block.language == "yaml")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    data = pytest.importorskip("pybullet_data", reason="PyBullet's robots are not installed")
    folder = tmp_path_factory.mktemp("robots") / "panda"
    shutil.copytree(Path(data.getDataPath()) / "franka_panda", folder)
    (folder / "panda.yaml").write_text(YAML, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def panda(folder: Path) -> RobotDescription:
    return load_robot(folder / "panda.yaml")


def test_the_description_of_the_page_passes_its_check(panda: RobotDescription) -> None:
    found = check_robot(panda)
    assert found.findings == ()
    # The jaws slide 4 cm each; their preshape is open by 3.75 cm.
    assert found.closing.nearer == pytest.approx(
        {"panda_finger_joint1": 0.0375, "panda_finger_joint2": 0.0375}, abs=1e-3
    )
    assert found.farthest <= 0.01


def test_a_closed_gripper_at_home_is_told_with_the_line_that_allows_it(folder: Path) -> None:
    text = YAML.replace(", 0.04, 0.04]", "]").split("# The fingertips touch")[0]
    (folder / "closed.yaml").write_text(text, encoding="utf-8")
    (error,) = check_robot(load_robot(folder / "closed.yaml")).findings
    assert error.level == "error"
    assert "may_touch: [[panda_leftfinger, panda_rightfinger]]" in error.fix


def test_links_that_fixed_joints_make_one_body_are_not_checked(panda: RobotDescription) -> None:
    # Flange and hand are two fixed joints apart, across a link without shape.
    pairs = {frozenset(pair) for pair in panda.checked_pairs}
    assert frozenset(("panda_link7", "panda_hand")) not in pairs
    assert frozenset(("panda_link5", "panda_hand")) in pairs


def test_a_palm_frame_between_the_fingertips_is_the_same(
    folder: Path, panda: RobotDescription
) -> None:
    text = YAML.replace(
        "link: panda_hand, xyz: [0, 0, 0.067]", "link: panda_grasptarget, xyz: [0, 0, -0.038]"
    )
    assert text != YAML
    (folder / "leaf.yaml").write_text(text, encoding="utf-8")
    leaf = load_robot(folder / "leaf.yaml")
    assert leaf.hand_links == panda.hand_links
    assert np.allclose(leaf.T_link_palm, panda.T_link_palm)


def test_forward_kinematics_agree_with_pybullet(panda: RobotDescription) -> None:
    bullet = pytest.importorskip("pybullet")
    client = bullet.connect(bullet.DIRECT)
    try:
        body = bullet.loadURDF(str(panda.urdf), useFixedBase=True, physicsClientId=client)
        count = bullet.getNumJoints(body, physicsClientId=client)
        infos = [bullet.getJointInfo(body, i, physicsClientId=client) for i in range(count)]
        index = {info[1].decode(): i for i, info in enumerate(infos)}
        rng = np.random.default_rng(0)
        for q in rng.uniform(panda.hard_lower, panda.hard_upper, (20, 9)):
            for name, value in zip(panda.joint_names, q, strict=True):
                bullet.resetJointState(body, index[name], value, physicsClientId=client)
            _, position = Kinematics(panda)(torch.from_numpy(q))
            for i, info in enumerate(infos):
                state = bullet.getLinkState(
                    body, i, computeForwardKinematics=True, physicsClientId=client
                )
                link = panda.tree.links.index(info[12].decode())
                assert np.allclose(position[link].numpy(), state[4], atol=1e-5)
    finally:
        bullet.disconnect(client)


def test_preshapes_put_the_object_between_the_jaws(panda: RobotDescription) -> None:
    rng = np.random.default_rng(0)
    corners = np.array(np.meshgrid([0.475, 0.525], [-0.015, 0.015], [0.0, 0.15])).reshape(3, -1).T
    cloud = np.repeat(corners, 10, axis=0) + rng.normal(0, 1e-4, (80, 3))
    quiet = HeuristicConfig(standoff_noise=0, position_noise=0, turn_noise=0)
    jaws = jaws_of(panda)
    assert jaws is not None
    for _ in range(10):
        preshape = draw_preshape(
            cloud, np.array([1.2, 0, 0.8]), np.zeros(3), hand_of(panda), quiet, rng, "side"
        )
        palm = preshape.T_world_palm
        local = palm[:3, :3].T @ (np.array([0.5, 0, 0.075]) - palm[:3, 3])
        # The object's middle is between the jaws, its near side in front of the palm.
        assert abs(local[2]) < jaws.opening / 2 - 0.01
        assert 0.015 < local[0] < jaws.pads[1] + 0.025


def test_a_can_is_planned_for(panda: RobotDescription) -> None:
    can, rest = (0.5, 0.0, 0.1), np.array([0.04, 0.04])
    target = Target(
        CylinderField(0.025, 0.2, can),
        np.array(can) - 0.12,
        np.array(can) + 0.12,
        NearPalm((can[0] - 0.055, 0.0, 0.12), (1.0, 0.0, 0.0), rest, width=0.08),
        AroundObject(can, 0.055, rest),
    )
    few = SynthesisConfig(rounds=1, seeds=SeedConfig(palms=12, seeds=4))
    plan = plan_of(Planner(panda, PlannerConfig(synthesis=few)).search(target))
    assert plan.status == "ok", plan.sentence
    assert plan.q.shape == (9,)
    assert plan.link_clearance_object.min() >= 0.001
    # The can is between the jaws: in front of the palm, nearer than the fingertips reach.
    local = plan.T_world_palm[:3, :3].T @ (np.array(can) - plan.T_world_palm[:3, 3])
    assert 0.02 < local[0] < 0.09
    assert np.array_equal(plan.trajectory[0], panda.home)


def test_the_hand_that_waits_over_the_table_is_not_taken_for_the_object(
    panda: RobotDescription, tmp_path: Path
) -> None:
    pytest.importorskip("pybullet")
    from pointsdf_cli.geometry.frames import apply_transform
    from pointsdf_cli.io.meshes import load_mesh
    from pointsdf_cli.simulation.observe import Observer
    from pointsdf_cli.simulation.sim_object import prepare_object
    from pointsdf_cli.viz.shading import look_at

    trimesh.creation.box((0.06, 0.06, 0.06)).export(tmp_path / "box.ply")
    item = prepare_object(load_mesh(tmp_path / "box.ply"))
    stands = np.eye(4)
    stands[:3, 3] = (0.55, 0.0, 0.03)
    camera = look_at(np.array([1.4, 0.1, 0.6]), stands[:3, 3])
    observer = Observer(panda)
    rng = np.random.default_rng(0)
    # The waiting hand is in the view, and larger than the box.
    everything = apply_transform(camera, observer.depth_cloud(item, stands, camera, rng))
    hand = (everything[:, 2] > 0.3) & (np.abs(everything[:, 0] - 0.45) < 0.15)
    found = observer.object_view(item, stands, camera, rng).in_world
    assert hand.sum() > len(found) > 100
    assert (np.abs(found - stands[:3, 3]) < 0.045).all()


def test_the_simulated_jaws_lift_a_box(panda: RobotDescription, tmp_path: Path) -> None:
    pytest.importorskip("pybullet")
    from pointsdf_cli.io.meshes import load_mesh
    from pointsdf_cli.robot.inverse_kinematics import InverseKinematics
    from pointsdf_cli.simulation.executor import Executor, ExecutorConfig
    from pointsdf_cli.simulation.sim_object import prepare_object
    from pointsdf_cli.simulation.world import World

    trimesh.creation.box((0.05, 0.05, 0.12)).export(tmp_path / "box.ply")
    item = prepare_object(load_mesh(tmp_path / "box.ply"))
    stands = np.eye(4)
    stands[:3, 3] = (0.5, 0.0, 0.06)
    palm = np.eye(4)  # from above, the jaws along the world's y
    palm[:3, :3] = np.column_stack([(0, 0, -1), (1, 0, 0), (0, -1, 0)])
    solver, poses = InverseKinematics(panda), []
    for height in (0.15, 0.3):
        palm[:3, 3] = (0.5, 0.0, height)
        poses.append(palm.copy())
    found = solver.solve(np.array(poses))
    arms = [found.arm[0][k] for k in np.flatnonzero(found.reached[0])]
    lifted = [found.arm[1][k] for k in np.flatnonzero(found.reached[1])]
    low, high = min(
        ((a, b) for a in arms for b in lifted), key=lambda pair: np.abs(pair[0] - pair[1]).max()
    )
    q = panda.configuration(low, np.array([0.04, 0.04]))
    with World(panda) as world:
        world.reset(item, stands, q)
        assert world.collisions(q) == set()
        outcome = Executor(world, ExecutorConfig()).run(q, np.linspace(low, high, 20))
    assert outcome.held, outcome
    assert outcome.lift_height > 0.1
