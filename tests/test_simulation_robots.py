"""Any URDF has in PyBullet the bodies and masses that it has here."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import torch
import trimesh

from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.io.meshes import LoadedMesh
from pointsdf_cli.robot.check import check_robot
from pointsdf_cli.robot.description import RobotDescription, load_robot
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.simulation.bullet_urdf import LINK_DENSITY, bullet_urdf
from pointsdf_cli.simulation.executor import Executor, ExecutorConfig
from pointsdf_cli.simulation.sim_object import prepare_object
from pointsdf_cli.simulation.world import World

pytest.importorskip("pybullet")
ROBOTS = Path(__file__).parent / "robots"
INERTIAL = """<inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>"""
LEFT, RIGHT = (f'<link name="{side}">' for side in ("left", "right"))


def gripper(folder: Path, jaws: str = "", text: tuple[str, str] | None = None) -> RobotDescription:
    """The gripper, its jaws from a mesh file of this format, or with other words in its YAML."""
    shutil.copytree(ROBOTS, folder, dirs_exist_ok=True)
    if jaws:
        name = f"jaw.{jaws.removesuffix('_ascii')}"
        # A drawing in millimetres.
        data = trimesh.creation.box((60.0, 10.0, 20.0)).export(file_type=jaws)
        (folder / name).write_bytes(data.encode() if isinstance(data, str) else data)
        urdf = (folder / "gripper.urdf").read_text(encoding="utf-8")
        mesh = f'<mesh filename="{name}" scale="0.001 0.001 0.001"/>'
        urdf = re.sub('<box size="0.06 0.01 0.02"/>', mesh, urdf)
        (folder / "gripper.urdf").write_text(urdf, encoding="utf-8")
    if text is not None:
        yaml = (folder / "gripper.yaml").read_text(encoding="utf-8")
        assert text[0] in yaml
        (folder / "gripper.yaml").write_text(yaml.replace(*text), encoding="utf-8")
    return load_robot(folder / "gripper.yaml")


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "obj", "ply", "off", "glb"])
def test_a_robot_of_meshes_has_a_body(tmp_path: Path, kind: str) -> None:
    robot = gripper(tmp_path, kind)
    with World(robot) as world:
        world.reset()
        bullet, body = world._bullet, world.joints.bodies[0]
        for i in range(bullet.getNumJoints(body)):
            link = bullet.getJointInfo(body, i)[12].decode()
            shapes = bullet.getCollisionShapeData(body, i)
            assert len(shapes) == len(robot.tree.shapes[link]), link
            low, high = bullet.getAABB(body, i)
            if link in ("left", "right"):
                # 6 × 1 × 2 cm, turned somehow, and the margin that PyBullet adds.
                assert 0.06 < np.linalg.norm(np.subtract(high, low)) < 0.12
        q = robot.home.copy()
        q[robot.joint_names.index("slide")] = robot.hard_lower[0]
        q[robot.joint_names.index("lean")] = 1.5
        boxes = gripper(tmp_path / "boxes")
        with World(boxes) as plain:
            plain.reset()
            assert world.collisions(q) == plain.collisions(q)


def test_links_without_a_mass_weigh_what_their_shapes_hold(tmp_path: Path) -> None:
    robot = gripper(tmp_path)
    assert set(robot.tree.without_mass) == {"rail", "carriage", "elbow", "wrist", "left", "right"}
    found = check_robot(robot).findings
    assert any("no <inertial>" in finding.what and "left" in finding.what for finding in found)
    with World(robot) as world:
        world.reset()
        bullet, body = world._bullet, world.joints.bodies[0]
        weighed = {}
        for i in range(bullet.getNumJoints(body)):
            info = bullet.getDynamicsInfo(body, i)
            link = bullet.getJointInfo(body, i)[12].decode()
            weighed[link] = (info[0], info[3])
    assert weighed["left"][0] == pytest.approx(LINK_DENSITY * 0.06 * 0.01 * 0.02)
    assert weighed["left"][1] == pytest.approx((0.03, 0, 0))  # the middle of its box
    assert weighed["wrist"][0] == pytest.approx(LINK_DENSITY * 0.03 * 0.03 * 0.2)
    assert weighed["grip"][0] < 0.01  # a frame


def test_a_robot_that_pybullet_reads_rightly_is_left_alone(tmp_path: Path) -> None:
    robot = gripper(tmp_path / "robot")
    for before, after in (
        ('<cylinder radius="0.03" length="0.06"/>', '<box size="0.06 0.06 0.06"/>'),
        ('<link name="grip"/>', '<link name="grip"></link>'),
        ("</link>", f"{INERTIAL}</link>"),
    ):
        text = robot.urdf.read_text(encoding="utf-8")
        assert before in text
        robot.urdf.write_text(text.replace(before, after), encoding="utf-8")
    robot = load_robot(tmp_path / "robot" / "gripper.yaml")
    (tmp_path / "written").mkdir()
    assert bullet_urdf(robot, tmp_path / "written", 0.001) == robot.urdf
    assert not any((tmp_path / "written").iterdir())
    assert not any("inertial" in finding.what for finding in check_robot(load_robot()).findings)


def test_axes_of_any_length_move_joints_alike(tmp_path: Path) -> None:
    robot = gripper(tmp_path)
    text = robot.urdf.read_text(encoding="utf-8")
    robot.urdf.write_text(text.replace('xyz="0 -1 0"', 'xyz="0 -2 0"'), encoding="utf-8")
    robot = load_robot(tmp_path / "gripper.yaml")
    q = robot.home.copy()
    q[robot.joint_names.index("left_jaw")] = 0.04
    place = Kinematics(robot)(torch.from_numpy(q[None]))[1][0, robot.tree.links.index("left")]
    with World(robot) as world:
        world.reset(q=q)
        body, number = world.joints.links["left"]
        state = world._bullet.getLinkState(body, number)
    np.testing.assert_allclose(state[4], place.numpy(), atol=1e-6)


def test_a_link_without_mass_is_given_one(tmp_path: Path) -> None:
    robot = gripper(tmp_path)
    text = robot.urdf.read_text(encoding="utf-8")
    nothing = INERTIAL.replace('mass value="1"', 'mass value="0"')
    robot.urdf.write_text(text.replace(LEFT, LEFT + nothing), encoding="utf-8")
    robot = load_robot(tmp_path / "gripper.yaml")
    assert "left" in robot.tree.without_mass
    with World(robot) as world:
        world.reset()
        body, number = world.joints.links["left"]
        mass = world._bullet.getDynamicsInfo(body, number)[0]
    assert mass == pytest.approx(LINK_DENSITY * 0.06 * 0.01 * 0.02)


@pytest.mark.parametrize("speed", [0.05, 0.002])
def test_a_slow_hand_closes_all_the_way(tmp_path: Path, speed: float) -> None:
    cube = trimesh.creation.box((0.1, 0.1, 0.1))
    box = prepare_object(
        LoadedMesh("box", cube.vertices, cube.faces.astype(np.int32), "box", "none"), tmp_path
    )
    closing = "{left_jaw: 0.05, right_jaw: 0.05}"
    robot = gripper(tmp_path, text=(closing, f"{{left_jaw: {speed}, right_jaw: {speed}}}"))
    far = transform(np.eye(3), [0.9, 0.5, 0.05])
    with World(robot) as world:
        world.reset(box, far)
        Executor(world, ExecutorConfig())._close()
        ends = robot.hard_upper[robot.closing_columns]
        reached = world.configuration()[robot.closing_columns]
    assert reached == pytest.approx(ends, abs=0.002)


def with_pads(folder: Path) -> RobotDescription:
    """The gripper with a pad fixed to each jaw, which meet when the jaws have moved 5 cm in all."""
    gripper(folder)
    text = (folder / "gripper.urdf").read_text(encoding="utf-8")
    for side, inward in (("left", -1), ("right", 1)):
        text = text.replace(
            "</robot>",
            f"""<link name="{side}_pad"><collision><geometry><box size="0.06 0.02 0.02"/></geometry>
            </collision></link><joint name="{side}_pad_joint" type="fixed"><parent link="{side}"/>
            <child link="{side}_pad"/><origin xyz="0.03 {0.015 * inward} 0"/></joint></robot>""",
        )
    (folder / "gripper.urdf").write_text(text, encoding="utf-8")
    return load_robot(folder / "gripper.yaml")


@pytest.mark.parametrize("there", ["whole", "hand"])
def test_what_is_fixed_to_a_finger_meets_resistance(
    tmp_path: Path, there: Literal["whole", "hand"]
) -> None:
    robot = with_pads(tmp_path)
    with World(robot) as world:
        world.reset(q=robot.home, robot=there)
        columns = robot.closing_columns
        world.joints.drive_at(robot.closing_speeds, columns, robot.effort[columns] * 0.2)
        world.step(round(2.0 / world.physics.step))
        assert world.configuration()[columns].sum() == pytest.approx(0.05, abs=2e-3)


@pytest.mark.parametrize("kind", ["stl", "glb"])
def test_a_hand_of_meshes_is_carried_with_its_body(tmp_path: Path, kind: str) -> None:
    robot, boxes = gripper(tmp_path / "meshes", kind), gripper(tmp_path / "boxes")
    cube = trimesh.creation.box((0.02, 0.02, 0.02))
    item = prepare_object(
        LoadedMesh("cube", cube.vertices, cube.faces.astype(np.int32), "cube", "none"), tmp_path
    )
    with World(robot) as world, World(boxes) as plain:
        world.reset()
        links = world.joints.links
        state = world._bullet.getLinkState(*links["left"], computeForwardKinematics=True)
        # In the left jaw's box; at home, so that both worlds have it there.
        turn = np.array(world._bullet.getMatrixFromQuaternion(state[5])).reshape(3, 3)
        pose = transform(np.eye(3), np.array(state[4]) + turn @ [0.03, 0.0, 0.0])
        for one in (world, plain):
            one.reset(item, pose, robot="hand")
            assert one.collisions(robot.home) == {"object"}
            one.reset(item, transform(np.eye(3), [0.9, 0.6, 0.2]), robot="hand")
            assert one.collisions(robot.home) == set()


def test_names_of_links_are_free(tmp_path: Path) -> None:
    """Bodies of a hand have roots of their own, whose names no link of the robot has."""
    gripper(tmp_path)
    text = (tmp_path / "gripper.urdf").read_text(encoding="utf-8")
    text = text.replace('"left"', '"carrier"').replace('"right"', '"base"')
    (tmp_path / "gripper.urdf").write_text(text, encoding="utf-8")
    yaml = (tmp_path / "gripper.yaml").read_text(encoding="utf-8")
    yaml = yaml.replace("[wrist, left], [wrist, right]", "[wrist, carrier], [wrist, base]")
    (tmp_path / "gripper.yaml").write_text(yaml, encoding="utf-8")
    robot = load_robot(tmp_path / "gripper.yaml")
    assert {"carrier", "base"} <= set(robot.hand_links)
    with World(robot) as world:
        world.reset(robot="hand")
        assert set(robot.hand_links) <= set(world.joints.links)
        world.step(10)
        assert world.configuration() == pytest.approx(robot.home, abs=1e-3)
