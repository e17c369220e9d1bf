"""A description begun from a URDF alone agrees with what people wrote for the same robot."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from conftest import run_cli

from pointsdf_cli.assets import asset_path
from pointsdf_cli.errors import InputError
from pointsdf_cli.robot.check import check_robot
from pointsdf_cli.robot.description import load_robot, robot_of
from pointsdf_cli.robot.first_guess import as_yaml, first_guess

ROBOTS = Path(__file__).parent / "robots"


def test_the_gripper_begun_from_its_urdf_passes_its_check(tmp_path: Path) -> None:
    urdf = shutil.copy(ROBOTS / "gripper.urdf", tmp_path)
    done = run_cli("robot", "init", urdf, "--out", tmp_path / "mine.yaml")
    assert done.code == 0, done.err
    assert "rgrasp robot check" in done.err
    guessed, written = load_robot(tmp_path / "mine.yaml"), load_robot(ROBOTS / "gripper.yaml")
    # Its URDF gives no masses, which no guess can mend.
    assert ["no <inertial>" in found.what for found in check_robot(guessed).findings] == [True]
    assert guessed.arm_joints == written.arm_joints
    assert guessed.hand_joints == written.hand_joints
    assert guessed.palm_link == "grip"
    assert dict(zip(guessed.closing_joints, np.sign(guessed.closing_speeds), strict=True)) == {
        "left_jaw": 1, "right_jaw": 1,
    }  # fmt: skip
    # The jaws slide along the link's y and point along its x.
    np.testing.assert_allclose(np.abs(guessed.T_link_palm[:3, 0]), [1, 0, 0], atol=1e-3)
    np.testing.assert_allclose(np.abs(guessed.T_link_palm[:3, 2]), [0, 1, 0], atol=1e-3)
    again = run_cli("robot", "init", urdf, "--out", tmp_path / "mine.yaml")
    assert again.code == 2
    assert "--force" in again.err


def coupled(folder: Path, multiplier: float, lower: float, upper: float) -> Path:
    """The gripper's URDF, its right jaw led by the left one within limits [m]."""
    text = (ROBOTS / "gripper.urdf").read_text(encoding="utf-8")
    head, right = text.split('<joint name="right_jaw" type="prismatic">')
    right = right.replace('lower="0" upper="0.045"', f'lower="{lower}" upper="{upper}"')
    if multiplier < 0:
        right = right.replace('axis xyz="0 1 0"', 'axis xyz="0 -1 0"')
    mimic = '<joint name="right_jaw" type="prismatic"><mimic joint="left_jaw" multiplier="'
    (folder / "gripper.urdf").write_text(f'{head}{mimic}{multiplier}"/>{right}')
    return folder / "gripper.urdf"


@pytest.mark.parametrize("multiplier", [1.0, 0.5, -1.0])
def test_followers_close_and_wait_as_their_leader_does(tmp_path: Path, multiplier: float) -> None:
    ends = sorted((0.0, multiplier * 0.045))
    urdf = coupled(tmp_path, multiplier, *ends)
    done = run_cli("robot", "init", urdf, "--out", tmp_path / "mine.yaml")
    assert done.code == 0, done.err
    guessed = load_robot(tmp_path / "mine.yaml")
    speeds = dict(zip(guessed.closing_joints, guessed.closing_speeds, strict=True))
    assert speeds["left_jaw"] > 0
    assert speeds["right_jaw"] == pytest.approx(multiplier * speeds["left_jaw"])
    assert guessed.home[5] == pytest.approx(multiplier * guessed.home[4], abs=1e-3)
    np.testing.assert_allclose(
        guessed.preshape_ranges[1], np.sort(multiplier * guessed.preshape_ranges[0])
    )
    found = check_robot(guessed)
    assert found.passed, found.findings
    assert found.closing.q[-1, 5] == pytest.approx(multiplier * found.closing.q[-1, 4])


def test_a_finger_that_its_leader_turns_back_closes_with_it(tmp_path: Path) -> None:
    """A linkage: the first joint swings the jaw in, its follower keeps the tip level."""
    data = pytest.importorskip("pybullet_data", reason="PyBullet's robots are not installed")
    shutil.copytree(Path(data.getDataPath()) / "xarm", tmp_path / "xarm")
    done = run_cli("robot", "init", tmp_path / "xarm" / "xarm6_with_gripper.urdf")
    assert done.code == 0, done.err
    guessed = load_robot(tmp_path / "xarm" / "xarm6_with_gripper.yaml")
    assert (guessed.closing_speeds == 0.5).all()
    assert (guessed.home[guessed.closing_columns] == 0).all()
    assert check_robot(guessed).passed


def test_jaws_of_several_links_close_towards_each_other(tmp_path: Path) -> None:
    """A pad and a sensor on each jaw are no fingers of their own."""
    parts = ""
    for side in ("left", "right"):
        for k, part in enumerate(("pad", "sensor")):
            parts += (
                f'<link name="{part}_{side}"><collision><geometry><box size="0.01 0.004 0.01"/>'
                f'</geometry></collision></link><joint name="{part}_{side}_mount" type="fixed">'
                f'<parent link="{side}"/><child link="{part}_{side}"/>'
                f'<origin xyz="{0.065 + 0.011 * k} 0 0"/></joint>'
            )
    text = (ROBOTS / "gripper.urdf").read_text(encoding="utf-8")
    (tmp_path / "gripper.urdf").write_text(text.replace("</robot>", f"{parts}</robot>"))
    done = run_cli("robot", "init", tmp_path / "gripper.urdf", "--out", tmp_path / "mine.yaml")
    assert done.code == 0, done.err
    guessed = load_robot(tmp_path / "mine.yaml")
    assert guessed.closing_joints == ("left_jaw", "right_jaw")
    assert (guessed.closing_speeds > 0).all()
    np.testing.assert_allclose(np.abs(guessed.T_link_palm[:3, 2]), [0, 1, 0], atol=1e-3)


def test_what_is_fixed_to_the_root_stands_on_the_table(tmp_path: Path) -> None:
    text = (ROBOTS / "gripper.urdf").read_text(encoding="utf-8")
    world = (
        '<link name="world"/><joint name="stand" type="fixed"><parent link="world"/>'
        '<child link="rail"/></joint></robot>'
    )
    (tmp_path / "gripper.urdf").write_text(text.replace("</robot>", world))
    data = first_guess(tmp_path / "gripper.urdf", tmp_path / "mine.yaml")
    assert data["links_on_table"] == ["world", "rail"]


def test_names_of_joints_are_names_whatever_they_look_like(tmp_path: Path) -> None:
    text = (ROBOTS / "gripper.urdf").read_text(encoding="utf-8")
    for old, new in (("left_jaw", "1"), ("right_jaw", "on")):
        text = text.replace(f'"{old}"', f'"{new}"')
    (tmp_path / "gripper.urdf").write_text(text)
    done = run_cli("robot", "init", tmp_path / "gripper.urdf", "--out", tmp_path / "mine.yaml")
    assert done.code == 0, done.err
    guessed = load_robot(tmp_path / "mine.yaml")
    assert set(guessed.hand_joints) == {"1", "on"}
    assert set(guessed.closing_joints) == {"1", "on"}


def test_a_limit_of_many_digits_is_not_rounded_past(tmp_path: Path) -> None:
    text = (ROBOTS / "gripper.urdf").read_text(encoding="utf-8")
    (tmp_path / "gripper.urdf").write_text(text.replace('upper="0.045"', 'upper="0.0447"'))
    done = run_cli("robot", "init", tmp_path / "gripper.urdf", "--out", tmp_path / "mine.yaml")
    assert done.code == 0, done.err
    guessed = load_robot(tmp_path / "mine.yaml")
    assert ((guessed.home >= guessed.lower) & (guessed.home <= guessed.upper)).all()


def test_the_allegro_hand_is_found_to_be_one_that_closes_around_things() -> None:
    written = load_robot()
    beside = written.urdf.with_name("guess.yaml")
    guessed = robot_of(first_guess(written.urdf, beside), beside)
    assert guessed.arm_joints == written.arm_joints
    assert set(guessed.hand_joints) == set(written.hand_joints)
    speeds = dict(zip(written.closing_joints, written.closing_speeds, strict=True))
    found = dict(zip(guessed.closing_joints, guessed.closing_speeds, strict=True))
    assert {k: np.sign(v) for k, v in found.items()} == {k: np.sign(v) for k, v in speeds.items()}
    np.testing.assert_allclose(guessed.T_link_palm[:3, :3], written.T_link_palm[:3, :3], atol=0.1)
    assert check_robot(guessed).passed


def test_the_text_says_what_the_guess_says() -> None:
    urdf = ROBOTS / "gripper.urdf"
    data = first_guess(urdf, ROBOTS / "mine.yaml")
    read = yaml.safe_load(as_yaml(data))
    assert {key: read[key] for key in data} == data
    assert "GUESSED" in as_yaml(data)


def test_where_nothing_branches_off_the_palm_must_be_named(tmp_path: Path) -> None:
    text = (ROBOTS / "gripper.urdf").read_text()
    assert text.count('name="right_jaw" type="prismatic"') == 1
    one = text.replace('name="right_jaw" type="prismatic"', 'name="right_jaw" type="fixed"')
    (tmp_path / "one.urdf").write_text(one)
    with pytest.raises(InputError, match="no fingers branch off") as caught:
        first_guess(tmp_path / "one.urdf", tmp_path / "one.yaml")
    assert "--palm LINK" in str(caught.value.hint)
    data = first_guess(tmp_path / "one.urdf", tmp_path / "one.yaml", "grip")
    assert data["hand_joints"] == ["left_jaw"]
    with pytest.raises(InputError, match="no link 'hand'"):
        first_guess(tmp_path / "one.urdf", tmp_path / "one.yaml", "hand")


def test_the_panda_begun_from_its_urdf_passes_its_check(tmp_path: Path) -> None:
    data = pytest.importorskip("pybullet_data", reason="PyBullet's robots are not installed")
    folder = tmp_path / "panda"
    shutil.copytree(Path(data.getDataPath()) / "franka_panda", folder)
    assert run_cli("robot", "init", folder / "panda.urdf").code == 0
    panda = load_robot(folder / "panda.yaml")
    assert panda.palm_link == "panda_hand"
    assert len(panda.arm_joints) == 7
    assert panda.may_touch == {frozenset(("panda_leftfinger", "panda_rightfinger"))}
    assert check_robot(panda).findings == ()
    # The fingers slide along the hand's y and end 0.11 m along its z.
    np.testing.assert_allclose(np.abs(panda.T_link_palm[:3, 2]), [0, 1, 0], atol=1e-3)
    np.testing.assert_allclose(panda.T_link_palm[:3, 0], [0, 0, 1], atol=1e-3)
    assert 0.04 < panda.T_link_palm[2, 3] < 0.07


@pytest.mark.parametrize("name", ["panda", "ur5e_2f85"])
def test_the_palm_of_jaws_is_where_people_put_it(tmp_path: Path, name: str) -> None:
    """Jaws that slide, and jaws of a linkage, which reach farther as they close."""
    urdf = shutil.copy(asset_path(f"robots/{name}.urdf"), tmp_path)
    assert run_cli("robot", "init", urdf, "--out", tmp_path / "mine.yaml").code == 0
    guessed, written = load_robot(tmp_path / "mine.yaml"), load_robot(name)
    assert guessed.palm_link == written.palm_link
    off = guessed.T_link_palm[:3, 3] - written.T_link_palm[:3, 3]
    assert np.abs(off).max() < 0.005


def test_two_fingers_against_a_third_are_guessed_to_close_from_both_sides(tmp_path: Path) -> None:
    shutil.copy(asset_path("robots/lbr4_barrett.urdf"), tmp_path / "hand.urdf")
    assert run_cli("robot", "init", tmp_path / "hand.urdf").code == 0
    hand = load_robot(tmp_path / "hand.yaml")
    np.testing.assert_allclose(hand.T_link_palm[:3, 0], [0, 0, 1], atol=1e-3)
    np.testing.assert_allclose(np.abs(hand.T_link_palm[:3, 2]), [1, 0, 0], atol=1e-3)
    assert check_robot(hand).findings == ()
