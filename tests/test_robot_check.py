"""The checker of robot descriptions finds what is wrong, names the mending line, and draws."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pointsdf_cli.robot.check import ERROR, _left_home, check_robot
from pointsdf_cli.robot.closing import closing_of, fingertips, open_hand, to_palm_axis
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.viz.robot_check_picture import AXES, PATH_COLOUR, check_picture, robot_scene

ROBOTS = Path(__file__).parent / "robots"


@pytest.fixture
def gripper(tmp_path: Path) -> Callable[[str, str], Path]:
    """The gripper's description with one piece of text replaced."""
    shutil.copy(ROBOTS / "gripper.urdf", tmp_path)

    def write(old: str = "", new: str = "") -> Path:
        text = (ROBOTS / "gripper.yaml").read_text()
        assert old in text
        path = tmp_path / "gripper.yaml"
        path.write_text(text.replace(old, new))
        return path

    return write


def test_the_bundled_robot_and_the_gripper_pass() -> None:
    for path in (None, ROBOTS / "gripper.yaml"):
        found = check_robot(load_robot(path))
        assert all("no <inertial>" in finding.what for finding in found.findings)
        assert len(found.findings) == (path is not None)
        assert found.passed
        assert found.reached > 0.9
        assert found.farthest <= 0.01
        assert found.table_distance > 0


def test_the_jaws_meet_in_the_middle() -> None:
    # The URDF puts the jaws at ±0.045 with slides of 0.04 m; preshapes open the left one alone.
    closing = closing_of(load_robot(ROBOTS / "gripper.yaml"))
    assert closing.tips == ("left", "right")
    opening = np.abs(closing.paths[:, 0, 1] - closing.paths[:, 1, 1])
    assert (np.diff(opening) < 0).all()
    assert closing.nearer["right_jaw"] == pytest.approx(
        np.abs(closing.paths[0, 1, 1]) - np.abs(closing.paths[-1, 1, 1]), abs=1e-9
    )


def test_the_allegro_has_four_fingertips_that_curl_around_the_palm_axis() -> None:
    robot = load_robot()
    assert fingertips(robot) == tuple(
        f"{finger}_link_3" for finger in ("index", "middle", "ring", "thumb")
    )
    closing = closing_of(robot)
    away = to_palm_axis(robot, closing.paths)
    assert (away.min(axis=0) < away[0] / 2).all()


def test_the_distance_to_the_palm_axis_is_to_a_half_line() -> None:
    robot = load_robot(ROBOTS / "gripper.yaml")
    points = np.array([[1.0, 0.3, 0.4], [-3.0, 0.0, 4.0], [0.0, 0.0, 0.0]])
    assert np.allclose(to_palm_axis(robot, points), [0.5, 5.0, 0.0])


WRONG = {
    "a jaw that opens": ("right_jaw: 0.05", "right_jaw: -0.05", "right_jaw", "closing_joints"),
    "a palm that looks back": (
        "xyz: [0.02, 0, 0]}",
        "xyz: [0.2, 0, 0]}",
        "behind the palm frame",
        "palm: x",
    ),
    "below the table": ("[0.1, -0.2, 0.0]", "[0.1, -0.2, -2.0]", "below the table", "mount"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_found_with_the_line_that_mends_it(
    gripper: Callable[[str, str], Path], case: str
) -> None:
    old, new, what, fix = WRONG[case]
    found = check_robot(load_robot(gripper(old, new)))
    errors = [finding for finding in found.findings if finding.level == ERROR]
    assert any(what in error.what and fix in error.fix for error in errors), found.findings
    assert not found.passed


def test_fingers_faster_than_their_limit_are_told_whichever_way_they_move(
    gripper: Callable[[str, str], Path],
) -> None:
    for speeds, fast in (("0.05, right_jaw: -0.3", True), ("0.3, right_jaw: 0.05", True),
                         ("0.05, right_jaw: -0.05", False)):  # fmt: skip
        path = gripper("0.05, right_jaw: 0.05", speeds)
        said = [finding.what for finding in check_robot(load_robot(path)).findings]
        assert any("faster than the URDF's velocity limit" in what for what in said) == fast


def test_a_joint_that_leads_elsewhere_is_found_with_all_else(
    gripper: Callable[[str, str], Path],
) -> None:
    path = gripper("lean, roll]", "lean, roll, nod]")
    urdf = path.with_name("gripper.urdf")
    head = (
        '<link name="head"/><joint name="nod" type="revolute"><parent link="rail"/>'
        '<child link="head"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="5" velocity="1"/></joint></robot>'
    )
    urdf.write_text(urdf.read_text().replace("</robot>", head))
    found = check_robot(load_robot(path))
    assert not found.passed
    errors = [finding for finding in found.findings if finding.level == ERROR]
    assert any("does not move the palm" in e.what and "arm_joints" in e.fix for e in errors)
    assert not any("inverse kinematics" in finding.what for finding in found.findings)


def test_a_joint_that_is_left_out_is_told(gripper: Callable[[str, str], Path]) -> None:
    path = gripper("arm_joints: [slide, turn, lean, roll]", "arm_joints: [slide, turn, lean]")
    findings = check_robot(load_robot(path)).findings
    assert any("roll" in f.what and f.level == "warning" for f in findings)


@pytest.mark.parametrize(
    ("mimic", "closing", "error", "fix"),
    [
        ('multiplier="1"', "left_jaw: 0.05, right_jaw: 0.05", "", ""),
        ('multiplier="1"', "left_jaw: 0.05, right_jaw: -0.05", "does not close as it does",
         "closing_joints: {right_jaw: 0.05}"),
        ('multiplier="0.5"', "left_jaw: 0.05", "does not close as it does",
         "closing_joints: {right_jaw: 0.025}"),
        ('multiplier="0.5"', "right_jaw: 0.02", "which does not close",
         "closing_joints: {left_jaw: 0.04}"),
        ('multiplier="-1"', "left_jaw: 0.05, right_jaw: -0.05", "beyond its limits 0 to 0.045",
         '<limit lower="-0.045" upper="0">'),
    ],
)  # fmt: skip
def test_followers_that_contradict_their_leader_are_errors(
    gripper: Callable[[str, str], Path], mimic: str, closing: str, error: str, fix: str
) -> None:
    path = gripper("left_jaw: 0.05, right_jaw: 0.05", closing)
    urdf = path.with_name("gripper.urdf")
    place = '<parent link="grip"/><child link="right"/>'
    urdf.write_text(urdf.read_text().replace(place, f'{place}<mimic joint="left_jaw" {mimic}/>'))
    found = check_robot(load_robot(path))
    said = [f for f in found.findings if f.level == ERROR and "<mimic>" in f.what]
    assert len(said) == (error != ""), found.findings
    assert not said or (error in said[0].what and fix in said[0].fix)
    assert found.passed == (error == "")


def test_a_closing_joint_whose_leader_is_not_listed_is_an_error(
    gripper: Callable[[str, str], Path],
) -> None:
    path = gripper("hand_joints: [left_jaw, right_jaw]", "hand_joints: [right_jaw]")
    text = path.read_text().replace("{left_jaw: [0.0, 0.02]}", "{right_jaw: [0.0, 0.02]}")
    path.write_text(text.replace("left_jaw: 0.05, right", "right"))
    urdf = path.with_name("gripper.urdf")
    place = '<parent link="grip"/><child link="right"/>'
    urdf.write_text(urdf.read_text().replace(place, f'{place}<mimic joint="left_jaw"/>'))
    said = [f for f in check_robot(load_robot(path)).findings if f.level == ERROR]
    assert any("name left_jaw in hand_joints" in error.fix for error in said), said


def test_a_follower_that_is_left_out_is_an_error(gripper: Callable[[str, str], Path]) -> None:
    path = gripper("hand_joints: [left_jaw, right_jaw]", "hand_joints: [left_jaw]")
    path.write_text(path.read_text().replace(", right_jaw: 0.05", ""))
    urdf = path.with_name("gripper.urdf")
    place = '<joint name="right_jaw" type="prismatic">'
    urdf.write_text(urdf.read_text().replace(place, f'{place}<mimic joint="left_jaw"/>'))
    found = check_robot(load_robot(path))
    (error,) = [f for f in found.findings if f.level == ERROR and "left out" in f.what]
    assert error.what.startswith("right_jaw follows left_jaw")
    assert "closing_joints: {right_jaw: 0.05}" in error.fix
    assert not any("kept at 0" in finding.what for finding in found.findings)


def test_a_range_of_more_than_two_turns_is_told(gripper: Callable[[str, str], Path]) -> None:
    path = gripper("", "")
    urdf = path.with_name("gripper.urdf")
    text = urdf.read_text()
    for end, told in ((6.28318530718, False), (9.0, True)):
        urdf.write_text(text.replace('lower="-1.5" upper="1.5"', f'lower="-{end}" upper="{end}"'))
        findings = check_robot(load_robot(path)).findings
        assert any("lean turns" in f.what and "degrees" in f.fix for f in findings) == told


def test_a_hand_that_waits_otherwise_than_it_grasps_is_told() -> None:
    panda = load_robot("panda")
    assert not any("in grasps" in f.what for f in check_robot(panda).findings)
    joints, ranges = panda.preshape_joints[1:], panda.preshape_ranges[1:]
    half = replace(panda, preshape_joints=joints, preshape_ranges=ranges)
    first, second = _left_home(half)  # the other jaw follows the one that is left out
    assert first.what == "panda_finger_joint1: 0.04 at home, but 0 in grasps"
    assert second.what == "panda_finger_joint2: 0.04 at home, but 0 in grasps"
    assert open_hand(half)[7:].tolist() == [0.0, 0.0]


def test_the_command_reports_draws_and_exits_as_it_should(
    gripper: Callable[..., Path], tmp_path: Path, cli: Callable
) -> None:
    picture = tmp_path / "check.png"
    good = cli("robot", "check", gripper(), "--picture", picture, "--json")
    assert good.code == 0, good.err
    report = json.loads(good.out)
    assert report["passed"]
    assert set(report["fingertips"]) == {"left", "right"}
    with Image.open(picture) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    assert pixels.shape[1] == 3 * pixels.shape[0]
    for third in np.split(pixels, 3, axis=1):
        assert (np.abs(third - 255).sum(axis=2) > 60).mean() > 0.01  # something in each
    bad = cli("robot", "check", gripper("right_jaw: 0.05", "right_jaw: -0.05"))
    assert bad.code == 2
    assert "closing_joints: {right_jaw: 0.05}" in bad.out
    assert "1 error" in bad.err


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("urdf: gripper.urdf", "urdf: absent.urdf", "no such URDF"),
        ("arm_joints: [slide,", "arm_joints: [glide,", "glide"),
        ("closing_joints: {left_jaw: 0.05", "closing_joints: {left_jaw: fast", "fast"),
        ("palm: {link: grip", "palm: {link: hand", "palm"),
        ("palm: {link: grip,", "palm: {link: grip, reach: far,", "far"),
        ("urdf: gripper.urdf", "urdf: [", "YAML"),
    ],
)
def test_a_bad_file_is_one_message(
    gripper: Callable[[str, str], Path], cli: Callable, old: str, new: str, message: str
) -> None:
    done = cli("robot", "check", gripper(old, new))
    assert done.code == 2
    assert message in done.err
    assert done.err.count("rgrasp:") == 1
    assert done.out == ""


def test_home_may_open_the_hand(gripper: Callable[[str, str], Path]) -> None:
    path = gripper("urdf: gripper.urdf", "home: [0.1, 0, 0, 0, 0.01, 0.02]\nurdf: gripper.urdf")
    assert np.allclose(load_robot(path).home, [0.1, 0, 0, 0, 0.01, 0.02])


def test_the_scene_closes_the_hand() -> None:
    robot = load_robot(ROBOTS / "gripper.yaml")
    scene = robot_scene(robot, "gripper")
    left, right = scene.bodies.index("left"), scene.bodies.index("right")
    gap = np.linalg.norm(scene.poses[:, left, :3, 3] - scene.poses[:, right, :3, 3], axis=1)
    assert gap[-1] < gap[0]
    assert scene.captions[-1] == "100 % closed"
    assert {"samples", "fingertip paths", "palm"} <= set(scene.layers)


def test_the_axes_of_the_picture_keep_their_colours() -> None:
    seen = check_picture(load_robot()).reshape(-1, 3).astype(int)
    for colour in (*AXES, PATH_COLOUR):
        drawn = np.abs(seen - 255 * np.array(colour)).max(axis=1) < 4
        assert drawn.sum() > 5, colour
