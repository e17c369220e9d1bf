"""Scenes put things where they are in the world, and the exported page holds all of it."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from plan_files import turning_plan_file
from trial_rows import ROW

from pointsdf_cli.assets import bundled_robots
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import invert_transform, rotation_from_wxyz, transform
from pointsdf_cli.io.clouds import Cloud, frame_comments, write_cloud
from pointsdf_cli.io.grasps import Grasps, GraspsMeta, write_grasps
from pointsdf_cli.io.meshes import save_mesh
from pointsdf_cli.io.plans import read_plan, write_plan
from pointsdf_cli.io.provenance import file_sha256
from pointsdf_cli.io.trials import Evidence, write_trial
from pointsdf_cli.io.views import Views, write_views
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.viz.artifact_scene import scene_of, scenes_of
from pointsdf_cli.viz.html_scene import scene_page
from pointsdf_cli.viz.scene import Part, Scene, joined
from pointsdf_cli.viz.scene_sources import SceneOptions

ROBOT = load_robot()
OPTIONS = SceneOptions(ROBOT)
LOOKING_DOWN = transform([[0, -1, 0], [-1, 0, 0], [0, 0, -1]], [0.6, 0.0, 1.0])


def part(scene: Scene, layer: str) -> Part:
    return next(part for part in scene.parts if part.layer == layer)


def test_a_cloud_of_a_camera_that_looks_down_lies_below_it(tmp_path: Path) -> None:
    points = np.array([[0.0, 0.0, 0.9], [0.1, 0.0, 0.9], [0.0, 0.2, 0.8]])
    write_cloud(tmp_path / "c.ply", Cloud(points, T_world_camera=LOOKING_DOWN))
    shown = part(scene_of(tmp_path / "c.ply", OPTIONS), "cloud").vertices
    # 0.9 m in front of a camera at 1 m that looks down is 0.1 m above the table; the image's
    # right is the world's -y, its lower side the world's -x.
    assert np.allclose(shown, [[0.6, 0, 0.1], [0.6, -0.1, 0.1], [0.4, 0, 0.2]], atol=1e-6)


def test_a_cloud_without_a_pose_is_set_upright(tmp_path: Path) -> None:
    points = np.array([[0.0, 0.0, 1.0], [0.0, 0.3, 1.0], [0.2, 0.0, 1.0]])
    write_cloud(tmp_path / "c.ply", Cloud(points))
    ahead, lower, right = part(scene_of(tmp_path / "c.ply", OPTIONS), "cloud").vertices
    assert lower[2] - ahead[2] == pytest.approx(-0.3, abs=1e-6)
    assert right[1] - ahead[1] == pytest.approx(-0.2, abs=1e-6)


def test_a_mesh_beside_a_cloud_lies_in_the_clouds_frame(tmp_path: Path) -> None:
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    box.apply_translation((0, 0, 0.9))
    box.export(tmp_path / "mesh.ply")
    points = np.asarray(box.vertices)
    write_cloud(tmp_path / "c.ply", Cloud(points, T_world_camera=LOOKING_DOWN))
    scene = scenes_of([tmp_path / "mesh.ply", tmp_path / "c.ply"], OPTIONS)
    mesh, cloud = part(scene, "mesh").vertices, part(scene, "cloud").vertices
    assert np.allclose(mesh.min(axis=0), cloud.min(axis=0), atol=1e-6)
    assert np.allclose(mesh.max(axis=0), cloud.max(axis=0), atol=1e-6)


def box_ahead(path: Path, **place: Any) -> np.ndarray:
    """A box 0.9 m ahead of a camera as a mesh, with its place in the header; its corners."""
    box = trimesh.creation.box((0.1, 0.1, 0.1)).apply_translation((0, 0, 0.9))
    save_mesh(path, box.vertices, box.faces, frame_comments(**place) if place else None)
    return np.asarray(box.vertices)


def warnings_of(scene: Scene) -> list[str]:
    return [value for name, value in scene.facts if name == "warning"]


def test_a_mesh_beside_a_plan_lies_where_its_header_says(tmp_path: Path) -> None:
    plan, mesh = turning_plan_file(tmp_path, ROBOT), tmp_path / "mesh.ply"
    corners = box_ahead(mesh, frame="camera", T_world_camera=LOOKING_DOWN)
    scene = scenes_of([plan, mesh], OPTIONS)
    wanted = corners @ LOOKING_DOWN[:3, :3].T + LOOKING_DOWN[:3, 3]
    assert part(scene, "mesh").vertices == pytest.approx(wanted, abs=1e-6)
    assert not warnings_of(scene)
    for place in ({}, {"frame": "camera", "T_world_camera": None}):
        box_ahead(mesh, **place)
        assert "mesh.ply does not say" in warnings_of(scenes_of([plan, mesh], OPTIONS))[0]
    box_ahead(mesh, frame="world", T_world_camera=None)
    assert not warnings_of(scenes_of([plan, mesh], OPTIONS))


def test_a_mesh_beside_several_clouds_lies_where_its_header_says(tmp_path: Path) -> None:
    mesh, poses = tmp_path / "mesh.ply", {"a.ply": np.eye(4), "b.ply": LOOKING_DOWN}
    corners = box_ahead(mesh, frame="camera", T_world_camera=LOOKING_DOWN)
    for name, pose in poses.items():
        write_cloud(tmp_path / name, Cloud(corners, T_world_camera=pose))
    paths = [*(tmp_path / name for name in poses), mesh]
    scene = scenes_of(paths, OPTIONS)
    wanted = corners @ LOOKING_DOWN[:3, :3].T + LOOKING_DOWN[:3, 3]
    assert part(scene, "mesh").vertices == pytest.approx(wanted, abs=1e-6)
    assert not warnings_of(scene)
    box_ahead(mesh)
    assert "a guess" in warnings_of(scenes_of(paths, OPTIONS))[0]


def test_views_are_seen_from_their_cameras(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    on_ball = rng.standard_normal((1000, 3))
    on_ball *= 0.05 / np.linalg.norm(on_ball, axis=1, keepdims=True)
    poses = np.array(
        [transform(rotation_from_wxyz(rng.standard_normal(4)), [0, 0, 1.5]) for _ in range(3)]
    )
    clouds = np.array([on_ball @ T[:3, :3].T + T[:3, 3] for T in poses], dtype=np.float32)
    write_views(
        tmp_path / "v.h5",
        Views(clouds, poses, np.diag([500.0, 500, 1]), (640, 480), 0.0, "ball.ply", "0"),
        seed=0,
    )
    scene = scene_of(tmp_path / "v.h5", OPTIONS)
    assert (scene.frames, scene.slider) == (3, "view")
    for k, shown in enumerate(p for p in scene.parts if p.layer == "cloud"):
        assert shown.frame == k
        assert np.allclose(np.linalg.norm(shown.vertices, axis=1), 0.05, atol=1e-5)
        assert np.allclose(scene.poses[k, 0], invert_transform(poses[k]))


def test_the_mesh_of_a_file_is_found_by_its_name_alone(tmp_path: Path) -> None:
    """It is a name and no pattern, whatever signs are in it."""
    ball = trimesh.creation.icosphere(2, 0.05)
    cloud = np.tile(np.asarray(ball.vertices, np.float32) + [0, 0, 1.5], (1, 7, 1))[:, :1000]
    pose = transform(np.eye(3), [0, 0, 1.5])[None]
    for k, (name, there) in enumerate((("ball[1].ply", True), ("/ball.ply", False), ("**", False))):
        folder = tmp_path / str(k)
        folder.mkdir()
        digest = "0"
        if there:
            ball.export(folder / name)
            digest = file_sha256(folder / name)
        views = Views(
            cloud.astype(np.float32), pose, np.diag([500.0, 500, 1]), (640, 480), 0.0, name, digest
        )
        write_views(folder / "v.h5", views, seed=0)
        shown = [one.layer for one in scene_of(folder / "v.h5", OPTIONS).parts]
        assert ("mesh" in shown) is there
    # Beside views/ as the stages have it; a folder that was named must hold it.
    (tmp_path / "views").mkdir()
    (tmp_path / "0" / "v.h5").rename(tmp_path / "views" / "v.h5")
    (tmp_path / "0").rename(tmp_path / "meshes")
    scene = scene_of(tmp_path / "views" / "v.h5", OPTIONS)
    assert "mesh" in [one.layer for one in scene.parts]
    with pytest.raises(InputError, match=r"does not hold ball\[1\].ply"):
        scene_of(tmp_path / "views" / "v.h5", replace(OPTIONS, meshes=tmp_path / "1"))


def test_a_plan_turns_the_robot_about_its_first_axis(tmp_path: Path) -> None:
    scene = scene_of(turning_plan_file(tmp_path, ROBOT), OPTIONS)
    assert scene.frames == 11
    assert scene.rate == pytest.approx(11 / 2)
    assert scene.captions[-1] == "2.00 s"
    palm = scene.bodies.index("allegro_palm")
    start, end = scene.poses[0, palm, :3, 3], scene.poses[-1, palm, :3, 3]
    turn = np.array([[np.cos(1), -np.sin(1)], [np.sin(1), np.cos(1)]])
    assert np.allclose(end[:2], turn @ start[:2], atol=1e-9)
    assert end[2] == pytest.approx(start[2])
    base = scene.bodies.index("lbr4_link_0")
    assert np.allclose(scene.poses[:, base], np.eye(4))


def test_a_plan_without_a_table_is_shown_without_one(tmp_path: Path) -> None:
    path = turning_plan_file(tmp_path, ROBOT)
    assert part(scene_of(path, OPTIONS), "table")
    plan = read_plan(path)
    bare = replace(plan, link_clearance_table=np.full(len(plan.link_names), np.inf))
    write_plan(path, bare, seed=0)
    assert "table" not in [one.layer for one in scene_of(path, OPTIONS).parts]


def test_what_a_trial_believed_stands_where_it_was_seen_and_moves_along(tmp_path: Path) -> None:
    box = trimesh.creation.box((0.06, 0.04, 0.1))
    turned = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    stands = transform(turned, [0.6, 0.1, 0.05])
    lifted = transform(turned, [0.6, 0.1, 0.2])
    believed = box.vertices @ turned.T + stands[:3, 3]
    evidence = Evidence(
        cloud=believed.astype(np.float32),
        T_world_camera=LOOKING_DOWN,
        vertices=believed.astype(np.float32),
        faces=box.faces.astype(np.int32),
        phases=("planned", "settle"),
        q=np.tile(ROBOT.home, (2, 1)),
        T_world_object=np.stack([stands, lifted]),
        trajectory=np.tile(ROBOT.home, (3, 1)),
        times=np.arange(3.0),
        obstacle_vertices=(box.vertices + [0.3, 0, 0]).astype(np.float32),
        obstacle_faces=box.faces.astype(np.int32),
    )
    write_trial(tmp_path / "t.h5", ROW, evidence, {})
    scene = scene_of(tmp_path / "t.h5", OPTIONS)
    (other,) = [part for part in scene.parts if part.layer == "others"]
    assert np.allclose(other.vertices, box.vertices + [0.3, 0, 0])
    (part,) = [part for part in scene.parts if part.layer == "object"]
    for frame, up in ((0, 0.0), (-1, 0.15)):
        pose = scene.poses[frame, part.body]
        seen = part.vertices @ pose[:3, :3].T + pose[:3, 3]
        assert np.allclose(seen, believed + [0, 0, up], atol=1e-6)


def write_two_grasps(tmp_path: Path) -> Path:
    trimesh.creation.box((0.06, 0.06, 0.1)).export(tmp_path / "box.ply")
    q = np.tile(ROBOT.home, (2, 1))
    q[1, ROBOT.arm] = np.nan  # no inverse kinematics: there is no robot to show
    poses = np.tile(transform(np.eye(3), [0.6, 0, 0.05]), (2, 1, 1))
    grasps = Grasps(
        cloud=np.tile(np.float32([0.0, 0.0, 0.9]), (2, 1000, 1)),
        T_world_camera=np.tile(LOOKING_DOWN, (2, 1, 1)),
        T_world_object=poses,
        T_world_palm=poses,
        q=q,
        label=np.array([1, -2], np.int8),
        kind=np.array([0, 1], np.int8),
        cause=np.array([0, 6], np.int8),
        lift_height=np.float32([0.15, np.nan]),
        slip=np.float32([0.0, np.nan]),
        attempt=np.arange(2, dtype=np.int32),
        scene=np.zeros(2, np.int32),
        unshaken=np.full(2, -1, np.int8),
    )
    meta = GraspsMeta(
        "box.ply",
        file_sha256(tmp_path / "box.ply"),
        "train",
        ROBOT.name,
        ROBOT.joint_names,
        ROBOT.preshape_joints,
    )
    write_grasps(tmp_path / "g.h5", grasps, meta, seed=0)
    return tmp_path / "g.h5"


def test_an_attempt_without_an_arm_shows_object_and_palm_only(tmp_path: Path) -> None:
    scene = scene_of(write_two_grasps(tmp_path), OPTIONS)
    assert scene.captions == ("attempt 0: side, held", "attempt 1: top, no_ik")
    robot = slice(0, len(ROBOT.tree.links))
    assert np.isfinite(scene.poses[0]).all()
    assert np.isnan(scene.poses[1, robot]).all()
    assert np.isfinite(scene.poses[1, robot.stop :]).all()
    thing = part(scene, "object")  # the mesh beside the file, known by its hash
    world = thing.vertices @ scene.poses[0, thing.body, :3, :3].T
    world += scene.poses[0, thing.body, :3, 3]
    assert np.allclose(
        [world.min(axis=0), world.max(axis=0)], [[0.57, -0.03, 0], [0.63, 0.03, 0.1]]
    )


def test_two_that_move_are_refused_and_one_with_a_still_one_is_not(tmp_path: Path) -> None:
    plan, grasps = turning_plan_file(tmp_path, ROBOT), write_two_grasps(tmp_path)
    with pytest.raises(InputError, match="slider of their own"):
        scenes_of([plan, grasps], OPTIONS)
    both = scenes_of([tmp_path / "box.ply", plan], OPTIONS)
    alone = scene_of(plan, OPTIONS)
    assert both.frames == alone.frames
    assert np.array_equal(both.poses, alone.poses)
    assert len(both.parts) == len(alone.parts) + 2


def test_a_plan_of_another_robot_is_refused(tmp_path: Path) -> None:
    gripper = load_robot(Path(__file__).parent / "robots" / "gripper.yaml")
    path = turning_plan_file(tmp_path, gripper)
    with pytest.raises(InputError, match="--robot"):
        scene_of(path, OPTIONS)
    assert scene_of(path, SceneOptions(gripper)).frames == 11


@pytest.mark.parametrize("name", bundled_robots())
def test_a_plan_of_a_bundled_robot_needs_no_option(name: str, tmp_path: Path) -> None:
    path = turning_plan_file(tmp_path, load_robot(name))
    assert scene_of(path, SceneOptions()).frames == 11
    other = "panda" if name != "panda" else "lbr4_allegro"
    with pytest.raises(InputError, match="--robot"):
        scene_of(path, SceneOptions(load_robot(other)))


def test_the_robot_of_a_trial_is_known_by_its_number_of_joints() -> None:
    for name in bundled_robots():
        robot = load_robot(name)
        found = SceneOptions().robot_with(Path("t.h5"), len(robot.joint_names))
        assert found.joint_names == robot.joint_names
    with pytest.raises(InputError, match="3 joints"):
        SceneOptions().robot_with(Path("t.h5"), 3)


def test_bounds_leave_out_table_and_what_is_not_there() -> None:
    corner = np.float32([[0, 0, 0], [1, 1, 1]])
    poses = np.stack([np.eye(4), np.full((4, 4), np.nan)])[None]
    parts = (
        Part("a", "thing", "points", corner, body=0),
        Part("b", "thing", "points", corner + 50, body=1),
        Part("c", "table", "points", corner * 100),
    )
    scene = Scene("s", parts, ("there", "gone"), poses)
    assert np.array_equal(scene.bounds(), [[0, 0, 0], [1, 1, 1]])
    assert joined([scene]) is scene


def scene_of_page(page: str) -> dict[str, Any]:
    """The data in a page."""
    data: dict[str, Any] = json.loads(
        re.findall(r'type="application/json">(.*?)</script>', page)[0]
    )
    return data


def test_the_page_holds_the_whole_scene_and_fetches_nothing(tmp_path: Path) -> None:
    scene = scene_of(turning_plan_file(tmp_path, ROBOT), OPTIONS)
    page = scene_page(scene)
    data = scene_of_page(page)
    poses = np.frombuffer(base64.b64decode(data["poses"]), "<f4")
    stored = np.swapaxes(poses.reshape(scene.poses.shape), -1, -2)
    assert np.allclose(stored, scene.poses, atol=1e-6)
    assert len(data["parts"]) == len(scene.parts)
    for kept, mine in zip(data["parts"], scene.parts, strict=True):
        vertices = np.frombuffer(base64.b64decode(kept["vertices"]), "<f4").reshape(-1, 3)
        assert np.array_equal(vertices, mine.vertices)
        if mine.faces is not None:
            faces = np.frombuffer(base64.b64decode(kept["faces"]), "<u4").reshape(-1, 3)
            assert np.array_equal(faces, mine.faces)
    assert not re.search(r"https?://", page)
    assert page.count("<script") == page.count("</script>") == 2


def test_a_name_cannot_leave_its_place_in_the_page() -> None:
    scene = Scene("</script><script>alert(1)</script>", ())
    page = scene_page(scene)
    assert page.count("<script") == 2
    assert scene_of_page(page)["title"] == scene.title


def test_view_exports_and_refuses(tmp_path: Path, cli: Callable) -> None:
    plan, page = turning_plan_file(tmp_path, ROBOT), tmp_path / "p.html"
    done = cli("view", plan, "--export", page)
    assert done.code == 0, done.err
    assert scene_of_page(page.read_text())["slider"] == "time"
    assert cli("view", plan, "--export", page).code == 2
    assert cli("view", plan, "--export", page, "--force").code == 0
    assert "needs no server" in cli("view", plan, "--export", page, "--port", 9999).err
    (tmp_path / "note.md").write_text("hello")
    for bad in (tmp_path / "note.md", tmp_path, tmp_path / "absent.h5"):
        refused = cli("view", bad, "--export", tmp_path / "q.html")
        assert refused.code == 2
        assert str(bad) in refused.err
    assert not (tmp_path / "q.html").exists()


def test_playing_begins_anew_at_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    from pointsdf_cli.viz import viewer

    shown: list[tuple[int, bool]] = []
    slider, button = SimpleNamespace(value=2), SimpleNamespace(value=True)

    def sleep(_: float) -> None:
        shown.append((slider.value, button.value))
        if len(shown) == 5:
            raise KeyboardInterrupt

    monkeypatch.setattr(viewer.time, "sleep", sleep)
    served = viewer.Viewer.__new__(viewer.Viewer)  # without a server
    served.scene = SimpleNamespace(frames=3, rate=4.0)
    served._slider, served._play, served.frame = slider, button, 2
    with pytest.raises(KeyboardInterrupt):
        served.run()
    assert shown == [(0, True), (1, True), (2, True), (2, False), (2, False)]
