"""Forward kinematics against a physics engine, against hand-made geometry, and its gradients."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from pointsdf_cli.robot.description import RobotDescription, load_robot
from pointsdf_cli.robot.kinematics import Kinematics, homogeneous

GRIPPER = Path(__file__).parent / "robots" / "gripper.yaml"


def random_configurations(robot: RobotDescription, count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.uniform(robot.hard_lower, robot.hard_upper, (count, len(robot.joint_names)))


@pytest.mark.parametrize("path", [None, GRIPPER], ids=["lbr4_allegro", "gripper"])
def test_agrees_with_pybullet_on_1000_configurations(path: Path | None) -> None:
    bullet = pytest.importorskip("pybullet")
    robot = load_robot(path)
    q = random_configurations(robot, 1000)
    rotation, position = Kinematics(robot)(torch.from_numpy(q))
    client = bullet.connect(bullet.DIRECT)
    try:
        body = bullet.loadURDF(
            str(robot.urdf),
            basePosition=robot.T_world_base[:3, 3],
            baseOrientation=[0, 0, 0.5**0.5, 0.5**0.5] if path else [0, 0, 0, 1],
            useFixedBase=True,
            physicsClientId=client,
        )
        joints, links = {}, {}
        for i in range(bullet.getNumJoints(body, physicsClientId=client)):
            info = bullet.getJointInfo(body, i, physicsClientId=client)
            joints[info[1].decode()], links[info[12].decode()] = i, i
        worst = 0.0
        for k, configuration in enumerate(q):
            for name, value in zip(robot.joint_names, configuration, strict=True):
                bullet.resetJointState(body, joints[name], value, physicsClientId=client)
            states = bullet.getLinkStates(
                body, list(links.values()), computeForwardKinematics=True, physicsClientId=client
            )
            for link, state in zip(links, states, strict=True):
                i = robot.tree.links.index(link)
                turned = np.array(bullet.getMatrixFromQuaternion(state[5])).reshape(3, 3)
                worst = max(
                    worst,
                    float(np.abs(position[k, i].numpy() - state[4]).max()),
                    float(np.abs(rotation[k, i].numpy() - turned).max()),
                )
    finally:
        bullet.disconnect(client)
    assert worst < 1e-5


def test_stretched_arm_stands_as_the_data_sheet_adds_up() -> None:
    robot = load_robot()
    q = torch.zeros(len(robot.joint_names), dtype=torch.float64)
    palm = Kinematics(robot).palm(q).numpy()
    height = 0.11 + 0.2005 + 0.2 + 0.2 + 0.2 + 0.19 + 0.078 + 0.11
    assert palm[:3, 3] == pytest.approx([0, 0, height], abs=1e-12)
    assert palm[:3, :3] == pytest.approx(np.eye(3), abs=1e-12)


def test_gripper_by_hand() -> None:
    # Slide up 0.3, turn a quarter, on a mount turned a quarter itself: the grip is half round.
    robot = load_robot(GRIPPER)
    q = torch.tensor([0.3, np.pi / 2, -0.3, 0.0, 0.01, 0.02], dtype=torch.float64)
    kinematics = Kinematics(robot)
    rotation, position = kinematics(q)
    palm = kinematics.palm_of(rotation, position)
    # `lean` cancels its own tilt, so the wrist stands upright: 0.1 + 0.3 + 0.08 + 0.22.
    assert palm[:3, 3].tolist() == pytest.approx([0.1 - 0.02, -0.2, 0.70], abs=1e-6)
    left = position[kinematics.index("left")]
    assert left.tolist() == pytest.approx([0.1, -0.2 - (0.05 - 0.01), 0.70], abs=1e-6)


def test_gradients_agree_with_finite_differences() -> None:
    robot = load_robot()
    kinematics = Kinematics(robot)
    q = torch.from_numpy(random_configurations(robot, 2)).requires_grad_(True)
    assert torch.autograd.gradcheck(lambda v: kinematics(v)[1][:, 7:], (q,), atol=1e-6)


@pytest.mark.parametrize("path", [None, GRIPPER], ids=["lbr4_allegro", "gripper"])
def test_poses_in_numpy_are_those_of_torch(path: Path | None) -> None:
    robot = load_robot(path)
    kinematics, q = Kinematics(robot), random_configurations(robot, 20)
    for ours, theirs in zip(kinematics.poses(q), kinematics(torch.from_numpy(q)), strict=True):
        np.testing.assert_allclose(ours, theirs.numpy(), atol=1e-14)


def test_batch_dimensions_are_kept() -> None:
    robot = load_robot()
    kinematics = Kinematics(robot)
    q = torch.from_numpy(random_configurations(robot, 6))
    rotation, position = kinematics(q.reshape(2, 3, -1))
    flat_rotation, flat_position = kinematics(q)
    assert torch.equal(rotation.reshape(flat_rotation.shape), flat_rotation)
    assert torch.equal(position.reshape(flat_position.shape), flat_position)


def test_points_ride_on_their_links() -> None:
    robot = load_robot()
    kinematics = Kinematics(robot)
    q = torch.from_numpy(random_configurations(robot, 3))
    pose = homogeneous(*kinematics(q))[:, kinematics.index("index_link_3")]
    tip = torch.tensor([[0.0, 0.0, 0.0267]], dtype=torch.float64)
    (moved,) = kinematics.points(q, [("index_link_3", tip)])
    expected = torch.einsum("bij,pj->bpi", pose[:, :3, :3], tip) + pose[:, None, :3, 3]
    assert torch.allclose(moved, expected)


def test_urdf_loads_in_other_readers() -> None:
    robot = load_robot()
    q = random_configurations(robot, 5)
    rotation, position = Kinematics(robot)(torch.from_numpy(q))
    ours = homogeneous(rotation, position).numpy()
    chains = pytest.importorskip("pytorch_kinematics")
    chain = chains.build_chain_from_urdf(robot.urdf.read_bytes()).to(dtype=torch.float64)
    order = [robot.joint_names.index(name) for name in chain.get_joint_parameter_names()]
    theirs = chain.forward_kinematics(torch.from_numpy(q[:, order]))
    for i, link in enumerate(robot.tree.links):
        assert np.abs(theirs[link].get_matrix().numpy() - ours[:, i]).max() < 1e-6
    yourdfpy = pytest.importorskip("yourdfpy")
    model = yourdfpy.URDF.load(str(robot.urdf))
    for k in range(len(q)):
        model.update_cfg(dict(zip(robot.joint_names, q[k], strict=True)))
        for i, link in enumerate(robot.tree.links):
            assert np.abs(model.get_transform(link) - ours[k, i]).max() < 1e-6


def test_urdf_lines_are_short_enough_for_pybullet() -> None:
    text = load_robot().urdf.read_text(encoding="utf-8")
    assert max(map(len, text.splitlines())) < 1000
