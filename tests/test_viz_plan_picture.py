"""Pictures of plans: what is in them, and that the hand does not hide the object."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.viz.plan_picture import PlanScene, close_ups, plan_picture
from pointsdf_cli.viz.robot_picture import RobotMeshes
from pointsdf_cli.viz.shading import dots

ROBOT = load_robot()


@pytest.fixture(scope="module")
def meshes() -> RobotMeshes:
    return RobotMeshes(ROBOT, sections=8)


def ball() -> PlanScene:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.05)
    mesh.apply_translation((0.6, 0.0, 0.05))
    vertices = np.asarray(mesh.vertices)
    seen = vertices[vertices[:, 0] > 0.6]
    return PlanScene(seen, np.array([1.5, 0.0, 0.6]), (vertices, np.asarray(mesh.faces)))


def test_points_are_drawn_where_they_are() -> None:
    points = np.random.default_rng(0).uniform(size=(40, 3))
    drawn = dots(points, 0.001, (0.0, 0.0, 1.0))
    np.testing.assert_allclose(drawn.vertices.reshape(40, 6, 3).mean(axis=1), points)
    assert drawn.faces.max() == len(drawn.vertices) - 1
    closed = trimesh.Trimesh(drawn.vertices[:6], drawn.faces[:8])
    assert closed.is_watertight
    many = PlanScene(np.zeros((100_000, 3)), np.ones(3), None).painted()
    assert 6 * 700 < max(len(part.vertices) for part in many) < 6 * 3100


def test_the_hand_alone_is_a_part_of_the_robot(meshes: RobotMeshes) -> None:
    whole, hand = meshes.at(ROBOT.home), meshes.at(ROBOT.home, hand_only=True)
    assert 0 < len(hand) < len(whole)
    corners = {tuple(part.vertices[0]) for part in whole}
    assert all(tuple(part.vertices[0]) in corners for part in hand)


def test_the_seen_points_are_seen_from_the_camera_only(meshes: RobotMeshes) -> None:
    """Blue points lie on the camera's side of the ball; from behind there are hardly any."""
    scene, blue = ball(), []
    for made in close_ups(meshes, ROBOT.home, scene):
        picture = made.astype(int)
        assert picture.shape == (440, 480, 3)
        blue.append(int((picture[..., 2] > picture[..., 0] + 60).sum()))
    assert blue[0] > 3 * max(1, blue[1])


def test_a_wall_before_the_object_lets_it_show_through(meshes: RobotMeshes) -> None:
    wall = trimesh.creation.box((0.02, 1.0, 0.5)).apply_translation((0.8, 0.0, 0.25))
    scene = ball()
    hidden = replace(scene, obstacles=[(np.asarray(wall.vertices), np.asarray(wall.faces))])
    free, behind = (close_ups(meshes, ROBOT.home, one)[0].astype(int) for one in (scene, hidden))
    blue = free[..., 2] > free[..., 0] + 60
    assert (behind[blue][:, 2] > behind[~blue][:, 2].mean() - 100).all()
    assert behind[blue][:, 0].mean() < behind[~blue][:, 0].mean() - 20


def test_without_a_table_none_is_drawn() -> None:
    scene = ball()
    assert len(scene.painted()) == len(replace(scene, table=False).painted()) + 1


def test_a_camera_above_looks_down_and_the_far_side_is_looked_at_from_low(
    meshes: RobotMeshes,
) -> None:
    """A ball whose upper half is seen: from the camera it is all blue, from the far side half."""
    whole = ball()
    assert whole.believed is not None
    vertices = whole.believed[0]
    scene = PlanScene(vertices[vertices[:, 2] > 0.05], np.array([0.65, 0.0, 1.2]), whole.believed)
    above, below = (
        (picture[..., 2].astype(int) > picture[..., 0].astype(int) + 60).nonzero()[0]
        for picture in close_ups(meshes, ROBOT.home, scene)
    )
    assert np.ptp(above) > 1.5 * np.ptp(below) > 0


def test_a_camera_that_is_assumed_below_the_table_looks_from_above_it(
    meshes: RobotMeshes,
) -> None:
    below = replace(ball(), camera=np.array([1.2, 0.0, -0.3]))
    picture = close_ups(meshes, ROBOT.home, below)[0].astype(int)
    assert (picture[..., 2] > picture[..., 0] + 60).sum() > 150  # the table would hide the points


def test_a_page_is_written_whole(meshes: RobotMeshes, tmp_path: Path) -> None:
    # Dollars are no formula.
    plan_picture(
        tmp_path / "plan.png", meshes, ROBOT.home, ball(), "a_$5_title_$9", "cup_$5_$.ply: words"
    )
    image = Image.open(tmp_path / "plan.png")
    assert image.size[0] > 2 * image.size[1]
    assert [p.name for p in tmp_path.iterdir()] == ["plan.png"]
