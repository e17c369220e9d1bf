"""What is simulated has the size that it has: PyBullet's skin is taken off beforehand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
import torch
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.io.meshes import LoadedMesh
from pointsdf_cli.robot.description import RobotDescription, load_robot
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.simulation.physics import PhysicsConfig
from pointsdf_cli.simulation.settle import settle
from pointsdf_cli.simulation.sim_object import prepare_object
from pointsdf_cli.simulation.skin import shrunk, shrunk_cylinder
from pointsdf_cli.simulation.world import World

ROBOTS = Path(__file__).parent / "robots"
BALL = 0.01
SKIN = PhysicsConfig().skin


def distance(corners: Array, faces: NDArray[np.int64], points: Array) -> Array:
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(corners.astype(np.float32)), o3d.core.Tensor(faces.astype(np.uint32))
    )
    return np.asarray(
        scene.compute_signed_distance(o3d.core.Tensor(points.astype(np.float32))).numpy(), float
    )


def test_a_box_is_drawn_in_on_all_six_sides() -> None:
    box = trimesh.creation.box((0.1, 0.06, 0.04))
    corners, faces = shrunk(np.asarray(box.vertices), np.asarray(box.faces), SKIN)
    inner = trimesh.Trimesh(corners, faces)
    assert inner.is_watertight
    assert inner.bounds == pytest.approx(box.bounds + [[SKIN] * 3, [-SKIN] * 3])
    assert inner.volume == pytest.approx(0.098 * 0.058 * 0.038)  # positive: it faces outwards


def test_a_cap_of_many_triangles_is_drawn_in_as_one() -> None:
    """The middle of a can's lid is a corner of its mesh, but none of its hull."""
    can = trimesh.creation.cylinder(0.03, 0.1)
    corners, _ = shrunk(np.asarray(can.vertices), np.asarray(can.faces), SKIN)
    assert np.ptp(corners[:, 2]) == pytest.approx(0.098)
    assert len(corners) < len(can.vertices)


@pytest.mark.parametrize("thick", [1e-6, 5e-4, 1.9e-3])
def test_a_plate_thinner_than_two_skins_keeps_its_middle(thick: float) -> None:
    plate = trimesh.creation.box((0.1, 0.1, thick))
    plate.apply_translation([0.0, 0.0, 0.3])
    corners, faces = shrunk(np.asarray(plate.vertices), np.asarray(plate.faces), SKIN)
    assert trimesh.Trimesh(corners, faces).volume > 0
    assert np.ptp(corners[:, 2]) == pytest.approx(0.1 * thick)
    assert corners[:, 2].mean() == pytest.approx(0.3)
    assert 0.1 - 2 * SKIN <= np.ptp(corners[:, 0]) <= 0.1


def test_hulls_have_their_size_again_nearly_everywhere() -> None:
    rng = np.random.default_rng(0)
    out, lost = [], []
    for _ in range(200):
        points = rng.normal(size=(rng.integers(4, 60), 3)) * 10 ** rng.uniform(-2, -1, 3)
        hull = trimesh.convex.convex_hull(points)
        corners, faces = shrunk(np.asarray(hull.vertices), np.asarray(hull.faces), SKIN)
        inner = trimesh.Trimesh(corners, faces, process=False)
        assert inner.volume > 0
        on_inner, _ = trimesh.sample.sample_surface(inner, 100, seed=0)
        on_hull, _ = trimesh.sample.sample_surface(hull, 100, seed=0)
        out.append(distance(hull.vertices, hull.faces, on_inner) + SKIN)
        lost.append(distance(corners, faces, on_hull) - SKIN)
    # As they come, a tenth of them sharp or thin; without being drawn in it would be 1 mm.
    for off, most in ((np.concatenate(out), SKIN), (np.concatenate(lost), 2 * SKIN)):
        assert np.abs(np.median(off)) < 2e-5
        assert np.abs(off).mean() < 1.5e-4
        assert off.max() < most + 1e-6


def prism(angle: float) -> trimesh.Trimesh:
    """An isosceles wedge, its edge of `angle` [degrees] along y at x = 0; 10 cm long, 8 cm wide."""
    high = 0.1 * np.tan(np.radians(angle / 2))
    section = [[0.0, 0.0], [0.1, high], [0.1, -high]]
    return trimesh.convex.convex_hull([[x, y, z] for x, z in section for y in (0.0, 0.08)])


def test_down_to_45_degrees_faces_lie_where_they_were_and_sharper_ends_stay() -> None:
    for angle, exact in ((60.0, True), (45.0, True), (10.0, False)):
        wedge = prism(angle)
        corners, _ = shrunk(np.asarray(wedge.vertices), np.asarray(wedge.faces), SKIN)
        planes = ConvexHull(wedge.vertices).equations
        gaps = -(corners @ planes[:, :3].T + planes[:, 3]).max(axis=0)
        if exact:
            assert gaps == pytest.approx(SKIN)
        else:  # by planes alone 10 mm of it would be lost
            assert (gaps > 0.2 * SKIN).all()
            assert corners[:, 0].min() < 3 * SKIN


def test_faces_of_a_pyramid_do_not_lean() -> None:
    """Its four faces meet in one corner, which is two when they are drawn in."""
    base = [[x, y, 0.0] for x in (-0.05, 0.05) for y in (-0.025, 0.025)]
    pyramid = trimesh.convex.convex_hull([*base, [0.0, 0.0, 0.06]])
    corners, faces = shrunk(np.asarray(pyramid.vertices), np.asarray(pyramid.faces), SKIN)
    assert trimesh.Trimesh(corners, faces).is_watertight
    points, _ = trimesh.sample.sample_surface(pyramid, 4000, seed=0)
    planes = np.unique(ConvexHull(pyramid.vertices).equations.round(9), axis=0)
    assert len(planes) == 5
    second = np.sort(-(points @ planes[:, :3].T + planes[:, 3]), axis=1)[:, 1]
    inner = points[(second > 0.003) & (points[:, 2] < 0.045)]  # near no edge, and not at the tip
    assert len(inner) > 1000
    off = distance(corners, faces, inner) - SKIN
    assert np.abs(off).max() < 1e-4


def test_what_is_all_but_flat_stays_as_it_is() -> None:
    disc = trimesh.creation.cylinder(0.03, 1e-9).apply_transform(
        trimesh.transformations.rotation_matrix(0.7, [1.0, 2.0, 3.0])
    )
    corners, faces = np.asarray(disc.vertices), np.asarray(disc.faces)
    same = shrunk(corners, faces, SKIN)
    assert same[0] is corners
    assert same[1] is faces


def near(world: World, body: int, link: int, points: Array) -> Array:
    """Distances [N] of places from one link of a body, as PyBullet has them."""
    bullet = world._bullet
    shape = bullet.createCollisionShape(bullet.GEOM_SPHERE, radius=BALL)
    ball = bullet.createMultiBody(0, shape)
    found = []
    for point in points:
        bullet.resetBasePositionAndOrientation(ball, point, [0, 0, 0, 1])
        close = bullet.getClosestPoints(ball, body, 1.0, linkIndexB=link)
        found.append(min(one[8] for one in close) + BALL)
    bullet.removeBody(ball)
    return np.array(found)


def loaded(mesh: trimesh.Trimesh) -> LoadedMesh:
    return LoadedMesh("thing", mesh.vertices, mesh.faces.astype(np.int32), "0", "none")


def test_an_object_of_several_pieces_has_its_own_size(tmp_path: Path) -> None:
    parts = [trimesh.creation.box((0.1, 0.04, 0.04)), trimesh.creation.box((0.04, 0.04, 0.2))]
    cross = trimesh.boolean.union(parts)
    item = prepare_object(loaded(cross), tmp_path)
    assert len(item.pieces) > 1
    pose = transform(np.eye(3), [0.5, 0.1, 0.3])
    # Before faces, where nothing is round.
    places = np.array([[0.1, 0, 0], [-0.1, 0.01, 0], [0.03, 0.05, 0], [0, 0, 0.15], [0, 0.1, 0.05]])
    with World(load_robot()) as world:
        world.reset(item, pose, robot="none")
        theirs = near(world, world._object_body, -1, places + pose[:3, 3])
    ours = distance(np.asarray(cross.vertices), np.asarray(cross.faces), places)
    assert theirs == pytest.approx(ours, abs=2e-5)


def test_a_box_stands_on_the_table_and_not_above_it(tmp_path: Path) -> None:
    item = prepare_object(loaded(trimesh.creation.box((0.06, 0.08, 0.1))), tmp_path)
    with World(load_robot()) as world:
        for pose in item.poses:
            rest = settle(world, item, pose)
            assert rest is not None
            lowest = (item.mesh.vertices @ rest[2, :3]).min() + rest[2, 3]
            assert lowest == pytest.approx(0.0, abs=2e-4)


def with_hulls(folder: Path) -> RobotDescription:
    """The gripper with jaws from a mesh file, which PyBullet is told to take as it is."""
    for file in ROBOTS.iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    trimesh.creation.box((0.06, 0.01, 0.02)).export(folder / "jaw.stl")
    urdf = (folder / "gripper.urdf").read_text(encoding="utf-8")
    changed = urdf.replace('<box size="0.06 0.01 0.02"/>', '<mesh filename="jaw.stl"/>')
    for jaw in ("left", "right"):
        name = f'<link name="{jaw}">\n    <collision'
        assert name in changed
        changed = changed.replace(name, f'{name} concave="yes"')
    assert changed.count("jaw.stl") == 2
    (folder / "gripper.urdf").write_text(changed, encoding="utf-8")
    return load_robot(folder / "gripper.yaml")


def test_with_no_skin_nothing_is_drawn_in() -> None:
    box = trimesh.creation.box((0.1, 0.06, 0.04))
    corners = np.asarray(box.vertices)
    assert shrunk(corners, np.asarray(box.faces), 0.0)[0] is corners
    assert shrunk_cylinder(0.05, 0.1, 0.0) == (0.05, 0.1)
    assert shrunk_cylinder(0.05, 0.1, SKIN) == pytest.approx((0.049, 0.098), rel=0.0025)
    radius, length = shrunk_cylinder(1e-3, 1e-3, SKIN)  # hardly thicker than its skin
    assert 0 < radius < 1e-3
    assert 0 < length < 1e-3


@pytest.mark.parametrize("which", ["bundled", "hulls"])
def test_links_have_the_size_that_the_planner_takes_them_for(tmp_path: Path, which: str) -> None:
    robot = load_robot() if which == "bundled" else with_hulls(tmp_path)
    rotation, position = Kinematics(robot)(torch.tensor(robot.home)[None])
    rng = np.random.default_rng(0)
    kinds = set()
    with World(robot) as world:
        world.reset()
        for k, link in enumerate(robot.tree.links):
            shapes = robot.tree.shapes[link]
            if not shapes:
                continue
            kinds |= {shape.kind for shape in shapes}
            local = rng.normal(scale=0.1, size=(12, 3))
            meshes = [shape.as_mesh(sections=256) for shape in shapes]
            ours = np.min([distance(mesh.vertices, mesh.faces, local) for mesh in meshes], axis=0)
            away = ours > 0.02
            assert away.any()
            places = local[away] @ rotation[0, k].numpy().T + position[0, k].numpy()
            theirs = near(world, *world.joints.links[link], places)
            # Nothing stands out; edges and corners are round, and PyBullet's cylinders have sides.
            assert (theirs - ours[away] > -2e-4).all(), link
            assert (theirs - ours[away] < 9e-4).all(), link
    assert kinds >= ({"box", "cylinder", "sphere"} if which == "bundled" else {"box", "hull"})
