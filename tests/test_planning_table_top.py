"""Clouds of a table to the object that is meant: segmentation, the robot left out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scenes
import trimesh

from pointsdf_cli.assets import asset_path
from pointsdf_cli.camera.depth_cloud import cloud_of_depth
from pointsdf_cli.camera.table_objects import LOOSE
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import apply_transform, invert_transform, transform
from pointsdf_cli.io.clouds import Cloud
from pointsdf_cli.planning.cloud_checks import in_world
from pointsdf_cli.planning.environment import Environment, Obstacle, obstacle_mesh, read_environment
from pointsdf_cli.planning.object_choice import TargetChoice
from pointsdf_cli.planning.other_cameras import FirstView
from pointsdf_cli.planning.plan_on_table import plan_on_table
from pointsdf_cli.planning.planner import PlannerConfig
from pointsdf_cli.planning.plausibility import table_warning
from pointsdf_cli.planning.seen_obstacles import hulls
from pointsdf_cli.planning.table_top import (
    NoObjectError,
    look_at_table,
    table_height,
    workspace_of,
)
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.own_points import robot_points
from pointsdf_cli.robot.start import start_configuration
from pointsdf_cli.viz.shading import look_at

ROBOT = load_robot()
HOME = ROBOT.home
POSE = look_at((1.5, 0.0, 0.9), (0.6, 0.0, 0.0))
LARGE, SMALL = (0.6, 0.2, 0.05), (0.6, -0.2, 0.03)


def sheet(centre: tuple[float, float, float], half: tuple[float, float, float]) -> np.ndarray:
    """The outside of a box, 5 mm apart."""
    axes = [np.arange(-h, h + 1e-9, 0.005) for h in half]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    on_face = (np.abs(np.abs(grid) - [a.max() for a in axes]) < 1e-6).any(axis=1)
    return grid[on_face] + centre


TABLE = sheet((0.6, 0.0, 0.0), (0.35, 0.5, 0.0))
THINGS = np.concatenate([sheet(LARGE, (0.04, 0.04, 0.05)), sheet(SMALL, (0.03, 0.03, 0.03))])


def cloud(world: np.ndarray) -> Cloud:
    points = apply_transform(invert_transform(POSE), world)
    return Cloud(points, frame="camera", T_world_camera=POSE)


def test_the_largest_thing_is_taken_or_the_one_that_is_meant() -> None:
    scene = cloud(np.concatenate([TABLE, THINGS]))
    seen = look_at_table([scene], ["a.ply"], ROBOT, HOME)
    np.testing.assert_allclose(seen.views[0].in_world.mean(axis=0)[:2], LARGE[:2], atol=0.01)
    np.testing.assert_allclose(seen.others.mean(axis=0)[:2], SMALL[:2], atol=0.01)
    assert seen.table_height == pytest.approx(0.0, abs=1e-3)
    assert "kept" in seen.report[0]
    seen = look_at_table([scene], ["a.ply"], ROBOT, HOME, target=np.array(SMALL))
    np.testing.assert_allclose(seen.views[0].in_world.mean(axis=0)[:2], SMALL[:2], atol=0.01)
    with pytest.raises(NoObjectError, match="nearest to --target"):
        look_at_table([scene], ["a.ply"], ROBOT, HOME, target=np.array([0.9, 0.0, 0.1]))


def test_another_camera_is_asked_for_the_same_thing() -> None:
    both = np.concatenate([TABLE, THINGS])
    # The second camera sees more of the smaller thing.
    second = np.concatenate([TABLE, THINGS, sheet(SMALL, (0.03, 0.03, 0.03)) + 0.0025])
    seen = look_at_table([cloud(both), cloud(second)], ["a", "b"], ROBOT, HOME)
    assert len(seen.views) == 2
    for view in seen.views:
        np.testing.assert_allclose(view.in_world.mean(axis=0)[:2], LARGE[:2], atol=0.01)


def test_a_number_of_the_first_camera_is_not_looked_for_in_another() -> None:
    """An object of one camera that is too wide to be grasped: no other object is taken for it."""
    wide = cloud(np.concatenate([TABLE, sheet((0.6, 0.0, 0.05), (0.32, 0.32, 0.05))]))
    other = cloud(np.concatenate([TABLE, THINGS]))
    number = TargetChoice(number=1)
    with pytest.raises(NoObjectError, match="wide or more"):
        look_at_table([wide, other], ["a", "b"], ROBOT, HOME, target=number)
    # A place is meant in every camera alike.
    place = np.array(LARGE)
    seen = look_at_table([cloud(TABLE), other], ["a", "b"], ROBOT, HOME, target=place)
    assert len(seen.views) == 1


def test_a_mask_of_another_object_in_the_second_camera_is_told() -> None:
    first = cloud(np.concatenate([TABLE, THINGS]))
    wrong = replace(first, mask=first_mask(first, SMALL))
    right = replace(first, mask=first_mask(first, LARGE))
    seen = look_at_table([right, wrong], ["a", "b"], ROBOT, HOME)
    assert len(seen.views) == 1
    assert "b: the object is not seen" in seen.report[1]
    assert len(look_at_table([right, right], ["a", "b"], ROBOT, HOME).views) == 2


def test_a_mask_counts_without_segmentation_too() -> None:
    view = cloud(np.concatenate([TABLE, THINGS]))
    mask = first_mask(view, SMALL)
    seen = look_at_table([replace(view, mask=mask)], ["a"], ROBOT, HOME, segment="none")
    points = seen.views[0].in_world
    assert len(points) <= mask.sum()
    np.testing.assert_allclose(points.mean(axis=0)[:2], SMALL[:2], atol=0.01)


def first_mask(view: Cloud, centre: tuple[float, float, float]) -> np.ndarray:
    """Mask of a view's points above the table within 6 cm of a place."""
    world = apply_transform(POSE, view.points)
    return (np.linalg.norm(world[:, :2] - centre[:2], axis=1) < 0.06) & (world[:, 2] > 0.01)


def test_the_robot_is_no_object() -> None:
    q = HOME.copy()
    own = robot_points(ROBOT, q)
    small = np.concatenate([TABLE, sheet(SMALL, (0.03, 0.03, 0.03)), own])
    seen = look_at_table([cloud(small)], ["a"], ROBOT, q)
    np.testing.assert_allclose(seen.views[0].in_world.mean(axis=0)[:2], SMALL[:2], atol=0.01)
    assert "on the robot" in seen.report[0]
    assert not len(seen.others)


def test_only_the_workspace_is_looked_at() -> None:
    scene = cloud(np.concatenate([TABLE, THINGS]))
    x, y = SMALL[:2]
    around = workspace_of(((x - 0.1, y - 0.1, -0.05), (x + 0.1, y + 0.1, 0.3)))
    seen = look_at_table([scene], ["a"], ROBOT, HOME, workspace=around)
    np.testing.assert_allclose(seen.views[0].in_world.mean(axis=0)[:2], SMALL[:2], atol=0.01)
    assert not len(seen.others)  # what stands outside is no obstacle
    with pytest.raises(InputError, match="--workspace"):
        look_at_table([scene], ["a"], ROBOT, HOME, segment="none", workspace=around)
    beyond = workspace_of(((5.0, 5.0, 0.0), (6.0, 6.0, 1.0)))
    with pytest.raises(NoObjectError, match="no object") as caught:
        look_at_table([scene], ["a"], ROBOT, HOME, workspace=beyond)
    assert "--workspace" in str(caught.value)


def test_a_bare_table_holds_no_object() -> None:
    with pytest.raises(NoObjectError, match="no object"):
        look_at_table([cloud(TABLE)], ["a"], ROBOT, HOME)


def test_a_cloud_needs_a_pose_and_metres() -> None:
    scene = cloud(np.concatenate([TABLE, THINGS]))
    with pytest.raises(InputError, match="camera-pose"):
        look_at_table([Cloud(scene.points)], ["a"], ROBOT, HOME)
    millimetres = Cloud(scene.points * 1000, T_world_camera=POSE)
    with pytest.raises(InputError, match="unit mm"):
        look_at_table([millimetres], ["a"], ROBOT, HOME)
    with pytest.raises(InputError, match="auto, none"):
        look_at_table([scene], ["a"], ROBOT, HOME, segment="yes")


def test_obstacles_have_their_sizes() -> None:
    pose = np.eye(4)
    pose[:3, 3] = (1.0, 2.0, 3.0)
    for kind, size, extent in (
        ("box", (0.1, 0.2, 0.3), (0.1, 0.2, 0.3)),
        ("cylinder", (0.1, 0.3), (0.2, 0.2, 0.3)),
        ("sphere", (0.1,), (0.2, 0.2, 0.2)),
    ):
        vertices, _ = obstacle_mesh(Obstacle("a", kind, size, pose))
        np.testing.assert_allclose(np.ptp(vertices, axis=0), extent, atol=0.01)
        np.testing.assert_allclose((vertices.max(axis=0) + vertices.min(axis=0)) / 2, (1, 2, 3))


def test_a_start_is_typed_for_the_arm_or_for_all() -> None:
    np.testing.assert_array_equal(start_configuration(None, ROBOT), HOME)
    arm = start_configuration("0.1 0.2,0.3;0.4 0.5 0.6 0.7", ROBOT)
    np.testing.assert_allclose(arm[:7], np.arange(1, 8) / 10)
    np.testing.assert_array_equal(arm[7:], HOME[7:])
    with pytest.raises(InputError, match="3 joint positions"):
        start_configuration("1,2,3", ROBOT)
    with pytest.raises(InputError, match="beyond its limit"):
        start_configuration("0,0,0,0,0,0,9", ROBOT)
    panda = load_robot(asset_path("robots/panda.yaml"))
    home = "0,-0.4,0,-2.2,0,1.9,0.785,0.04,"
    assert start_configuration(f"{home}0.0397", panda)[-1] == 0.0397
    with pytest.raises(InputError, match="does not follow panda_finger_joint1"):
        start_configuration(f"{home}0.02", panda)
    with pytest.raises(InputError, match="beyond its limit"):
        start_configuration(np.full(7, np.nan), ROBOT)
    with pytest.raises(InputError, match=r"0\.05 m is beyond.*\n.*0 to 0\.04 m"):
        start_configuration("0,-0.4,0,-2.2,0,1.9,0.785,0.05,0.05", load_robot("panda"))


def test_it_does_not_matter_which_camera_comes_first() -> None:
    both = np.concatenate([TABLE, THINGS])
    blind = cloud(TABLE)
    for clouds in ([cloud(both), blind], [blind, cloud(both)]):
        seen = look_at_table(clouds, ["a", "b"], ROBOT, HOME)
        assert len(seen.views) == 1
        assert sum("is not seen" in line for line in seen.report) == 1


@pytest.mark.parametrize(("off", "said"), [(0.0, ""), (0.03, "z = 30 mm"), (-0.06, "below it")])
def test_a_pose_at_the_wrong_height_is_doubted(off: float, said: str) -> None:
    scene = cloud(np.concatenate([TABLE, THINGS]) + [0.0, 0.0, off])
    seen = look_at_table([scene], ["a"], ROBOT, HOME)
    doubt = table_warning(seen.table_height, [in_world(scene)])
    assert said in doubt
    assert bool(doubt) == bool(said)


def test_a_scene_without_anything_at_the_table_is_doubted() -> None:
    aloft = np.concatenate([TABLE, THINGS]) + [0.0, 0.0, 0.8]
    assert "nothing is seen at z = 0" in table_warning(None, [aloft])
    assert table_warning(None, [THINGS]) == ""


def test_a_place_and_no_segmentation_contradict_each_other() -> None:
    scene = cloud(THINGS)
    with pytest.raises(InputError, match="--segment auto"):
        look_at_table([scene], ["a"], ROBOT, HOME, segment="none", target=LARGE)


def test_an_obstacle_may_be_in_millimetres_and_as_large_as_a_wall(tmp_path: Path) -> None:
    trimesh.creation.box((3000, 100, 2000)).export(tmp_path / "wall.stl")
    entry = "obstacles: [{name: wall, mesh: wall.stl, scale: 0.001, xyz: [0, 1, 1]}]"
    (tmp_path / "e.yaml").write_text(entry)
    (wall,) = read_environment(tmp_path / "e.yaml").obstacles
    np.testing.assert_allclose(np.ptp(wall.vertices, axis=0), (3.0, 0.1, 2.0), atol=1e-6)


POST = sheet((0.6, -0.3, 0.1), (0.015, 0.015, 0.1))


def test_a_neighbour_is_not_taken_for_the_object() -> None:
    target = sheet((0.6, 0.1, 0.06), (0.03, 0.03, 0.05))
    beside = sheet((0.6, 0.0, 0.06), (0.02, 0.02, 0.04))  # 5 cm of room between them
    first, second = np.concatenate([TABLE, target, beside]), np.concatenate([TABLE, beside])
    seen = look_at_table([cloud(first), cloud(second)], ["a", "b"], ROBOT, HOME)
    assert len(seen.views) == 1
    assert "b: the object is not seen" in seen.report[1]
    # Even where the first camera did not see the neighbour at all.
    alone = np.concatenate([TABLE, target])
    seen = look_at_table([cloud(alone), cloud(second)], ["a", "b"], ROBOT, HOME)
    assert len(seen.views) == 1
    np.testing.assert_allclose(seen.others.mean(axis=0)[:2], (0.6, 0.0), atol=0.01)


def test_a_camera_without_the_object_still_sees_what_is_in_the_way() -> None:
    first = np.concatenate([TABLE, sheet(LARGE, (0.04, 0.04, 0.05))])
    seen = look_at_table(
        [cloud(first), cloud(np.concatenate([TABLE, POST]))], ["a", "b"], ROBOT, HOME
    )
    assert len(seen.views) == 1
    assert len(hulls(seen.others)) == 1


class Scene:
    """A planner that keeps the scene that it is given.

    What is tested is what `plan_on_table` makes of cloud and environment; the search has tests of
    its own.
    """

    robot, shape = ROBOT, None
    options = SimpleNamespace(planner=PlannerConfig())

    def warnings(self) -> list[str]:
        return []

    def see(self, views: Any, seed: int, table: bool = True) -> object:
        return object()

    def plan_seen(self, perceived: object, environment: Environment, *_: Any, **__: Any) -> Any:
        self.environment = environment
        return SimpleNamespace(plan=None)


def test_known_obstacles_stay_beside_what_is_seen() -> None:
    post = Obstacle("post", "box", (0.1, 0.1, 0.4), transform(np.eye(3), [0.3, 0.6, 0.2]))
    scene = Scene()
    both = [cloud(np.concatenate([TABLE, THINGS]))]
    plan_on_table(scene, both, ["a"], Environment((post,)), obstacles="hull")  # type: ignore[arg-type]
    names = [one.name for one in scene.environment.obstacles]
    assert names[0] == "post"
    assert len(names) == 2  # and the smaller thing


def test_the_robot_keeps_above_a_table_that_is_seen_higher() -> None:
    scene = Scene()
    raised = np.concatenate([TABLE, THINGS]) + [0, 0, 0.025]
    plan_on_table(scene, [cloud(raised)], ["a"], obstacles="hull")  # type: ignore[arg-type]
    assert scene.environment.table_height == pytest.approx(0.025, abs=0.002)


def test_the_height_of_a_tilted_table_is_that_below_the_object() -> None:
    tilt = trimesh.transformations.rotation_matrix(np.deg2rad(2), (0, 1, 0))
    scene = cloud(apply_transform(tilt, np.concatenate([TABLE, THINGS])))
    seen = look_at_table([scene], ["a"], ROBOT, HOME)
    assert seen.table_height == pytest.approx(-0.6 * np.tan(np.deg2rad(2)), abs=0.002)


def test_what_a_mask_leaves_of_its_object_is_no_obstacle() -> None:
    scene = cloud(np.concatenate([TABLE, THINGS]))
    mask = first_mask(scene, LARGE) & (apply_transform(POSE, scene.points)[:, 2] > 0.016)
    seen = look_at_table([replace(scene, mask=mask)], ["a"], ROBOT, HOME)
    assert "beside the mask" in seen.report[0]
    assert seen.others[:, 1].max() < 0  # the smaller thing alone
    label = seen.labelled[0][0].objects.label
    assert not (label == LOOSE).any()


def test_a_small_workspace_still_has_a_table() -> None:
    scene = cloud(np.concatenate([TABLE, THINGS]))
    around = workspace_of(((0.5, 0.1, -0.05), (0.7, 0.3, 0.3)))
    points = look_at_table([scene], ["a"], ROBOT, HOME, workspace=around).views[0].in_world
    assert np.ptp(points[:, :2], axis=0).max() < 0.09


def test_a_camera_that_does_not_see_the_object_does_not_move_the_table() -> None:
    def at(height: float) -> Any:
        plane = np.array([0.0, 0.0, 1.0, height])
        objects = SimpleNamespace(plane=plane, label=np.zeros(3, dtype=int))
        return SimpleNamespace(objects=objects, world=np.zeros((3, 3)))

    assert table_height([(at(0.0), 0), (at(0.02), -1)]) == 0.0


def test_another_cameras_object_is_the_same_if_nothing_else_is_nearer() -> None:
    here, there = np.zeros((1, 3)), np.array([[0.02, 0.0, 0.0]])
    FirstView(there, np.zeros((0, 3))).check(here, "b")
    with pytest.raises(NoObjectError):
        FirstView(there, np.array([[0.01, 0.0, 0.0]])).check(here, "b")


TWINS = [(0.6, y, 0.05) for y in (-0.055, 0.055)]
"""Two boxes 8 cm wide with 3 cm between them."""
BETWEEN = sheet((0.6, 0.0, 0.05), (0.04, 0.015, 0.0))
"""A bridge that makes them one group, as flying pixels do."""


def test_a_place_is_meant_in_every_camera() -> None:
    """The first camera sees two things as one; the middle of that is not what was asked for."""
    apart = np.concatenate([TABLE, *(sheet(place, (0.04, 0.04, 0.05)) for place in TWINS)])
    merged = np.concatenate([apart, BETWEEN])
    for place in TWINS:
        target = np.array(place) + [0.0, 0.01 * np.sign(place[1]), 0.04]
        seen = look_at_table([cloud(merged), cloud(apart)], ["a", "b"], ROBOT, HOME, target=target)
        np.testing.assert_allclose(seen.views[1].in_world.mean(axis=0)[:2], place[:2], atol=0.01)


def test_a_group_that_joins_the_object_to_another_is_no_obstacle_there() -> None:
    apart = np.concatenate([TABLE, *(sheet(place, (0.04, 0.04, 0.05)) for place in TWINS)])
    merged = np.concatenate([apart, BETWEEN])
    target = np.array(TWINS[0])
    seen = look_at_table([cloud(apart), cloud(merged)], ["a", "b"], ROBOT, HOME, target=target)
    assert len(seen.views) == 1
    assert "b: the object is not seen" in seen.report[1]
    view, label = seen.labelled[1]
    assert label == -1
    left = view.world[view.objects.label >= 0]
    assert left[:, 1].min() > -0.001
    np.testing.assert_allclose(left.max(axis=0), np.array(TWINS[1]) + [0.04, 0.04, 0.05], atol=0.01)


def test_rays_to_what_is_too_far_for_a_cloud_are_free() -> None:
    """Seen from a low camera, the room behind the table shows where the object ends."""
    pose = look_at((1.3, 0.0, 0.15), (0.6, 0.0, 0.06))
    can = scenes.can(0.03, 0.12, (0.6, 0.0))
    depth = scenes.seen(scenes.table(), can, pose=pose)
    room = np.where(depth > 0, depth, 4.0)
    free = {}
    for name, image in (("nothing", depth), ("room", room)):
        view = cloud_of_depth(image, scenes.CAMERA, pose, farthest=2.5)
        (seen,) = look_at_table([view], ["a"], None, np.zeros(0)).views
        above = seen.evidence.visibility.free[2]
        free[name] = float((above > 0).mean())
    assert free["nothing"] < 0.1
    assert free["room"] > 0.9


def test_an_object_of_very_many_points_is_thinned() -> None:
    rng = np.random.default_rng(0)
    many = rng.uniform((0.5, -0.1, 0.05), (0.7, 0.1, 0.055), (120_000, 3))
    seen = look_at_table([cloud(np.concatenate([TABLE, many]))], ["a"], ROBOT, HOME, cleaned=False)
    assert 1000 < len(seen.views[0].points) < 30_000
    assert "kept 12" in seen.report[0]
