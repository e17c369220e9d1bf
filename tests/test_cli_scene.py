"""Depth images go straight into segment, mesh and plan; bad ones get one message and code 2."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import binary_erosion

from pointsdf_cli.camera.depth_cloud import cloud_of_depth
from pointsdf_cli.camera.scene_file import SceneFileOptions, masked, read_view
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.io.clouds import Cloud, read_cloud, write_cloud
from pointsdf_cli.io.depth_images import read_mask
from pointsdf_cli.planning.list_objects import list_objects
from pointsdf_cli.planning.object_view import bare_view, segmented_view
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.inverse_kinematics import InverseKinematics
from pointsdf_cli.viz.shading import look_at
from tests import scenes

CAN, BOX = (0.6, -0.12), (0.62, 0.12)


@pytest.fixture
def scene(tmp_path: Path) -> list[Any]:
    depth = scenes.seen(
        scenes.table(), scenes.can(0.035, 0.12, CAN), scenes.box((0.06, 0.08, 0.1), BOX)
    )
    return scenes.write_scene(tmp_path, depth)


def listed(cli: Callable, scene: list[Any], *more: Any) -> list[dict[str, Any]]:
    picture = scene[0].parent / "s.png"
    done = cli("segment", *scene, *more, "--picture", picture, "--json", "--force")
    assert done.code == 0, done.err
    assert Image.open(picture).size == (640, 480)
    return list(json.loads(done.out)["objects"])


def options(scene: list[Any], **more: Any) -> SceneFileOptions:
    return SceneFileOptions(str(scene[2]), 1e-4, **more)


def test_segment_lists_what_stands_there(cli: Callable, scene: list[Any]) -> None:
    found = listed(cli, scene, "--camera-pose", scene[0].parent / "T.json")
    assert [one["number"] for one in found] == [1, 2]
    centres = sorted(one["centre"][1] for one in found)
    assert centres == pytest.approx([CAN[1], BOX[1]], abs=0.012)
    assert all(one["points"] > 1000 for one in found)


def test_a_pose_from_the_table_puts_the_object_in_reach(cli: Callable, scene: list[Any]) -> None:
    found = listed(cli, scene, "--camera-pose", "table:0.5,0.1")
    assert found[0]["centre"][:2] == pytest.approx([0.5, 0.1], abs=0.003)
    # How the things stand to each other does not change: they are 0.24 m apart.
    apart = np.subtract(found[0]["centre"], found[1]["centre"])[:2]
    assert np.linalg.norm(apart) == pytest.approx(0.24, abs=0.02)
    done = cli("segment", *scene, "--camera-pose", "table", "--picture", scene[0].parent / "t.png")
    assert "Only for trying out" in done.err


@pytest.mark.parametrize("organised", [True, False])
def test_a_mask_applies_to_arrays_of_points(cli: Callable, tmp_path: Path, organised: bool) -> None:
    depth = scenes.seen(scenes.can(0.035, 0.12, CAN))
    cloud = cloud_of_depth(depth, scenes.CAMERA)
    assert cloud.pixels is not None
    u, v = cloud.pixels.astype(int).T
    points = np.full((480, 640, 3), np.nan)
    points[v, u] = cloud.points
    Image.fromarray((np.arange(640) < u.mean()) & (depth > 0)).save(tmp_path / "mask.png")
    np.save(tmp_path / "cloud.npy", points if organised else cloud.points)
    K, path = str(tmp_path / "K.json"), tmp_path / "cloud.npy"
    Path(K).write_text(json.dumps(scenes.CAMERA.K.tolist()))
    reading = SceneFileOptions(K, mask=str(tmp_path / "mask.png"), drop_invalid=True)
    left = masked(read_view(path, reading)).points
    assert len(left) == np.count_nonzero(u < u.mean())
    np.save(path, cloud.points.T)
    with pytest.raises(InputError, match="transposed"):
        read_view(path, reading)
    np.save(path, points)
    done = cli("cloud", path, "--intrinsics", K, "--out", tmp_path / "o.ply")
    assert done.code == 2
    assert "a cloud already" in done.err


@pytest.mark.parametrize("pose", ["table", "T.json"])
def test_a_number_a_pixel_and_a_mask_name_the_same_object(
    cli: Callable, scene: list[Any], pose: str
) -> None:
    folder = scene[0].parent
    pose = pose if pose == "table" else str(folder / pose)
    found = listed(cli, scene, "--camera-pose", pose)
    sizes = {one["number"]: one["size"][2] for one in found}
    can = min(sizes, key=lambda k: abs(sizes[k] - 0.12))
    middle = np.linalg.inv(scenes.POSE) @ [*CAN, 0.1, 1.0]
    u, v = scenes.CAMERA.project(middle[:3])
    mask = np.zeros((480, 640), np.uint8)
    depth = scenes.seen(scenes.can(0.035, 0.12, CAN))
    mask[depth > 0] = 7
    Image.fromarray(mask).save(folder / "mask.png")
    views = [
        segmented_view(scene[0], options(scene), pose, str(can), None, None),
        segmented_view(scene[0], options(scene), pose, f"{u:.0f},{v:.0f}", None, None),
        segmented_view(
            scene[0],
            options(scene, mask=f"{folder / 'mask.png'}:7"),
            pose,
            None,
            None,
            None,
        ),
        bare_view(scene[0], options(scene, mask=str(folder / "mask.png")), None),
    ]
    top = np.linalg.inv(scenes.POSE) @ [*CAN, 0.06, 1.0]
    for view in views:
        away = np.median(view.points, axis=0) - top[:3]
        assert np.linalg.norm(away) < 0.04
        assert np.ptp(view.points, axis=0).max() < 0.14


def test_a_mask_a_pixel_too_small_grows_back_above_a_table(scene: list[Any]) -> None:
    folder = scene[0].parent
    whole = scenes.seen(scenes.can(0.035, 0.12, CAN)) > 0
    small = binary_erosion(whole)
    counts = {}
    for name, mask in (("whole", whole), ("small", small)):
        Image.fromarray(mask.astype(np.uint8)).save(folder / f"{name}.png")
        given = options(scene, mask=str(folder / f"{name}.png"))
        view = segmented_view(scene[0], given, "table", None, None, None)
        counts[name] = len(view.points)
    # The round side comes back in part: its rim is too steep to tell from an edge.
    lost = int(whole.sum() - small.sum())
    assert counts["whole"] - 0.5 * lost < counts["small"] <= counts["whole"]


def test_a_mask_without_a_pose_finds_the_table_under_the_object(scene: list[Any]) -> None:
    folder = scene[0].parent
    whole = scenes.seen(scenes.can(0.035, 0.12, CAN)) > 0
    Image.fromarray(binary_erosion(whole).astype(np.uint8)).save(folder / "small.png")
    given = options(scene, mask=str(folder / "small.png"))
    view = bare_view(scene[0], given, None)
    posed = segmented_view(scene[0], given, str(folder / "T.json"), None, None, None)
    assert view.evidence is not None
    assert view.evidence.support_plane is not None
    # The table is z = 0 of the world: its normal is the world's z axis, seen by the camera.
    normal, offset = view.evidence.support_plane[:3], view.evidence.support_plane[3]
    assert normal @ scenes.POSE[:3, :3].T @ [0, 0, 1] == pytest.approx(1.0, abs=1e-4)
    assert offset == pytest.approx(-scenes.POSE[2, 3], abs=0.003)
    # The mask grows as it does with the pose, and the mesh stays in the camera's frame.
    assert len(view.points) == pytest.approx(len(posed.points), rel=0.01)
    assert len(view.points) > binary_erosion(whole).sum()
    assert np.allclose(view.T_frame_camera, np.eye(4))


def test_a_generous_mask_says_nothing_about_what_is_beside_the_object(scene: list[Any]) -> None:
    folder = scene[0].parent
    own = scenes.seen(scenes.can(0.035, 0.12, CAN)) > 0
    rows, columns = np.nonzero(own)
    # Nothing returned in a strip beside the can, as in a stereo camera's shadow.
    depth = np.array(Image.open(scene[0]))
    strip = slice(rows.min(), rows.max()), slice(columns.max() + 2, columns.max() + 9)
    depth[strip] = 0
    Image.fromarray(depth).save(folder / "shadow.png")
    box = np.zeros_like(own)
    box[rows.min() - 15 : rows.max() + 16, columns.min() - 15 : columns.max() + 16] = True
    views = {}
    for name, mask in (("own", own), ("box", box)):
        Image.fromarray(mask.astype(np.uint8)).save(folder / f"{name}.png")
        given = options(scene, mask=str(folder / f"{name}.png"))
        views[name] = bare_view(folder / "shadow.png", given, None)
    assert len(views["box"].points) == pytest.approx(len(views["own"].points), rel=0.02)
    for view in views.values():
        assert view.evidence is not None
        image = view.evidence.visibility
        assert image is not None
        x, y = np.linalg.inv(scenes.CAMERA.K)[:2] @ [columns.max() + 5, np.median(rows), 1.0]
        at = (np.array([y, x]) - image.window[[1, 0]]) / image.window[[3, 2]] * len(image.seen)
        assert not image.seen[tuple(at.astype(int))]


def test_a_mask_of_what_stands_on_no_table_stays_as_it_is(tmp_path: Path) -> None:
    floating = scenes.box((0.06, 0.08, 0.1), BOX)
    floating.apply_translation([0, 0, 0.2])
    given = scenes.write_scene(tmp_path, scenes.seen(scenes.table(), floating))
    own = scenes.seen(floating) > 0
    Image.fromarray(own.astype(np.uint8)).save(tmp_path / "own.png")
    view = bare_view(given[0], options(given, mask=str(tmp_path / "own.png")), None)
    assert view.evidence is not None
    assert view.evidence.support_plane is None
    assert len(view.points) == pytest.approx(own.sum(), rel=0.05)


def test_a_mask_alone_tells_what_is_free_and_where_the_object_returned_nothing(
    scene: list[Any],
) -> None:
    folder = scene[0].parent
    own = scenes.seen(scenes.can(0.035, 0.12, CAN)) > 0
    Image.fromarray(own.astype(np.uint8)).save(folder / "own.png")
    rows, columns = np.nonzero(own)
    middle = int(np.median(rows)), int(np.median(columns))
    depth = np.array(Image.open(scene[0]))
    depth[middle[0] - 8 : middle[0] + 9, middle[1] - 8 : middle[1] + 9] = 0
    Image.fromarray(depth).save(folder / "holed.png")
    view = bare_view(folder / "holed.png", options(scene, mask=str(folder / "own.png")), None)
    assert view.evidence is not None
    image = view.evidence.visibility
    assert image is not None
    # Tangents of that pixel, and of the table in front of the can.
    K = scenes.CAMERA.K
    for row, seen, free in ((middle[0], True, False), (int(rows.max()) + 12, False, True)):
        x, y = np.linalg.inv(K)[:2] @ [middle[1], row, 1.0]
        at = (np.array([y, x]) - image.window[[1, 0]]) / image.window[[3, 2]] * len(image.seen)
        i, j = at.astype(int)
        assert image.seen[i, j] == seen
        assert (image.free[i, j] > 0) == free


def test_numbers_stay_when_the_world_moves_with_the_target(scene: list[Any]) -> None:
    listing = list_objects(scene[0], options(scene), "table")
    for thing in listing.objects:
        found = segmented_view(scene[0], options(scene), "table", str(thing.number), None, None)
        assert f"object {thing.number} of {len(listing.objects)}" in " ".join(found.notes)


def test_numbers_count_what_lies_where_the_robot_would_stand(tmp_path: Path) -> None:
    """The pose "table" puts the first box 0.6 m ahead of the robot, and the last one into it."""
    table = scenes.table(1.6)
    table.apply_scale((1.8, 1, 1))
    table.apply_translation((-0.8, 0, 0))
    boxes = [
        scenes.box((0.06, 0.06, 0.08), (0.6, 0.0)),
        scenes.box((0.08, 0.08, 0.1), (0.6, 0.35)),
        scenes.box((0.1, 0.1, 0.12), (0.0, 0.0)),
    ]
    pose = look_at((1.35, 0, 0.9), (0.45, 0, 0.0))
    given = scenes.write_scene(tmp_path, scenes.seen(table, *boxes, pose=pose))
    listing = list_objects(given[0], options(given), "table")
    assert [thing.number for thing in listing.objects] == [1, 2, 3]
    for number, count in listing.points.items():
        found = segmented_view(given[0], options(given), "table", str(number), None, None)
        assert f"kept {count} of" in " ".join(found.notes)


def test_a_pixel_outside_the_image_is_refused(scene: list[Any]) -> None:
    for pixel in ("640,100", "10,480", "-1,5"):
        with pytest.raises(InputError, match="outside of the image"):
            segmented_view(scene[0], options(scene), "table", pixel, None, None)


def test_cloud_and_depth_image_show_the_same_object(cli: Callable, scene: list[Any]) -> None:
    folder = scene[0].parent
    out = folder / "c.ply"
    done = cli("cloud", *scene, "--camera-pose", "table", "--out", out)
    assert done.code == 0, done.err
    assert read_cloud(out).T_world_camera is not None
    first = segmented_view(scene[0], options(scene), "table", None, None, None).points
    second = segmented_view(out, SceneFileOptions(), None, None, None, None).points
    assert np.median(first, axis=0) == pytest.approx(np.median(second, axis=0), abs=0.003)
    posed = cli("cloud", *scene, "--camera-pose", folder / "T.json", "--out", out, "--force")
    assert posed.code == 0
    assert np.allclose(read_cloud(out).T_world_camera, scenes.POSE)


def test_a_world_cloud_on_its_table_is_meshed_in_the_world(tmp_path: Path) -> None:
    seen = scenes.cloud(scenes.seen(scenes.table(), scenes.can(0.035, 0.12, CAN)))
    world = Cloud(apply_transform(scenes.POSE, seen.points), None, None, "world", scenes.POSE)
    write_cloud(tmp_path / "world.ply", world)
    view = segmented_view(tmp_path / "world.ply", SceneFileOptions(), "table", None, None, None)
    assert view.frame == "world"
    there = apply_transform(view.T_frame_camera, view.points)
    assert there.mean(axis=0)[:2] == pytest.approx(CAN, abs=0.04)
    assert there[:, 2].max() == pytest.approx(0.12, abs=0.01)


def test_mesh_of_a_depth_image_needs_no_pose(cli: Callable, scene: list[Any]) -> None:
    outs = {name: scene[0].parent / f"{name}.ply" for name in ("table", "none")}
    for name, out in outs.items():
        pose = ["--camera-pose", "table"] if name == "table" else []
        # 32 cells along the box are enough to see that it is made.
        done = cli("mesh", *scene, *pose, "--out", out, "--resolution", 32)
        assert done.code == 0, done.err
        assert "object 1 of 2" in done.err
    # Only the header of the one tells where the camera is.
    table, none = (out.read_bytes().partition(b"end_header") for out in outs.values())
    assert table[2] == none[2]
    assert b"T_world_camera" in table[0]
    assert b"T_world_camera" not in none[0]


def bad(folder: Path) -> dict[str, tuple[list[Any], str]]:
    """Arguments after the command, and what the message says."""
    K, T, good = folder / "K.json", folder / "T.json", folder / "depth.png"
    Image.fromarray(np.zeros((480, 640), np.uint16)).save(folder / "zero.png")
    Image.fromarray(np.full((480, 640), 90, np.uint8)).save(folder / "eight.png")
    Image.new("RGB", (640, 480), (9, 9, 9)).save(folder / "colour.png")
    Image.new("RGB", (640, 480), (9, 9, 9)).save(folder / "colour.jpg")
    Image.fromarray(np.ones((240, 320), np.uint8)).save(folder / "small.png")
    Image.fromarray(np.zeros((480, 640), np.uint8)).save(folder / "none.png")
    corner = np.zeros((480, 640), np.uint8)
    corner[440:, :40] = 3
    Image.fromarray(corner).save(folder / "corner.png")
    (folder / "K2.json").write_text(
        json.dumps({"K": scenes.CAMERA.K.tolist(), "width": 1280, "height": 720})
    )
    scale, pose = ["--depth-scale", 0.0001], ["--camera-pose", T]
    given = [good, "--intrinsics", K, *scale]
    return {
        "zero": ([folder / "zero.png", "--intrinsics", K, *pose], "0 everywhere"),
        "8 bit": ([folder / "eight.png", "--intrinsics", K, *pose], "picture of depths"),
        "colour": ([folder / "colour.png", "--intrinsics", K, *pose], "colour picture"),
        "jpeg": ([folder / "colour.jpg", "--intrinsics", K, *pose], "unknown format"),
        "no K": ([good, *scale, *pose], "add --intrinsics"),
        "other K": ([good, "--intrinsics", folder / "K2.json", *pose], "1280 × 720"),
        "no pose": (given, "--camera-pose table"),
        "mask size": ([*given, *pose, "--mask", folder / "small.png"], "320 × 240"),
        "empty mask": ([*given, *pose, "--mask", folder / "none.png"], "0 everywhere"),
        "no number": ([*given, *pose, "--mask", f"{folder / 'corner.png'}:4"], "numbers in it"),
        "table mask": ([*given, *pose, "--mask", folder / "corner.png"], "above the table"),
        "bad place": ([*given, "--camera-pose", "table:1"], "table:X,Y"),
        "scale of a cloud": ([folder / "c.ply", *scale, *pose], "--depth-scale"),
        "mask of a cloud": ([folder / "c.ply", "--mask", folder / "none.png", *pose], "intrinsics"),
    }


TARGETS = {
    "number": ("9", "no object 9"),
    "pixel": ("5,470", "no object at the pixel"),
    "far": ("9,9,9", "away from it"),
    "word": ("can", "neither numbers"),
    "four": ("1,2,3,4", "an object's number"),
}


def test_bad_input_is_one_message(cli: Callable, scene: list[Any]) -> None:
    folder = scene[0].parent
    write_cloud(folder / "c.ply", Cloud(np.random.default_rng(0).uniform(0.5, 1, (99, 3))))
    for name, (arguments, said) in bad(folder).items():
        for command in ("segment", "mesh", "plan"):
            if command == "mesh" and name in ("table mask", "no pose"):
                continue  # a mesh needs neither
            out = ["--picture", folder / "x.png"] if command == "segment" else []
            done = cli(command, *arguments, *out)
            assert done.code == 2, (name, command, done.err)
            assert said in done.err, (name, command, done.err)
            assert "Traceback" not in done.err
    assert not (folder / "x.png").exists()


@pytest.mark.parametrize("name", TARGETS)
def test_a_bad_target_is_one_message(cli: Callable, scene: list[Any], name: str) -> None:
    target, said = TARGETS[name]
    for pose in ("table", scene[0].parent / "T.json"):
        done = cli("mesh", *scene, "--camera-pose", pose, "--target", target)
        assert done.code == 2, done.err
        # The pose from the table makes the world in which a place could be meant.
        expected = "a place in the world" if (pose, name) == ("table", "far") else said
        assert expected in done.err


def test_intrinsics_far_from_the_middle_are_doubted(cli: Callable, scene: list[Any]) -> None:
    folder = scene[0].parent
    half = scenes.CAMERA.K / 2
    half[2, 2] = 1
    (folder / "half.json").write_text(json.dumps(half.tolist()))
    done = cli("cloud", *scene, "--intrinsics", folder / "half.json", "--out", folder / "h.ply")
    assert "another resolution" in done.err


def test_a_viewpoint_that_contradicts_the_points_is_not_used(tmp_path: Path) -> None:
    rows = np.random.default_rng(0).uniform((-0.1, -0.1, 0.6), (0.1, 0.1, 0.7), (100, 3))
    head = (
        "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 100\nHEIGHT 1\n"
        "VIEWPOINT 0 0 0 0 1 0 0\nPOINTS 100\nDATA ascii\n"
    )
    path = tmp_path / "c.pcd"
    path.write_text(head + "\n".join(" ".join(f"{x:.5f}" for x in row) for row in rows))
    cloud = read_cloud(path)
    assert cloud.frame == "camera"
    assert cloud.T_world_camera is None
    assert "VIEWPOINT" in cloud.notes[0]
    # Who insists on the header gets a message with what works.
    with pytest.raises(Exception, match="--frame camera"):
        read_cloud(path, frame="world").in_camera_frame()


def test_a_mask_may_be_an_image_of_labels_or_of_colours(tmp_path: Path) -> None:
    labels = np.array([[0, 1], [2, 2]], np.uint8)
    Image.fromarray(labels).save(tmp_path / "l.png")
    with pytest.raises(InputError, match="2 numbers besides 0: 1, 2") as refused:
        read_mask(str(tmp_path / "l.png"))
    assert "l.png:1" in str(refused.value.hint)
    Image.fromarray(np.array([[0, 90], [255, 255]], np.uint8)).save(tmp_path / "soft.png")
    Image.fromarray(np.full((4, 4), 255, np.uint8)).save(tmp_path / "m.jpg")
    with pytest.raises(InputError, match="JPEG"):
        read_mask(str(tmp_path / "m.jpg"))
    noise = np.random.default_rng(0).integers(1, 255, (40, 40), dtype=np.uint8)
    Image.fromarray(noise).save(tmp_path / "photo.png")
    with pytest.raises(InputError, match="photograph"):
        read_mask(str(tmp_path / "photo.png"))
    assert read_mask(str(tmp_path / "soft.png")).tolist() == [[False, True], [True, True]]
    assert read_mask(f"{tmp_path / 'l.png'}:2").tolist() == [[False, False], [True, True]]
    colours = np.zeros((2, 2, 4), np.uint8)
    colours[0, 0] = (0, 0, 9, 255)
    colours[1, 1] = (9, 9, 9, 0)  # transparent
    Image.fromarray(colours).save(tmp_path / "c.png")
    assert read_mask(str(tmp_path / "c.png")).tolist() == [[True, False], [False, False]]


def test_points_of_a_robot_that_is_not_at_home_are_dropped(cli: Callable, scene: list[Any]) -> None:
    robot, palm = load_robot(), np.eye(4)
    palm[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]  # it looks down
    palm[:3, 3] = [*CAN, 0.1]
    found = InverseKinematics(robot).solve(palm)
    q = found.arm[0][found.reached[0]][0]
    pose, start = scene[0].parent / "T.json", ",".join(f"{value:.6f}" for value in q)

    def points_on_can(*more: Any) -> int:
        things = listed(cli, scene, "--camera-pose", pose, *more)
        return int(min(things, key=lambda one: abs(one["centre"][1] - CAN[1]))["points"])

    assert points_on_can("--start", start) < 0.7 * points_on_can()
    place = f"{CAN[0]},{CAN[1]},0.06"
    wholes = [
        segmented_view(scene[0], options(scene), str(pose), place, None, None, start=given)
        for given in (None, start)
    ]
    assert len(wholes[1].points) < 0.7 * len(wholes[0].points)
    for command in ("segment", "mesh"):
        done = cli(command, *scene, "--camera-pose", pose, "--start", "0,9")
        assert done.code == 2
        assert "--start" in done.err
