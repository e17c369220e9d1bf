"""Robot files: the bundled one holds the data sheet's numbers, wrong ones are named."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml

from pointsdf_cli.errors import InputError
from pointsdf_cli.robot.description import load_robot, robot_digest
from pointsdf_cli.robot.urdf import read_urdf

GRIPPER = Path(__file__).parent / "robots" / "gripper.yaml"


def test_bundled_robot_has_the_data_sheets_numbers() -> None:
    robot = load_robot()
    assert len(robot.arm_joints) == 7
    assert len(robot.hand_joints) == 16
    assert len(robot.preshape_joints) == 8
    degrees = np.rad2deg(robot.hard_upper[robot.arm])
    assert degrees == pytest.approx([170, 120, 170, 120, 170, 120, 170])
    # Planning keeps to ±2.879 (odd joints) and ±2.007 (even).
    assert robot.upper[:7] == pytest.approx([2.879, 2.007] * 3 + [2.879], abs=1e-3)
    assert robot.effort[:7].tolist() == [176, 176, 100, 100, 100, 38, 38]
    thumb = robot.joint_names.index("thumb_joint_0")
    assert (robot.lower[thumb], robot.upper[thumb]) == (0.263, 1.396)


def test_hand_and_configuration() -> None:
    robot = load_robot()
    assert "allegro_palm" in robot.hand_links
    assert "lbr4_link_7" not in robot.hand_links
    assert len(robot.hand_links) == 17
    arm, preshape = np.full((3, 7), 0.1), np.full((3, 8), 0.2)
    q = robot.configuration(arm, preshape)
    assert q.shape == (3, 23)
    assert (q[:, :7] == 0.1).all()
    assert (q[:, robot.preshape_columns] == 0.2).all()
    rest = np.delete(q, [*range(7), *robot.preshape_columns], axis=1)
    assert (rest == 0).all()


def test_a_margin_of_angles_is_none_of_lengths(tmp_path: Path) -> None:
    for file in GRIPPER.parent.iterdir():
        if file.is_file():
            shutil.copy(file, tmp_path)
    path = tmp_path / "gripper.yaml"
    path.write_text(path.read_text() + "\narm_limit_margin: 0.25\n")
    robot = load_robot(path)
    assert (robot.lower[0], robot.upper[0]) == (0.0, 0.6)  # the rail
    assert (robot.lower[2], robot.upper[2]) == (-1.25, 1.25)


def test_a_continuous_joint_has_no_stop_to_keep_away_from(tmp_path: Path) -> None:
    shutil.copy(GRIPPER.parent / "gripper.urdf", tmp_path)
    path = tmp_path / "gripper.yaml"
    path.write_text(GRIPPER.read_text() + "\narm_limit_margin: 0.25\n")
    robot = load_robot(path)
    assert robot.upper[robot.joint_names.index("turn")] == pytest.approx(np.pi)


TREES = {
    "a circle below the root": (
        '<joint name="one" type="fixed"><parent link="left"/><child link="right"/></joint>'
        '<joint name="two" type="fixed"><parent link="right"/><child link="left"/></joint>',
        "is the child of 2 joints",
    ),
    "xacro": (
        '<xacro:include xmlns:xacro="http://www.ros.org/wiki/xacro" filename="arm.xacro"/>',
        "elements of xacro",
    ),
}


@pytest.mark.parametrize("case", TREES)
def test_what_is_no_tree_ends_in_one_message(tmp_path: Path, case: str) -> None:
    added, message = TREES[case]
    text = (GRIPPER.parent / "gripper.urdf").read_text()
    (tmp_path / "gripper.urdf").write_text(text.replace("</robot>", f"{added}</robot>"))
    shutil.copy(GRIPPER, tmp_path)
    with pytest.raises(InputError, match=message):
        load_robot(tmp_path / "gripper.yaml")


def test_limits_of_followers_come_along_the_chain(tmp_path: Path) -> None:
    joints = "".join(
        f'<link name="l{k}"/><joint name="g{k}" type="revolute"><parent link="l{k - 1}"/>'
        f'<child link="l{k}"/><axis xyz="0 0 1"/>{more}</joint>'
        for k, more in (
            (1, '<limit lower="0" upper="0.4" velocity="2" effort="5"/>'),
            (2, '<mimic joint="g1" multiplier="2"/>'),
            (3, '<mimic joint="g2" multiplier="-1"/><limit velocity="0" effort="0"/>'),
        )
    )
    path = tmp_path / "chain.urdf"
    path.write_text(f'<robot name="r"><link name="l0"/>{joints}</robot>')
    _, two, three = read_urdf(path).joints
    assert (two.lower, two.upper, two.velocity, two.effort) == (0, 0.8, 4, 5)
    assert (three.lower, three.upper, three.velocity, three.effort) == (-0.8, 0, 4, 5)


def test_a_follower_is_no_joint_of_the_arm(tmp_path: Path) -> None:
    text = (GRIPPER.parent / "gripper.urdf").read_text()
    place = '<joint name="lean" type="revolute">'
    (tmp_path / "gripper.urdf").write_text(text.replace(place, f'{place}<mimic joint="slide"/>'))
    shutil.copy(GRIPPER, tmp_path)
    with pytest.raises(InputError, match="holds 'lean', which follows 'slide'"):
        load_robot(tmp_path / "gripper.yaml")


def test_the_digest_knows_the_robots_apart(tmp_path: Path) -> None:
    for file in GRIPPER.parent.iterdir():
        if file.is_file():
            shutil.copy(file, tmp_path)
    path = tmp_path / "gripper.yaml"
    assert robot_digest(path) == robot_digest(GRIPPER) != robot_digest()
    path.write_text(path.read_text().replace("xyz: [0.02, 0, 0]", "xyz: [0.03, 0, 0]"))
    assert robot_digest(path) != robot_digest(GRIPPER)


@pytest.mark.parametrize("more", ['multiplier="0"', 'offset="0.02"'])
def test_a_coupling_that_is_not_simulated_is_refused(tmp_path: Path, more: str) -> None:
    for file in GRIPPER.parent.iterdir():
        if file.is_file():
            shutil.copy(file, tmp_path)
    urdf = tmp_path / "gripper.urdf"
    place = '<parent link="grip"/><child link="right"/>'
    text = urdf.read_text()
    urdf.write_text(text.replace(place, f'{place}<mimic joint="left_jaw"/>'))
    assert load_robot(tmp_path / "gripper.yaml").name == load_robot(GRIPPER).name
    urdf.write_text(text.replace(place, f'{place}<mimic joint="left_jaw" {more}/>'))
    with pytest.raises(InputError, match="'right_jaw' has multiplier"):
        load_robot(tmp_path / "gripper.yaml")


def spoiled(folder: Path, before: str, after: str) -> Path:
    """The gripper's YAML beside its URDF with other words."""
    for file in GRIPPER.parent.iterdir():
        if file.is_file():
            shutil.copy(file, folder)
    urdf = folder / "gripper.urdf"
    text = urdf.read_text()
    assert before in text
    urdf.write_text(text.replace(before, after))
    return folder / "gripper.yaml"


@pytest.mark.parametrize("leader", ["left_yaw", "right_jaw"])
def test_a_leader_that_is_none_is_refused(tmp_path: Path, leader: str) -> None:
    place = '<parent link="grip"/><child link="right"/>'
    path = spoiled(tmp_path, place, f'{place}<mimic joint="{leader}"/>')
    with pytest.raises(InputError, match=f"'right_jaw' follows '{leader}'"):
        load_robot(path)


def test_joints_that_follow_each_other_are_refused(tmp_path: Path) -> None:
    left, right = (f'<parent link="grip"/><child link="{side}"/>' for side in ("left", "right"))
    path = spoiled(tmp_path, right, f'{right}<mimic joint="left_jaw"/>')
    assert load_robot(path).followers == ((5, 4, 1.0),)
    urdf = tmp_path / "gripper.urdf"
    text = urdf.read_text()
    assert left in text
    urdf.write_text(text.replace(left, f'{left}<mimic joint="right_jaw"/>'))
    with pytest.raises(InputError, match="follows"):
        load_robot(path)


def test_a_home_that_contradicts_a_mimic_is_refused(tmp_path: Path) -> None:
    right = '<parent link="grip"/><child link="right"/>'
    path = spoiled(tmp_path, right, f'{right}<mimic joint="left_jaw"/>')
    text = path.read_text()
    path.write_text(text + "home: [0.1, 0, 0, 0, 0.01, 0.02]\n")
    with pytest.raises(InputError, match=r"`home`: right_jaw at 0\.02 does not follow") as caught:
        load_robot(path)
    assert str(caught.value.allowed).startswith("0.01:")
    path.write_text(text + "home: [0.1, 0, 0, 0, 0.02, 0.02]\n")
    assert load_robot(path).home.tolist() == [0.1, 0, 0, 0, 0.02, 0.02]
    urdf = tmp_path / "gripper.urdf"
    urdf.write_text(urdf.read_text().replace('"left_jaw"/>', '"left_jaw" multiplier="-1"/>'))
    with pytest.raises(InputError) as caught:  # nothing that could be typed would do
        load_robot(path)
    assert "in the URDF" in str(caught.value.hint)


def test_a_follower_without_limits_has_those_of_its_leader(tmp_path: Path) -> None:
    joint = (
        '<parent link="grip"/><child link="right"/><origin xyz="0 -0.05 0"/><axis xyz="0 1 0"/>\n'
        '    <limit lower="0" upper="0.045" effort="20" velocity="0.2"/>'
    )
    mimic = '<mimic joint="left_jaw" multiplier="-0.5"/>'
    path = spoiled(tmp_path, joint, joint.partition("\n")[0] + mimic)
    (tmp_path / "gripper.yaml").write_text(
        path.read_text().replace("right_jaw: 0.05", "right_jaw: -0.025")
    )
    follower = next(j for j in load_robot(path).tree.joints if j.name == "right_jaw")
    assert (follower.lower, follower.upper) == (-0.0225, 0.0)
    assert (follower.velocity, follower.effort) == (0.1, 20.0)


def test_a_mesh_of_a_package_lies_beside_a_copied_urdf(tmp_path: Path) -> None:
    mesh = '<mesh filename="package://maker_description/meshes/jaw.stl"/>'
    path = spoiled(tmp_path, '<box size="0.06 0.01 0.02"/>', mesh)
    with pytest.raises(InputError, match="package's name"):
        load_robot(path)
    (tmp_path / "meshes").mkdir()
    trimesh.creation.box((0.06, 0.01, 0.02)).export(tmp_path / "meshes" / "jaw.stl")
    assert load_robot(path).tree.shapes["left"][0].kind == "hull"


def test_a_mesh_that_was_scaled_to_metres_twice_is_refused(tmp_path: Path) -> None:
    mesh = '<mesh filename="jaw.stl" scale="0.001 0.001 0.001"/>'
    path = spoiled(tmp_path, '<box size="0.06 0.01 0.02"/>', mesh)
    trimesh.creation.box((0.06, 0.04, 0.02)).export(tmp_path / "jaw.stl")
    with pytest.raises(InputError, match=r"link 'left': the mesh is 6e-05 m across") as caught:
        load_robot(path)
    assert str(caught.value.hint) == 'drawn in metres? Then scale="1 1 1"'


@pytest.mark.parametrize("scale", ["1000 1000 1000", "1 200 1", "1e300 1 1"])
def test_a_link_in_millimetres_is_refused_before_it_is_sampled(tmp_path: Path, scale: str) -> None:
    mesh = f'<mesh filename="jaw.stl" scale="{scale}"/>'
    path = spoiled(tmp_path, '<box size="0.06 0.01 0.02"/>', mesh)
    trimesh.creation.box((0.06, 0.04, 0.02)).export(tmp_path / "jaw.stl")
    with pytest.raises(InputError, match=r"jaw\.stl: link 'left': the mesh is ") as caught:
        load_robot(path)
    assert "millimetres" in str(caught.value.hint)
    spoiled(tmp_path, '<box size="0.06 0.01 0.02"/>', '<box size="60 10 20"/>')
    with pytest.raises(InputError, match=r"gripper\.urdf: link 'left': a box is 60 m across"):
        load_robot(path)


def test_limits_in_degrees_are_refused(tmp_path: Path) -> None:
    path = spoiled(tmp_path, 'lower="-1.5" upper="1.5"', 'lower="-86" upper="86"')
    with pytest.raises(InputError, match="'lean' turns from -86 to 86 rad") as caught:
        load_robot(path)
    assert "degrees" in str(caught.value.hint)


def test_a_negative_size_names_its_link_and_file(tmp_path: Path) -> None:
    path = spoiled(tmp_path, '<box size="0.06 0.01 0.02"/>', '<box size="0.06 -0.01 0.02"/>')
    said = "gripper.urdf: link 'left': a box of size 0.06, -0.01, 0.02\n"
    with pytest.raises(InputError) as caught:
        load_robot(path)
    assert said in caught.value.message


def test_links_fixed_to_the_root_stand_on_the_table() -> None:
    tree = load_robot("panda").tree
    assert tree.fixed_to_root()[0] == tree.links[0]
    joints = {joint.child: joint for joint in tree.joints}
    for link in tree.fixed_to_root()[1:]:
        assert joints[link].kind == "fixed"


def test_neighbours_and_listed_pairs_are_not_checked() -> None:
    robot = load_robot(GRIPPER)
    pairs = {frozenset(pair) for pair in robot.checked_pairs}
    assert frozenset(("rail", "carriage")) not in pairs
    assert frozenset(("wrist", "left")) not in pairs
    assert frozenset(("left", "right")) in pairs


def edit(key: str, value: Any) -> Callable[[dict[str, Any]], None]:
    return lambda data: data.__setitem__(key, value)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda data: data.pop("palm"), "palm"),
        (edit("colour", "red"), "colour"),
        (edit("urdf", "missing.urdf"), "missing.urdf"),
        (edit("arm_joints", ["slide", "twirl"]), "twirl"),
        (edit("arm_joints", "slide"), "arm_joints"),
        (edit("arm_joints", ["slide", "slide"]), "twice"),
        (edit("hand_joints", ["slide"]), "slide"),
        (
            lambda data: data.update(
                arm_joints=["slide", "turn", "lean"],
                hand_joints=["roll", "left_jaw", "right_jaw"],
            ),
            "'roll', which moves the palm",
        ),
        (edit("preshape_joints", {"left_jaw": [0.02, 0.0]}), "lower first"),
        (edit("preshape_joints", {"left_jaw": [0.0, 9.0]}), "limits"),
        (edit("preshape_joints", {"left_jaw": [0.0, float("nan")]}), "finite"),
        (edit("closing_joints", {"left_jaw": 0}), "speed"),
        (edit("closing_joints", {"left_jaw": "fast"}), "closing_joints"),
        (edit("closing_joints", {"slide": 1.0}), "slide"),
        (edit("palm", {"link": "thumb"}), "palm"),
        (edit("palm", {"link": "grip", "xyz": [0, 0]}), "palm"),
        (edit("palm", {"link": "grip", "wxyz": [2, 0, 0, 0]}), "quaternion"),
        (edit("mount", "here"), "mount"),
        (edit("home", [0.0]), "home"),
        (edit("home", [9.0, 0, 0, 0]), "home"),
        (edit("arm_limit_margin", 1.2), "arm_limit_margin"),
        (edit("mount", {"xzy": [0, 0, 1]}), "xzy"),
        (edit("palm", {"link": "grip", "rech": 0.05}), "rech"),
        (edit("arm_limit_margin", -1), "arm_limit_margin"),
        (edit("links_on_table", ["floor"]), "floor"),
        (edit("may_touch", [["left", "left"]]), "may_touch"),
    ],
)
def test_wrong_yaml_is_named(
    tmp_path: Path, change: Callable[[dict[str, Any]], None], word: str
) -> None:
    shutil.copy(GRIPPER.with_suffix(".urdf"), tmp_path / "gripper.urdf")
    data = yaml.safe_load(GRIPPER.read_text(encoding="utf-8"))
    change(data)
    path = tmp_path / "gripper.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    with pytest.raises(InputError) as error:
        load_robot(path)
    assert word in error.value.message


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("<robot", "<robit", "XML"),
        ('type="prismatic"', 'type="planar"', "planar"),
        ('link="carriage"', 'link="cart"', "cart"),
        ('radius="0.03"', 'radius="-0.03"', "-0.03"),
        ('radius="0.03"', 'radius="wide"', "wide"),
        ('<link name="grip"/>', '<link name="grip"/><link name="grip"/>', "twice"),
        ('<link name="grip"/>', '<link name="grip"/><link name="loose"/>', "root"),
        ("<sphere radius=", "<cone radius=", "cone"),
        ('<sphere radius="0.03"/>', '<mesh filename="package://x/none.stl"/>', "none.stl"),
        ('velocity="0.5"', 'velocity="0"', "velocity"),
    ],
)
def test_wrong_urdf_is_named(tmp_path: Path, old: str, new: str, word: str) -> None:
    text = GRIPPER.with_suffix(".urdf").read_text(encoding="utf-8")
    assert old in text
    (tmp_path / "gripper.urdf").write_text(text.replace(old, new, 1), encoding="utf-8")
    shutil.copy(GRIPPER, tmp_path / "gripper.yaml")
    with pytest.raises(InputError) as error:
        load_robot(tmp_path / "gripper.yaml")
    assert word in error.value.message


@pytest.mark.parametrize("text", ["- a\n- b\n", "a: [", "\x00"])
def test_no_yaml_mapping(tmp_path: Path, text: str) -> None:
    (tmp_path / "robot.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError):
        load_robot(tmp_path / "robot.yaml")


def test_no_such_robot(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such robot file"):
        load_robot(tmp_path / "robot.yaml")
