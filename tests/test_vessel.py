"""Vessels of revolution: cups of known measures, and bodies that are none."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
import trimesh
from manifold3d import CrossSection, Manifold

from pointsdf_cli.geometry.axis_fit import axis_point, oriented_points, refined_axis, turned
from pointsdf_cli.geometry.body_of_revolution import BodyOfRevolution
from pointsdf_cli.geometry.frames import apply_transform, invert_transform
from pointsdf_cli.geometry.vessel import fit_vessel
from pointsdf_cli.geometry.vessel_outline import NoVesselError
from pointsdf_cli.geometry.visibility import ViewEvidence
from pointsdf_cli.models.meshing import mesh_reconstruction
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.registry import load_model
from pointsdf_cli.models.vessel_field import VesselField, vessel_in
from pointsdf_cli.models.vessel_surface import vessel_surface

BRICK = Path(__file__).parent / "data" / "noisy_brick.txt"
RADIUS, HEIGHT, WALL, FLOOR = 0.040, 0.090, 0.003, 0.004
CUP = [
    (0, 0),
    (RADIUS, 0),
    (RADIUS, HEIGHT),
    (RADIUS - WALL, HEIGHT),
    (RADIUS - WALL, FLOOR),
    (0, FLOOR),
]


def body(outline):
    return CrossSection([np.array(outline, dtype=float)]).revolve(128)


def camera(elevation=35.0, away=0.6):
    """Pose of a camera that looks at the middle of the cup."""
    turn = np.deg2rad(elevation)
    eye = away * np.array([-np.cos(turn), 0, np.sin(turn)]) + [0, 0, HEIGHT / 2]
    z = ([0, 0, HEIGHT / 2] - eye) / away
    x = np.cross(z, [0, 0, 1.0])
    x = x / np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3] = np.stack([x, np.cross(z, x), z, eye], axis=1)
    return pose


def seen(solid, pose, noise=0.0, pixels=160):
    """What a camera with this pose sees of a solid, camera frame, m."""
    mesh = solid.to_mesh()
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(
        np.float32(mesh.vert_properties[:, :3]), np.ascontiguousarray(mesh.tri_verts, np.uint32)
    )
    x, y = np.meshgrid(*2 * [np.linspace(-0.14, 0.14, pixels)])
    ways = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)
    rays = np.concatenate([np.tile(pose[:3, 3], (len(ways), 1)), ways @ pose[:3, :3].T], axis=1)
    depth = scene.cast_rays(o3d.core.Tensor(np.float32(rays)))["t_hit"].numpy()
    found = np.isfinite(depth)
    away = depth[found] + noise * np.random.default_rng(0).normal(size=found.sum())
    return ways[found] * away[:, None]


def plane_of(pose):
    """The plane z = 0 in the camera's frame."""
    up = pose[2, :3]
    return np.append(up, -pose[2, 3])


def at(radius, height, azimuth=0.0):
    return np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), height])


def in_camera(pose, points):
    return apply_transform(invert_transform(pose), np.atleast_2d(points))


@pytest.fixture(scope="module")
def cup():
    pose = camera()
    return pose, fit_vessel(seen(body(CUP), pose), plane_of(pose))


def test_a_revolved_outline_is_closed_and_faces_outwards() -> None:
    outline = np.array([[0.0, -0.02], [0.05, -0.02], [0.03, 0.06], [0.0, 0.06]])
    direction = np.array([0.6, 0.0, 0.8])
    frustum = BodyOfRevolution.of(direction, np.array([0.1, 0.2, 0.3]), outline)
    vertices, faces = frustum.surface(400)
    body = trimesh.Trimesh(vertices, faces)
    assert body.is_watertight
    assert body.euler_number == 2
    volume = np.pi * 0.08 / 3 * (0.05**2 + 0.05 * 0.03 + 0.03**2)
    assert body.volume == pytest.approx(volume, rel=1e-3)
    # The table interpolates distances over cells of a millimetre.
    assert np.abs(frustum.sdf(body.triangles_center)).max() < 0.001


def test_sphere_and_gradient_in_closed_form():
    turn = np.linspace(-np.pi / 2, np.pi / 2, 400)
    ball = BodyOfRevolution.of(
        np.array([0, 0.6, 0.8]),
        np.array([0.1, -0.2, 0.5]),
        0.05 * np.stack([np.cos(turn), np.sin(turn)], axis=1),
    )
    rng = np.random.default_rng(0)
    points = ball.point + rng.uniform(-0.08, 0.08, (500, 3))
    away = points - ball.point
    distance = np.linalg.norm(away, axis=1)
    clear = np.abs(distance - 0.05) < 0.03
    values, gradients = ball.sdf_and_gradient(points)
    assert np.abs(values - (distance - 0.05))[clear].max() < 1e-4
    assert np.abs(gradients - away / distance[:, None])[clear].max() < 0.05
    assert (ball.sdf(points) == values).all()
    # Beyond the table the distance is never said to be larger than it is.
    points = ball.point + 0.4 * rng.standard_normal((500, 3))
    distance = np.linalg.norm(points - ball.point, axis=1) - 0.05
    values, gradients = ball.sdf_and_gradient(points)
    assert (values < distance + 1e-4).all()
    assert (values > 0.6 * distance - 0.01).all()
    step = 1e-6
    slopes = [
        (ball.sdf(points + step * e) - ball.sdf(points - step * e)) / (2 * step) for e in np.eye(3)
    ]
    assert (np.abs(gradients - np.stack(slopes, axis=1)).max(axis=1) < 1e-3).mean() > 0.98


def test_a_wall_thinner_than_the_tables_cells_is_solid():
    outline = [[0, 0], [0.108, 0], [0.12, 0.25], [0.1188, 0.25], [0.1068, 0.0012], [0, 0.0012]]
    tin = BodyOfRevolution.of(np.array([0.0, 0.0, 1.0]), np.zeros(3), np.array(outline))
    rng = np.random.default_rng(0)
    floor = np.column_stack([rng.uniform(-0.07, 0.07, (300, 2)), np.full(300, 0.0006)])
    values, gradients = tin.sdf_and_gradient(floor + [0, 0, 1e-4])
    assert values == pytest.approx(np.full(300, -0.0005), abs=1e-9)
    assert gradients == pytest.approx(np.tile([0.0, 0.0, 1.0], (300, 1)), abs=1e-9)
    share = rng.uniform(0.05, 0.95, 300)
    wall = tin.at(0.1074 + 0.012 * share, 0.25 * share, rng.uniform(0, 2 * np.pi, 300))
    assert tin.sdf(wall) == pytest.approx(tin.exact_sdf(wall), abs=1e-9)
    assert (tin.sdf(wall) < 0).all()


def test_axis_of_a_cup():
    pose = camera()
    points = oriented_points(seen(body(CUP), pose)[::3])
    start = pose[:3, :3].T @ np.array([0.05, 0.03, 1.0])
    start = start / np.linalg.norm(start)
    fit = refined_axis(points, start, axis_point(points, start))
    up, origin = pose[:3, :3].T @ [0, 0, 1.0], in_camera(pose, np.zeros(3))[0]
    assert np.rad2deg(np.arccos(min(1.0, fit.direction @ up))) < 0.5
    off = fit.point - origin
    assert np.linalg.norm(off - (off @ up) * up) < 0.001
    assert fit.residual < 2e-4


def test_outward_and_height_about_an_axis():
    points = oriented_points(seen(body(CUP), camera())[::3])
    around = turned(points, np.array([0, 0, 1.0]), np.zeros(3))
    assert np.allclose(around.radius, np.hypot(*points.points[:, :2].T))
    assert np.allclose(around.height, points.points[:, 2])


@pytest.mark.parametrize("azimuth", [0.0, 1.5, 3.1])
def test_the_whole_wall_of_a_cup(cup, azimuth):
    pose, vessel = cup
    places = [
        at(RADIUS - WALL / 2, 0.05, azimuth),  # within the wall, also where neither side is seen
        at(RADIUS + 0.02, 0.05, azimuth),
        at(0.0, 0.05, azimuth),
        at(0.02, FLOOR / 2, azimuth),
    ]
    expected = [-WALL / 2, 0.02, RADIUS - WALL, -FLOOR / 2]
    found = vessel.wall.sdf(in_camera(pose, np.array(places)))
    assert np.abs(found[:3] - expected[:3]).max() < 0.0006
    assert found[3] < 0  # a floor; its thickness is not seen
    assert abs(vessel.thickness - WALL) < 0.0005
    assert not len(vessel.others)


def test_noise_of_a_millimetre():
    pose = camera()
    vessel = fit_vessel(seen(body(CUP), pose, noise=0.001), plane_of(pose))
    found = vessel.wall.sdf(in_camera(pose, at(RADIUS - WALL / 2, 0.05, 1.5)))
    assert found[0] < 0.0005


def test_a_cup_that_leans_needs_no_plane():
    pose = camera(elevation=50)
    vessel = fit_vessel(seen(body(CUP), pose))
    up = pose[:3, :3].T @ [0, 0, 1.0]
    assert vessel.wall.direction @ up > 0.999


def test_a_handle_is_another_part():
    handle = Manifold.cube((0.01, 0.035, 0.05), True).translate((0, 0.0565, 0.045))
    pose = camera()
    vessel = fit_vessel(seen(body(CUP) + handle, pose), plane_of(pose))
    others = apply_transform(pose, vessel.others)
    assert len(others) >= 10
    assert (others[:, 1] > RADIUS).all()


@pytest.mark.parametrize(
    "solid",
    [
        body([(0, 0), (RADIUS, 0), (RADIUS, HEIGHT), (0, HEIGHT)]),  # a closed can
        Manifold.cube((0.06, 0.08, HEIGHT), True).translate((0, 0, HEIGHT / 2)),
        Manifold.sphere(0.045, 96).translate((0, 0, 0.045)),
        body([(0.025, 0), (0.045, 0), (0.045, 0.04), (0.025, 0.04)]),  # a ring
    ],
    ids=["can", "box", "ball", "ring"],
)
def test_other_bodies_are_refused(solid):
    pose = camera()
    with pytest.raises(NoVesselError):
        fit_vessel(seen(solid, pose), plane_of(pose))


@pytest.mark.parametrize("count", [1, 20, 150])
@pytest.mark.parametrize("spread", [[0, 0, 0], [0.04, 0, 0], [0.04, 0.04, 0]])
def test_degenerate_clouds_are_refused(count, spread):
    points = np.random.default_rng(0).normal(size=(count, 3)) * spread + [0, 0, 0.6]
    with pytest.raises(NoVesselError):
        fit_vessel(points, np.array([0, 0, -1.0, -0.7]))


def test_a_brick_of_few_noisy_points_is_refused():
    points = 1e-4 * np.loadtxt(BRICK)
    with pytest.raises(NoVesselError, match="noisy"):
        fit_vessel(points, np.array([0.0, -0.94768, -0.31922, -0.4]))


def test_a_recessed_can_is_left_to_the_network():
    """A hollow end looks like a cup's opening: the network says whether the body is solid."""
    pose = camera()
    points, plane = seen(body(CUP), pose), plane_of(pose)
    assert vessel_in(points, plane, lambda x: np.full(len(x), -0.01)) is None
    assert vessel_in(points, plane, lambda x: np.full(len(x), 0.01)) is not None


def test_the_network_counts_near_other_parts_only(cup):
    pose, vessel = cup
    handle = in_camera(pose, np.array([at(RADIUS + 0.02, 0.05, 1.5)] * 10))
    field = VesselField(replace(vessel, others=handle))
    near = in_camera(pose, at(RADIUS + 0.02, 0.05, 1.5))
    far = in_camera(pose, at(RADIUS + 0.02, 0.05, -1.5))
    inside = in_camera(pose, at(0.0, 0.05))
    network = lambda x: np.full(len(x), -0.005)  # noqa: E731
    assert field.sdf(near, network)[0] == pytest.approx(-0.005)
    assert field.sdf(far, network)[0] == pytest.approx(0.02, abs=0.001)
    assert field.sdf(inside, network)[0] > 0.03


def test_gradients_are_those_of_the_values(cup):
    pose, vessel = cup
    handle = in_camera(pose, np.array([at(RADIUS + 0.02, 0.05, 1.5)] * 10))
    field = VesselField(replace(vessel, others=handle))
    middle = handle[0]

    def network(x):
        return np.linalg.norm(x - middle, axis=1) - 0.008

    def with_gradient(x):
        way = x - middle
        length = np.linalg.norm(way, axis=1, keepdims=True)
        return length[:, 0] - 0.008, way / length

    rng = np.random.default_rng(1)
    points = in_camera(pose, rng.uniform([-0.07, -0.07, 0.01], [0.07, 0.07, 0.1], (400, 3)))
    values, gradients = field.sdf_and_gradient(points, with_gradient)
    assert np.allclose(values, field.sdf(points, network))
    step = 1e-6
    numeric = np.stack(
        [
            (field.sdf(points + step * e, network) - field.sdf(points - step * e, network))
            / (2 * step)
            for e in np.eye(3)
        ],
        axis=1,
    )
    close = np.abs(gradients - numeric).max(axis=1) < 1e-3
    assert close.mean() > 0.97  # the others lie on a crease


def test_the_surface_is_closed_and_has_the_cups_volume(cup):
    _, vessel = cup
    vertices, faces, dropped = vessel_surface(vessel)
    mesh = trimesh.Trimesh(vertices, faces)
    cavity = np.pi * (RADIUS - WALL) ** 2 * (HEIGHT - FLOOR)
    volume = np.pi * RADIUS**2 * HEIGHT - cavity
    assert mesh.is_watertight
    assert mesh.body_count == 1
    assert dropped == 0
    assert mesh.volume == pytest.approx(volume, rel=0.15)


def test_a_mug_becomes_one_closed_body_with_a_handle_and_a_bottom():
    handle = Manifold.cube((0.012, 0.04, 0.05), True).translate((0, 0.055, 0.045))
    hole = Manifold.cube((0.02, 0.016, 0.03), True).translate((0, 0.052, 0.045))
    pose = camera()
    points = seen(body(CUP) + (handle - hole - body(CUP[:3] + [(0, HEIGHT)])), pose)
    model = load_model()
    evidence = ViewEvidence(support_plane=plane_of(pose))
    shape = Reconstruction.from_cloud(model, points, np.zeros(3), evidence=evidence)
    assert shape.vessel is not None
    made = mesh_reconstruction(shape, 64)
    mesh = trimesh.Trimesh(made.vertices, made.faces)
    assert mesh.is_watertight
    assert mesh.body_count == 1
    world = apply_transform(pose, made.vertices)
    assert world[:, 1].max() > 0.06  # the handle
    middle = in_camera(pose, np.array([at(0, 0.05), at(0, 0.003)]))
    assert shape.sdf(middle)[0] > 0.02
    assert np.abs(mesh.nearest.on_surface(in_camera(pose, at(0, FLOOR)))[1][0]) < 0.004
    values, gradients = shape.sdf_and_gradient(middle)
    assert np.allclose(values, shape.sdf(middle), atol=1e-6)
    assert gradients.shape == (2, 3)
    alone = Reconstruction.from_cloud(model, points, np.zeros(3), vessels=False)
    assert alone.vessel is None


def test_a_world_frame_changes_nothing():
    pose = camera()
    points = seen(body(CUP), pose)
    model = load_model()
    here = Reconstruction.from_cloud(model, points, np.zeros(3))
    there = Reconstruction.from_cloud(
        model, apply_transform(pose, points), pose[:3, 3], pose[:3, :3]
    )
    places = np.random.default_rng(2).uniform(-0.05, 0.05, (50, 3)) + [0, 0, 0.04]
    assert np.allclose(there.sdf(places), here.sdf(in_camera(pose, places)), atol=2e-5)
