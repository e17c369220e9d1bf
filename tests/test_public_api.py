"""The names that `pointsdf_cli` offers, and the examples that use them."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree

import pointsdf_cli
from pointsdf_cli.assets import asset_path
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import apply_transform, transform
from pointsdf_cli.planning.grasp_problem import Clearances

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def test_every_name_leads_somewhere() -> None:
    for name in pointsdf_cli._HOMES:
        assert getattr(pointsdf_cli, name).__name__ == name
    with pytest.raises(AttributeError, match="no attribute 'grasp'"):
        pointsdf_cli.grasp  # noqa: B018


def test_importing_the_package_loads_nothing_else() -> None:
    heavy = "{'torch', 'numpy', 'open3d', 'trimesh'}"
    code = f"import sys, pointsdf_cli; print(sorted({heavy} & set(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_a_completed_cloud_is_closed_and_signed() -> None:
    cloud = pointsdf_cli.read_cloud(asset_path("clouds/mug.ply"))
    points, T_frame_camera = cloud.in_camera_frame()
    shape = pointsdf_cli.complete(points, T_frame_camera, resolution=64)
    edges = np.sort(shape.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    counts = np.unique(edges, axis=0, return_counts=True)[1]
    assert (counts == 2).all()  # each edge has a face on either side
    far = shape.vertices.max(axis=0) + 0.05
    assert shape.sdf(far) > 0.02
    assert abs(shape.sdf(shape.vertices[::50])).mean() < 0.003
    assert shape.gradient(far[None]).shape == (1, 3)


def test_distances_far_from_a_completed_cloud() -> None:
    """Where nothing was seen the network says millimetres, centimetres or metres away."""
    for name in ("spray_bottle", "mug"):  # a mug's wall is fitted, too
        points, _ = pointsdf_cli.read_cloud(asset_path(f"clouds/{name}.ply")).in_camera_frame()
        shape = pointsdf_cli.complete(points, resolution=64)
        rng = np.random.default_rng(0)
        ways = rng.standard_normal((200, 3))
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        for radius in (0.2, 0.5, 2.0):
            places = shape.vertices.mean(axis=0) + radius * ways
            true, nearest = cKDTree(shape.vertices).query(places)
            found = shape.sdf(places)
            assert (found > true - 0.011).all()
            assert (found < true + 1e-6).all()
            away = (places - shape.vertices[nearest]) / true[:, None]
            if radius > 0.2:
                assert (np.sum(shape.gradient(places) * away, axis=1) > 0.99).all()
    with pytest.raises(InputError, match=r"shape \(4, 2\)"):
        shape.sdf(np.zeros((4, 2)))


def test_points_in_millimetres_and_whole_clouds_are_refused() -> None:
    cloud = pointsdf_cli.read_cloud(asset_path("clouds/mug.ply"))
    with pytest.raises(InputError, match="millimetres"):
        pointsdf_cli.complete(1000 * cloud.points)
    with pytest.raises(InputError, match="not an array"):
        pointsdf_cli.complete(cloud)


def test_points_that_no_camera_sees_are_refused() -> None:
    cloud = pointsdf_cli.read_cloud(asset_path("clouds/spray_bottle.ply"))
    points, _ = cloud.in_camera_frame()
    pose = np.array(cloud.T_world_camera)
    world = apply_transform(pose, points)
    opengl = points * [1, -1, -1]
    for wrong in (opengl, world - [0, 0, world[:, 2].mean()]):
        with pytest.raises(InputError, match="behind it"):
            pointsdf_cli.complete(wrong)
        with pytest.raises(InputError, match="behind it"):
            pointsdf_cli.View(wrong, pose)
    holed = points.copy()
    holed[3] = np.nan
    with pytest.raises(InputError, match="NaN"):
        pointsdf_cli.complete(holed)
    with pytest.raises(InputError, match="NaN"):
        pointsdf_cli.View(holed, pose)
    with pytest.raises(InputError, match="in metres"):
        pointsdf_cli.View(1000 * points, pose)
    with pytest.raises(InputError, match="rigid"):
        pointsdf_cli.View(points, 2 * np.eye(4))
    assert pointsdf_cli.View(points.tolist(), pose.tolist()).in_world.shape == points.shape


def test_a_shape_keeps_its_pose() -> None:
    cloud = pointsdf_cli.read_cloud(asset_path("clouds/spray_bottle.ply"))
    points, _ = cloud.in_camera_frame()
    pose = np.array(cloud.T_world_camera)
    shape = pointsdf_cli.complete(apply_transform(pose, points), pose, resolution=32)
    before = shape.sdf(shape.vertices)
    pose[:3, :3] = np.eye(3)
    np.testing.assert_array_equal(shape.sdf(shape.vertices), before)
    with pytest.raises(InputError, match="NaN"):
        shape.sdf([np.nan, 0, 0])


def _view(cloud: pointsdf_cli.Cloud) -> tuple[np.ndarray, np.ndarray]:
    """Points of one object of the bundled table, camera frame, and the camera's pose."""
    points, _ = cloud.in_camera_frame()
    pose = np.array(cloud.T_world_camera)
    world = apply_transform(pose, points)
    return points[world[:, 2] > 0.02][:2000], pose


def test_what_cannot_be_planned_is_told_before_it_is_tried() -> None:
    cloud = pointsdf_cli.read_cloud(asset_path("clouds/table.ply"))
    planner = pointsdf_cli.GraspPlanner()

    def plan(clouds: object = (cloud,), names: object = ("table",), **more: object) -> None:
        pointsdf_cli.plan_on_table(planner, clouds, names, **more)

    mistakes: list[tuple[str, dict[str, object]]] = [
        ("no place", {"target": [np.nan] * 3}),
        ("no place", {"target": 2}),
        ("no place", {"target": "any"}),
        ("no place", {"target": (300, 200)}),
        ("lists", {"clouds": cloud}),
        ("lists", {"names": "table"}),
        ("a name for each", {"clouds": []}),
        ("two corners", {"workspace": (1, 2)}),
        ("seed", {"seed": -1}),
        ("seed", {"seed": None}),
        ("reconstruction, hull", {"obstacles": "boxes"}),
        ("beyond its limit", {"start": np.full(7, np.nan)}),
    ]
    for message, wrong in mistakes:
        with pytest.raises(InputError, match=message):
            plan(**wrong)
    with pytest.raises(InputError, match="one or more"):
        planner.plan([])
    seen = pointsdf_cli.View(*_view(cloud))
    with pytest.raises(InputError, match="no field 'reconstruction'"):
        planner.plan([seen], field="reconstruction")
    with pytest.raises(InputError, match="no device 'foo'"):
        pointsdf_cli.GraspPlanner(pointsdf_cli.PlanOptions(device="foo"))
    with pytest.raises(InputError, match="not on this machine"):
        pointsdf_cli.GraspPlanner(pointsdf_cli.PlanOptions(device="cuda:99"))
    for number in (1.5, True, "2"):
        with pytest.raises(InputError, match="a number in the list"):
            pointsdf_cli.TargetChoice(number=number)
    with pytest.raises(InputError, match="0 m or more"):
        Clearances(environment=np.nan)
    with pytest.raises(InputError, match="finite"):
        pointsdf_cli.Environment(table_height=np.nan)
    with pytest.raises(InputError, match="one choice"):
        pointsdf_cli.TargetChoice()
    for size, pose in (((np.nan, 1, 1), np.eye(4)), ((1, 1, 1), np.eye(3)), ((1, 1), np.eye(4))):
        with pytest.raises(InputError):
            pointsdf_cli.Obstacle("post", "box", size, pose)


def test_a_cloud_is_written_as_it_is_read(tmp_path: Path) -> None:
    points = np.random.default_rng(0).random((60, 3))
    with pytest.raises(InputError, match="rigid"):
        pointsdf_cli.Cloud(points, T_world_camera=2 * np.eye(4))
    with pytest.raises(InputError, match="camera, world"):
        pointsdf_cli.Cloud(points, frame="base")
    listed = pointsdf_cli.Cloud(points, T_world_camera=np.eye(4).tolist())
    pointsdf_cli.write_cloud(tmp_path / "a.ply", listed)
    with pytest.raises(InputError, match="PLY"):
        pointsdf_cli.write_cloud(tmp_path / "a.pcd", listed)
    with pytest.raises(InputError, match="uint8"):
        pointsdf_cli.write_cloud(
            tmp_path / "b.ply", pointsdf_cli.Cloud(points, colours=0.5 * np.ones((60, 3)))
        )
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]


def test_a_depth_image_is_a_cloud_with_its_pose(tmp_path: Path) -> None:
    depth = np.zeros((4, 6), np.uint16)
    depth[1, 4] = 5000
    Image.fromarray(depth).save(tmp_path / "depth.png")
    (tmp_path / "K.json").write_text("[[100, 0, 3], [0, 100, 2], [0, 0, 1]]")
    files = tmp_path / "depth.png", tmp_path / "K.json"
    pose = transform(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, 0.6])
    cloud = pointsdf_cli.read_depth_image(*files, pose, depth_scale=1e-4)
    np.testing.assert_allclose(cloud.points, [[0.005, -0.005, 0.5]], atol=1e-7)
    np.testing.assert_array_equal(cloud.T_world_camera, pose)
    with pytest.raises(InputError, match="rigid"):
        pointsdf_cli.read_depth_image(*files, 2 * pose)
    with pytest.raises(InputError, match=r"between 0\.1 and 0\.4 m"):
        pointsdf_cli.read_depth_image(*files, pose, depth_scale=1e-4, far=0.4)


@pytest.mark.parametrize("name", sorted(path.name for path in EXAMPLES.glob("*.py")))
def test_examples_run(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(EXAMPLES.parent)
    monkeypatch.setattr(sys, "argv", [name])
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    assert len(capsys.readouterr().out.splitlines()) >= 1
