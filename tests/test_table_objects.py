"""Objects on a table are found, each once and whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pointsdf_cli.assets import asset_path
from pointsdf_cli.camera.depth_cloud import cloud_of_depth
from pointsdf_cli.camera.hollow import whole_bowls
from pointsdf_cli.camera.segmentation import SegmentationConfig
from pointsdf_cli.camera.support_plane import _upright, find_support_plane, pose_over_plane
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.geometry.voxels import thin
from pointsdf_cli.io.clouds import read_cloud
from pointsdf_cli.planning.labelled_view import LabelledView, describe, label_view, sighting
from pointsdf_cli.planning.object_choice import (
    ListedObject,
    NoObjectError,
    Reach,
    TargetChoice,
    choose,
    numbered,
    reach_of,
)
from pointsdf_cli.planning.take_order import take_order
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.viz.shading import look_at
from tests import scenes

WORKSPACE = SegmentationConfig(low=(0.2, -0.9, -0.05), high=(1.6, 0.9, 0.6))


def labelled(*things: object, **options: object) -> LabelledView:
    return label_view(scenes.cloud(scenes.seen(scenes.table(), *things)), "a", WORKSPACE, **options)


def centres(scene: LabelledView) -> np.ndarray:
    return np.array([thing.centre[:2] for thing in scene.listed if thing.stands])


def test_two_things_have_their_places_and_sizes() -> None:
    scene = labelled(
        scenes.box((0.06, 0.08, 0.12), (0.6, 0.1)), scenes.can(0.035, 0.1, (0.55, -0.15))
    )
    assert len(scene.listed) == 2
    found = {round(float(thing.centre[1]), 1): thing for thing in scene.listed}
    # Of the box at least its top is seen, which has its full size.
    assert found[0.1].size == pytest.approx([0.08, 0.06, 0.12], abs=0.008)
    assert found[0.1].centre[:2] == pytest.approx([0.6, 0.1], abs=0.008)
    assert found[-0.1 if -0.1 in found else -0.2].size[2] == pytest.approx(0.1, abs=0.006)
    assert [thing.number for thing in scene.listed] == [1, 2]


def test_a_foot_that_the_camera_cannot_see_stands() -> None:
    """From straight above only the top of a box is seen, behind another only its upper part."""
    above = look_at((0.6, 0.0, 0.9), (0.601, 0.0, 0.0))
    tall = scenes.box((0.07, 0.06, 0.12), (0.6, 0.0))
    view = scenes.cloud(scenes.seen(scenes.table(), tall, pose=above), above)
    (item,) = label_view(view, "a", WORKSPACE).listed
    assert item.stands
    assert item.size == pytest.approx([0.07, 0.06, 0.12], abs=0.008)

    wide = scenes.box((0.06, 0.2, 0.14), (0.75, 0.0))
    scene = labelled(wide, scenes.box((0.06, 0.06, 0.26), (0.55, 0.0)))
    assert [thing.stands for thing in scene.listed] == [True, True]
    assert sorted(thing.size[2] for thing in scene.listed) == pytest.approx([0.14, 0.26], abs=0.01)
    # What hangs where the table below it is seen does not stand.
    hanging = scenes.box((0.06, 0.06, 0.06), (0.6, 0.2))
    hanging.apply_translation((0.0, 0.0, 0.2))
    assert [thing.stands for thing in labelled(wide, hanging).listed] == [True, False]


def test_heights_begin_at_the_table_that_is_seen() -> None:
    for height in (-0.03, 0.02):
        pose = scenes.POSE.copy()
        pose[2, 3] += height
        view = scenes.cloud(
            scenes.seen(scenes.table(), scenes.box((0.06, 0.08, 0.12), (0.6, 0.0))), pose
        )
        (item,) = label_view(view, "a", WORKSPACE).listed
        assert item.size[2] == pytest.approx(0.12, abs=0.006)


def test_the_parts_of_the_report_add_up() -> None:
    scene = labelled(
        scenes.box((0.06, 0.08, 0.12), (0.6, 0.1)), scenes.can(0.035, 0.1, (0.55, -0.15))
    )
    first = scene.listed[0]
    said = describe(scene, first, sighting(scene, first))
    assert "object 1 of 2" in said
    kept = int(said.split("kept ")[1].split()[0])
    total = int(said.split(" of ")[2].split()[0])
    dropped = [int(part.split()[0]) for part in said.split("dropped ")[1].split(", ")]
    assert kept + sum(dropped) == total == len(scene.cloud.points)


def test_an_object_cut_by_a_small_workspace_is_said_to_go_on() -> None:
    long = scenes.box((0.06, 0.4, 0.12), (0.6, 0.0))
    view = scenes.cloud(scenes.seen(scenes.table(), long))
    small = replace(WORKSPACE, low=(0.2, -0.05, -0.05))
    for workspace, told in ((small, True), (WORKSPACE, False)):
        scene = label_view(view, "a", workspace)
        first = scene.listed[0]
        said = describe(scene, first, sighting(scene, first))
        assert ("widen --workspace" in said) == told


def test_an_object_cut_by_the_image_is_said_to_be() -> None:
    depth = scenes.seen(scenes.table(), scenes.box((0.06, 0.08, 0.12), (0.6, 0.0)))
    # A RealSense measures nothing in a strip along the left border: it is no part of the image.
    strip, half = depth.copy(), depth.copy()
    strip[:, :60], half[:, :320] = 0.0, 0.0
    whole = scenes.CAMERA
    right = replace(whole, width=320, cx=whole.cx - 320)
    for image, camera, told in ((strip, whole, False), (half[:, 320:], right, True)):
        scene = label_view(cloud_of_depth(image, camera, scenes.POSE), "a", WORKSPACE)
        first = scene.listed[0]
        said = describe(scene, first, sighting(scene, first))
        assert ("the image's border cuts it off" in said) == told


def test_the_middle_of_the_image_is_meant_and_not_the_largest() -> None:
    large = scenes.box((0.12, 0.12, 0.2), (0.6, 0.3))
    scene = labelled(large, scenes.can(0.03, 0.08, (0.6, 0.0)))
    assert scene.listed[0].centre[1] == pytest.approx(0.0, abs=0.01)
    assert scene.listed[0].points < scene.listed[1].points


def test_what_the_robot_reaches_is_meant() -> None:
    robot = load_robot()
    reach = reach_of(robot)
    assert 0.1 < reach.near < 0.6 < reach.far < 1.3
    # The reach goes with the robot's base, wherever that stands.
    moved = reach_of(replace(robot, T_world_base=transform(np.eye(3), [0.25, -0.5, 0.0])))
    np.testing.assert_allclose(moved.base, [0.25, -0.5])
    assert moved[1:] == pytest.approx(reach[1:], abs=1e-9)
    assert reach.beyond(np.array([reach.far + 0.1, 0.0])) == pytest.approx(0.1)
    assert moved.beyond(np.array([0.25, reach.far - 0.5 + 0.1, 0.3])) == pytest.approx(0.1)
    assert moved.beyond(np.array([0.25 + reach.near, -0.5])) == 0.0
    beyond, reached = scenes.can(0.03, 0.1, (1.15, 0.0)), scenes.can(0.03, 0.1, (0.6, 0.12))
    pose = look_at((1.6, 0.0, 0.8), (1.1, 0.0, 0.0))
    view = scenes.cloud(scenes.seen(scenes.table(), beyond, reached, pose=pose), pose)
    middle = label_view(view, "a", WORKSPACE).listed[0]
    assert middle.centre[0] == pytest.approx(1.15, abs=0.02)
    arm = label_view(view, "a", WORKSPACE, reach=Reach(np.zeros(2), 0.3, 0.75)).listed[0]
    assert arm.centre[0] == pytest.approx(0.6, abs=0.02)


def test_what_fits_the_jaws_is_meant() -> None:
    wide, narrow = scenes.can(0.05, 0.12, (0.6, 0.0)), scenes.can(0.03, 0.12, (0.6, 0.16))
    view = scenes.cloud(scenes.seen(scenes.table(), wide, narrow))
    for name, side in (("lbr4_allegro", 0.0), ("panda", 0.16), ("lbr4_barrett", 0.0)):
        reach = reach_of(load_robot(name))
        scene = label_view(view, "a", WORKSPACE, reach=reach)
        assert scene.listed[0].centre[1] == pytest.approx(side, abs=0.02), name
        order = take_order(scene, reach)
        assert [one.fits for one in order] == [True, name != "panda"]
    assert reach_of(load_robot("panda")).opening == pytest.approx(0.074, abs=1e-6)
    assert order[0].item.centre[1] == pytest.approx(0.0, abs=0.02)


def test_a_bowl_is_one_thing_with_its_floor() -> None:
    scene = labelled(scenes.bowl((0.6, 0.0)))
    assert len(scene.listed) == 1
    seen = sighting(scene, scene.listed[0])
    world = (scene.T_world_camera[:3, :3] @ seen.object_points.T).T + scene.T_world_camera[:3, 3]
    from_axis = np.linalg.norm(world[:, :2] - (0.6, 0.0), axis=1)
    # The floor is 3 mm high, below the band in which points are the table's.
    assert ((from_axis < 0.03) & (world[:, 2] < 0.005)).sum() > 100
    assert from_axis.max() < 0.085


def test_the_table_seen_through_a_handle_is_no_floor() -> None:
    handle = scenes.trimesh.creation.torus(0.03, 0.005)
    turn = scenes.trimesh.transformations.rotation_matrix
    handle.apply_transform(turn(np.pi / 2, (1, 0, 0)))
    handle.apply_transform(turn(np.pi / 2, (0, 0, 1)))
    handle.apply_translation((0.6, 0.05, 0.05))
    scene = labelled(scenes.can(0.042, 0.1, (0.6, 0.0)), handle)
    assert len(scene.listed) == 1
    seen = sighting(scene, scene.listed[0])
    world = (scene.T_world_camera[:3, :3] @ seen.object_points.T).T + scene.T_world_camera[:3, 3]
    low = world[:, 2] < 0.004
    assert not (low & (np.linalg.norm(world[:, :2] - (0.6, 0.0), axis=1) > 0.047)).any()
    assert (world[:, 1] > 0.07).sum() > 100  # the handle itself


def test_touching_cans_are_told_apart() -> None:
    scene = labelled(scenes.can(0.035, 0.1, (0.6, -0.035)), scenes.can(0.04, 0.14, (0.6, 0.04)))
    assert len(scene.listed) == 2
    sides = sorted(float(thing.centre[1]) for thing in scene.listed)
    assert sides == pytest.approx([-0.035, 0.04], abs=0.01)


def test_one_thing_on_another_is_left_together_and_said_so() -> None:
    upper = scenes.box((0.08, 0.06, 0.05), (0.58, 0.0))
    upper.apply_translation((0, 0, 0.06))
    scene = labelled(scenes.box((0.12, 0.16, 0.06), (0.6, 0.0)), upper)
    assert len(scene.listed) == 1
    (thing,) = scene.listed
    assert thing.unsplit
    assert "several objects in contact" in describe(scene, thing, sighting(scene, thing))


@pytest.mark.parametrize("roll", [0.0, 0.3])
def test_the_table_is_found_without_a_pose(roll: float) -> None:
    # A floor and a wall are larger than the table, and the object stands on the table.
    floor = scenes.trimesh.creation.box((8, 8, 0.02))
    floor.apply_translation((0, 0, -0.7))
    wall = scenes.trimesh.creation.box((0.02, 6, 4))
    wall.apply_translation((-0.6, 0, 0))
    small = scenes.trimesh.creation.box((0.5, 0.5, 0.02))
    small.apply_translation((0.6, 0, -0.01))
    turn = scenes.trimesh.transformations.rotation_matrix(roll, (0, 0, 1))
    pose = scenes.POSE @ turn
    depth = scenes.seen(small, floor, wall, scenes.can(0.035, 0.12, (0.6, 0.0)), pose=pose)
    plane = find_support_plane(scenes.cloud(depth, None).points)
    found = pose_over_plane(plane)
    assert found[2, 3] == pytest.approx(pose[2, 3], abs=0.003)
    assert np.degrees(np.arccos(min(1.0, found[2, :3] @ pose[2, :3]))) < 0.3
    assert np.allclose(found[:3, :3] @ found[:3, :3].T, np.eye(3), atol=1e-9)


def test_no_table_is_said_so() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="no table"):
        find_support_plane(rng.uniform((-1, -1, 0.5), (1, 1, 2.5), (20_000, 3)))


def _two() -> LabelledView:
    return labelled(scenes.box((0.06, 0.06, 0.1), (0.6, 0.1)), scenes.can(0.03, 0.1, (0.6, -0.1)))


def _chosen(scene: LabelledView, target: TargetChoice) -> ListedObject:
    return choose(scene.listed, target, scene.world, scene.objects.label, scene.pixels, "a")


def test_a_number_a_pixel_and_a_place_name_the_same_thing() -> None:
    scene = _two()
    right = next(thing for thing in scene.listed if thing.centre[1] < 0)
    inside = np.linalg.inv(scenes.POSE) @ [0.6, -0.1, 0.09, 1.0]
    pixel = scenes.CAMERA.project(inside[:3])
    for target in (
        TargetChoice(number=right.number),
        TargetChoice(pixel=(float(pixel[0]), float(pixel[1]))),
        TargetChoice(place=np.array([0.6, -0.12, 0.05])),
    ):
        assert _chosen(scene, target) == right


def test_a_target_that_is_not_there_is_told() -> None:
    scene = _two()
    with pytest.raises(InputError, match="no object 3") as caught:
        _chosen(scene, TargetChoice(number=3))
    assert "1 at" in str(caught.value)
    assert "2 at" in str(caught.value)
    with pytest.raises(NoObjectError, match="pixel"):
        _chosen(scene, TargetChoice(pixel=(5.0, 400.0)))
    with pytest.raises(InputError, match="has no image"):
        choose(
            scene.listed, TargetChoice(pixel=(1, 1)), scene.world, scene.objects.label, None, "a"
        )


def test_thinning_keeps_one_point_a_voxel() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 0.1, (5000, 3))
    first, voxel = thin(points, 0.02)
    assert len(first) == 125
    cell = np.floor((points - points.min(axis=0)) / 0.02)
    assert np.array_equal(cell[first][voxel], cell)
    with pytest.raises(InputError, match="unit"):
        thin(np.array([[0, 0, 0], [1e9, 1e9, 1e9]]), 1e-3)


def test_numbers_begin_with_one() -> None:
    scene = _two()
    listed = numbered(
        scene.world, np.zeros((len(scene.world), 2)), scene.objects, np.array([True, True])
    )
    assert [thing.number for thing in listed] == [1, 2]


def test_what_could_not_be_told_apart_is_said_of_the_part_that_holds_it() -> None:
    # A can and a block touch; a box lies on the block, so that it does not stand by itself.
    on_top = scenes.box((0.08, 0.06, 0.05), (0.58, 0.0))
    on_top.apply_translation((0, 0, 0.06))
    scene = labelled(
        scenes.box((0.12, 0.12, 0.06), (0.6, 0.0)), on_top, scenes.can(0.035, 0.1, (0.6, -0.095))
    )
    assert len(scene.listed) == 2
    block = next(thing for thing in scene.listed if thing.centre[1] > -0.05)
    can = next(thing for thing in scene.listed if thing.centre[1] < -0.05)
    assert block.unsplit
    assert not can.unsplit


def test_the_middle_one_of_a_row_is_meant_although_another_is_a_little_larger() -> None:
    middle = scenes.box((0.05, 0.07, 0.12), (0.6, 0.0))
    scene = labelled(
        middle, scenes.box((0.06, 0.08, 0.13), (0.6, 0.14)), scenes.can(0.045, 0.13, (0.6, -0.14))
    )
    assert scene.listed[0].centre[1] == pytest.approx(0.0, abs=0.01)


def test_a_wall_far_behind_the_table_does_not_stand_on_it() -> None:
    wall = scenes.trimesh.creation.box((0.02, 3.0, 0.8))
    wall.apply_translation((-0.6, 0, 0.1))
    small = scenes.trimesh.creation.box((0.5, 0.7, 0.02))
    small.apply_translation((0.6, 0, -0.01))
    view = scenes.cloud(scenes.seen(small, wall, scenes.can(0.035, 0.12, (0.6, 0.0))))
    anywhere = SegmentationConfig(low=(-5.0, -5.0, -0.05), high=(5.0, 5.0, 0.6))
    scene = label_view(view, "a", anywhere)
    assert len(scene.listed) == 2
    assert [thing.stands for thing in scene.listed] == [True, False]


def test_the_table_is_found_by_a_camera_upside_down() -> None:
    turn = scenes.trimesh.transformations.rotation_matrix(np.pi, (0, 0, 1))
    wall = scenes.trimesh.creation.box((0.02, 6, 4))
    wall.apply_translation((-0.3, 0, 0))
    for things in ([], [wall]):
        depth = scenes.seen(
            scenes.table(), scenes.can(0.035, 0.12, (0.6, 0.0)), *things, pose=scenes.POSE @ turn
        )
        plane = find_support_plane(scenes.cloud(depth, None).points)
        assert pose_over_plane(plane)[2, 3] == pytest.approx(scenes.POSE[2, 3], abs=0.003)


def test_one_cloud_has_one_plane() -> None:
    """A bare object, whose planes are many and none is a table."""
    cloud = read_cloud(asset_path("clouds/power_drill.ply"))
    planes = {tuple(find_support_plane(cloud.points)) for _ in range(6)}
    assert len(planes) == 1


def test_a_ceiling_counts_less_than_a_table() -> None:
    # The camera's y points down: a table's normal up to the camera is -y.
    assert _upright(np.array([0.0, -1.0, 0.0, -1.0])) == 1.0
    assert _upright(np.array([0.0, 1.0, 0.0, -1.0])) == 0.25


@pytest.mark.parametrize("strip", [0.0, 0.012])
def test_two_walls_of_a_bowl_are_joined_by_a_floor_in_one_or_two_parts(strip: float) -> None:
    """Nothing returned at the sides of the rim, nor from a strip of the floor."""

    def wall(first: float, last: float) -> np.ndarray:
        share, angle = np.meshgrid(np.linspace(0, 1, 22), np.radians(np.linspace(first, last, 90)))
        share, angle = share.ravel(), angle.ravel()
        radius = 0.05 + 0.03 * share
        places = radius * np.cos(angle), radius * np.sin(angle), 0.006 + 0.045 * share
        return np.stack(places, axis=1)

    def ground(half: float, step: float, height: float) -> np.ndarray:
        x, y = np.meshgrid(*[np.arange(-half, half, step)] * 2)
        return np.stack([x.ravel(), y.ravel(), np.full(x.size, height)], axis=1)

    far, near = wall(101, 259), wall(-79, 79)
    floor, table = ground(0.05, 0.0025, 0.003), ground(0.3, 0.004, 0.0)
    from_axis = np.hypot(floor[:, 0], floor[:, 1])
    floor = floor[(from_axis < 0.048) & (np.abs(floor[:, 1]) >= strip)]
    table = table[np.hypot(table[:, 0], table[:, 1]) > 0.09]
    group = np.repeat([0, 1], [len(far), len(near)])
    flat = np.concatenate([floor, table])
    camera = np.array([0.65, 0.0, 0.55])
    joined, below = whole_bowls(np.concatenate([far, near]), group, flat, camera)
    assert len(np.unique(joined)) == 1
    assert (below[: len(floor)] >= 0).mean() > 0.7  # the near wall hides the rest
    assert (below[len(floor) :] < 0).all()
