"""Distances to table, obstacles, self and object, and their derivatives, against other sources."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from numpy.typing import NDArray
from planning_worlds import BoxField, SphereField

from pointsdf_cli.errors import InputError
from pointsdf_cli.planning.bodies import BodyDistances
from pointsdf_cli.planning.contacts import WORLD, ContactJacobian, Contacts, link_poses
from pointsdf_cli.planning.environment import Environment, Obstacle, read_environment
from pointsdf_cli.planning.object_distance import ObjectDistances
from pointsdf_cli.planning.robot_geometry import RobotGeometry
from pointsdf_cli.robot.collision import SelfCollision, table_clearance
from pointsdf_cli.robot.description import RobotDescription, load_robot
from pointsdf_cli.robot.kinematics import Kinematics

GRIPPER = Path(__file__).parent / "robots" / "gripper.yaml"


@pytest.fixture(scope="module")
def robot() -> RobotDescription:
    return load_robot()


@pytest.fixture(scope="module")
def kinematics(robot: RobotDescription) -> Kinematics:
    return Kinematics(robot)


@pytest.fixture(scope="module")
def geometry(kinematics: Kinematics) -> RobotGeometry:
    return RobotGeometry(kinematics)


def draw(robot: RobotDescription, count: int, seed: int = 0) -> NDArray[np.float64]:
    return np.random.default_rng(seed).uniform(robot.lower, robot.upper, (count, len(robot.lower)))


def box(name: str, size: tuple[float, ...], at: tuple[float, float, float]) -> Obstacle:
    pose = np.eye(4)
    pose[:3, 3] = at
    return Obstacle(name, "box", size, pose)


def mesh_box(name: str, size: tuple[float, ...], at: tuple[float, float, float]) -> Obstacle:
    pose = np.eye(4)
    pose[:3, 3] = at
    mesh = trimesh.creation.box(size)
    return Obstacle(name, "mesh", (), pose, np.array(mesh.vertices), np.array(mesh.faces))


def per_link(names: tuple[tuple[str, str], ...], contacts: Contacts, other: str) -> dict:
    return {
        a: np.min([contacts.distance[:, m] for m, n in enumerate(names) if n == (a, other)], axis=0)
        for a, b in names
        if b == other
    }


def test_table_distances_are_the_heights_of_lowest_points(robot, kinematics, geometry) -> None:
    q = draw(robot, 20)
    bodies = BodyDistances(geometry, Environment(), exact_to=10.0)
    found = per_link(bodies.names, bodies(link_poses(kinematics, q)), "table")
    links, heights = table_clearance(robot, *kinematics(torch.from_numpy(q)))
    assert set(links) == set(found)
    for k, link in enumerate(links):
        np.testing.assert_allclose(found[link], heights[:, k].numpy(), atol=1e-6)


def test_a_raised_table_is_nearer_by_its_height(robot, kinematics, geometry) -> None:
    poses = link_poses(kinematics, draw(robot, 20))
    flat, raised = (
        BodyDistances(geometry, Environment(table_height=height), exact_to=10.0)
        for height in (0.0, 0.03)
    )
    table = flat.is_table
    lower, nearer = (one(poses).distance[:, table] for one in (flat, raised))
    np.testing.assert_allclose(nearer, lower - 0.03, atol=1e-6)
    rows, columns = (k.ravel() for k in np.indices(lower.shape))
    single = raised.of(poses, rows, np.flatnonzero(table)[columns])
    np.testing.assert_allclose(single.reshape(nearer.shape), nearer, atol=1e-9)


def test_self_distances_agree_with_surface_samples(robot, kinematics, geometry) -> None:
    q = draw(robot, 12, seed=1)
    bodies = BodyDistances(geometry, Environment(table=False), exact_to=0.02)
    contacts = bodies(link_poses(kinematics, q))
    sampled = SelfCollision(kinematics, spacing=0.004)(*kinematics(torch.from_numpy(q))).numpy()
    pairs = SelfCollision(kinematics).pairs
    checked = 0
    for k, pair in enumerate(pairs):
        columns = [m for m, n in enumerate(bodies.names) if set(n) == set(pair)]
        exact = contacts.distance[:, columns].min(axis=1)
        near = (sampled[:, k] < 0.015) & (sampled[:, k] > 0)
        checked += near.sum()
        # Samples can only miss the nearest point, by less than their spacing.
        assert (exact[near] <= sampled[near, k] + 1e-6).all()
        assert (exact[near] >= sampled[near, k] - 0.004).all()
        assert ((exact < 1e-6) == (sampled[:, k] < 1e-6))[np.abs(sampled[:, k]) > 0.004].all()
    assert checked > 5


def test_the_distance_beyond_reach_is_a_lower_bound(robot, kinematics, geometry) -> None:
    poses = link_poses(kinematics, draw(robot, 5))
    environment = Environment((box("shelf", (0.3, 0.3, 0.02), (0.4, 0, 0.4)),))
    exact = BodyDistances(geometry, environment, exact_to=10.0)(poses).distance
    bound = BodyDistances(geometry, environment, exact_to=0.03)(poses).distance
    assert (bound <= exact + 1e-6).all()
    near = exact < 0.03
    np.testing.assert_allclose(bound[near], exact[near], atol=1e-6)


def test_a_mesh_obstacle_is_as_far_as_the_same_box(robot, kinematics, geometry) -> None:
    poses = link_poses(kinematics, draw(robot, 8, seed=2))
    size, at = (0.2, 0.3, 0.1), (0.45, 0.1, 0.5)
    as_box = BodyDistances(geometry, Environment((box("a", size, at),), False), exact_to=1.0)
    as_mesh = BodyDistances(geometry, Environment((mesh_box("a", size, at),), False), exact_to=1.0)
    columns = [m for m, n in enumerate(as_box.names) if n[1] == "a"]
    one = as_box(poses).distance[:, columns]
    two = as_mesh(poses).distance[:, columns]
    assert (one > 0.01).any()
    assert (one < -0.01).any()
    np.testing.assert_allclose(two, one, atol=1e-5)


def test_depths_in_a_solid_mesh_lead_outwards(robot, kinematics, geometry) -> None:
    """A ball of 320 triangles, dented: not convex, so that its triangles are asked."""
    ball = trimesh.creation.icosphere(3, radius=0.2)
    vertices = np.array(ball.vertices)
    vertices[0] *= 0.95
    at = np.eye(4)
    at[:3, 3] = 0.4, 0.0, 0.5
    dented = Obstacle("a", "mesh", (), at, vertices, np.array(ball.faces))
    whole = Obstacle("a", "sphere", (0.2,), at)
    poses = link_poses(kinematics, draw(robot, 150, seed=6))
    found = [
        BodyDistances(geometry, Environment((each,), table=False), exact_to=1.0)(poses)
        for each in (whole, dented)
    ]
    one, two = (contacts.distance for contacts in found)
    deep = one < -0.02
    assert deep.sum() > 20
    assert (two[deep] < 0).all()
    # The way out of the ball, wherever the link is: most are within a few degrees.
    along = (found[0].normal[deep] * found[1].normal[deep]).sum(axis=-1)
    assert (along > 0).mean() > 0.95
    assert np.median(np.abs(two - one)[deep]) < 0.01


def test_a_mesh_with_inward_faces_is_turned_outwards() -> None:
    outward = mesh_box("a", (0.2, 0.3, 0.1), (0.45, 0.1, 0.5))
    inward = replace(outward, faces=outward.faces[:, ::-1])
    np.testing.assert_array_equal(inward.faces, outward.faces)


@pytest.mark.parametrize(
    ("vertices", "faces", "said"),
    [
        ([[0, 0, 0], [1, 0, 0], [0, np.nan, 1]], [[0, 1, 2]], "finite"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 3]], "0 to 2"),
        ([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]], "no mesh"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], "a flat mesh"),
    ],
)
def test_an_obstacle_without_a_sound_mesh_is_refused(vertices, faces, said: str) -> None:
    with pytest.raises(InputError, match=said):
        Obstacle("a", "mesh", (), np.eye(4), np.array(vertices, float), np.array(faces))


def test_single_pairs_are_as_far_as_among_all(robot, kinematics, geometry) -> None:
    poses = link_poses(kinematics, draw(robot, 12, seed=4))
    around = (mesh_box("a", (0.2, 0.3, 0.1), (0.45, 0.1, 0.5)), box("b", (0.2,) * 3, (0, 0.4, 0.3)))
    bodies = BodyDistances(geometry, Environment(around), exact_to=0.1)
    surface = ObjectDistances(geometry, SphereField(0.2, (0.4, 0.0, 0.5)), exact_to=0.1)
    for source, whole in ((bodies, bodies(poses)), (surface, surface(poses, gradients=False))):
        rows, columns = np.random.default_rng(0).integers((12, len(source.names)), size=(500, 2)).T
        expected = whole.distance[rows, columns]
        assert 0 < (expected < 0.1).sum() < 500
        np.testing.assert_allclose(source.of(poses, rows, columns), expected, atol=1e-9)


def test_boxes_are_of_one_size_whatever_a_process_asks_first() -> None:
    """coal grows boxes by 1e-10 for ever where the first direction asked about has a zero in it."""
    first = """
import coal, numpy as np
from pointsdf_cli.planning.bodies import BodyDistances
from pointsdf_cli.planning.environment import Environment
from pointsdf_cli.planning.robot_geometry import RobotGeometry
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.kinematics import Kinematics
BodyDistances(RobotGeometry(Kinematics(load_robot())), Environment())
box, here = coal.Box(1, 1, 1), coal.Transform3s.Identity()
there = coal.Transform3s(np.eye(3), np.array([-2.0, 0, 0]))
print(coal.distance(box, here, box, there, coal.DistanceRequest(), coal.DistanceResult()) - 1)
"""
    run = subprocess.run([sys.executable, "-c", first], capture_output=True, text=True, check=True)
    assert abs(float(run.stdout)) < 1e-13


def test_a_link_inside_of_a_mesh_is_not_free(robot, kinematics, geometry) -> None:
    around = mesh_box("room", (4.0, 4.0, 4.0), (0, 0, 0))
    bodies = BodyDistances(geometry, Environment((around,), table=False), exact_to=10.0)
    contacts = bodies(link_poses(kinematics, robot.home[None]))
    columns = [m for m, n in enumerate(bodies.names) if n[1] == "room"]
    assert (contacts.distance[:, columns] < 0).all()


def test_an_obstacle_may_be_called_like_a_link(robot, kinematics, geometry) -> None:
    poses = link_poses(kinematics, draw(robot, 20))
    far_away = mesh_box(robot.tree.links[-1], (4.0, 4.0, 4.0), (0, 0, 9.0))
    between_links = []
    for obstacles in ((), (far_away,)):
        contacts = BodyDistances(geometry, Environment(obstacles))(poses)
        between_links.append(contacts.distance[:, contacts.other_link != WORLD])
    np.testing.assert_array_equal(*between_links)


def test_a_ball_between_two_samples_is_met_within_the_spacing(robot, kinematics, geometry) -> None:
    # The tip of the middle finger: a ball of 12 mm at the end of the last link.
    rotation, position = link_poses(kinematics, robot.home[None])
    link = kinematics.index("middle_link_3")
    tip = rotation[0, link] @ [0, 0, 0.0267] + position[0, link]
    away = tip + 0.1 * np.array([1.0, 0, 0])
    field = SphereField(0.02, tuple(away))
    distances = ObjectDistances(geometry, field, exact_to=1.0)
    contacts = distances(link_poses(kinematics, robot.home[None]))
    lowest = contacts.distance[0, distances.link == link].min()
    true = 0.1 - 0.02 - 0.012
    assert true - 1e-9 <= lowest <= true + 0.01


@pytest.mark.parametrize("which", ["object", "table", "self", "box", "mesh"])
def test_derivatives_agree_with_differences(robot, kinematics, geometry, which: str) -> None:
    rng = np.random.default_rng(5)
    q = draw(robot, 12, seed=3)
    at = (0.4, 0.0, 0.4)
    if which == "object":
        source = ObjectDistances(geometry, SphereField(0.25, at), exact_to=0.2)
    else:
        obstacles = {
            "box": (box("b", (0.4, 0.6, 0.4), at),),
            "mesh": (mesh_box("b", (0.4, 0.6, 0.4), at),),
        }.get(which, ())
        environment = Environment(obstacles, table=which == "table")
        source = BodyDistances(geometry, environment, exact_to=0.2)
    poses = link_poses(kinematics, q)
    contacts = source(poses)
    kind = {"object": "object", "table": "table", "box": "b", "mesh": "b"}.get(which)
    near = (contacts.distance > 0.002) & (contacts.distance < 0.15)
    if kind is not None:
        near &= np.array([n[1] == kind for n in source.names])
    else:
        near &= source.other_link >= 0
    rows, columns = np.nonzero(near)
    assert len(rows) > 20
    some = rng.choice(len(rows), 20, replace=False)
    every = np.tile(np.arange(near.shape[1]), (len(q), 1))
    jacobian = ContactJacobian(kinematics)(poses, contacts, every)
    step, agree = 1e-5, 0
    shifts = step * np.eye(len(robot.lower))
    for b, m in zip(rows[some], columns[some], strict=True):
        around = link_poses(kinematics, np.concatenate([q[b] + shifts, q[b] - shifts]))
        if isinstance(source, BodyDistances):
            values = source(around, np.arange(len(source.names)) == m).distance[:, m]
        else:
            values = source(around).distance[:, m]
        up, down = np.split(values, 2)
        agree += np.allclose(jacobian[b, m], (up - down) / (2 * step), atol=2e-3)
    # At a kink (two equally near points) the one-sided slopes differ: rare, but met at random.
    assert agree >= 18


def test_a_sliding_jaw_moves_by_its_axis() -> None:
    robot = load_robot(GRIPPER)
    kinematics = Kinematics(robot)
    geometry = RobotGeometry(kinematics)
    q = (robot.lower + robot.upper)[None] / 2
    source = ObjectDistances(geometry, BoxField((0.1, 0.1, 0.1), (2.0, 0.5, 0.0)), exact_to=9.0)
    poses = link_poses(kinematics, q)
    contacts = source(poses)
    every = np.arange(contacts.distance.shape[1])[None]
    jacobian = ContactJacobian(kinematics)(poses, contacts, every)[0]
    step = 1e-6
    for j in range(q.shape[1]):
        shift = np.eye(q.shape[1])[j] * step
        up = source(link_poses(kinematics, q + shift)).distance[0]
        down = source(link_poses(kinematics, q - shift)).distance[0]
        np.testing.assert_allclose(jacobian[:, j], (up - down) / (2 * step), atol=1e-5)


def test_environment_file(tmp_path: Path) -> None:
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "bin.stl")
    file = tmp_path / "scene.yaml"
    file.write_text(
        "table: false\nobstacles:\n"
        "  - {name: shelf, box: [0.6, 0.3, 0.02], xyz: [0.6, 0, 0.4], wxyz: [0, 0, 0, 1]}\n"
        "  - {mesh: bin.stl, scale: 2.0}\n"
    )
    environment = read_environment(file)
    assert not environment.table
    shelf, bin_ = environment.obstacles
    assert shelf.size == (0.6, 0.3, 0.02)
    np.testing.assert_allclose(shelf.pose[:3, :3] @ [1, 0, 0], [-1, 0, 0], atol=1e-12)
    assert bin_.vertices is not None
    assert np.ptp(bin_.vertices) == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("obstacles: 3", "is not a list"),
        ("walls: []", "unknown keys"),
        ("table: maybe", "true, false"),
        ("obstacles: [{box: [1, 1, 1], sphere: [1]}]", "2 shapes"),
        ("obstacles: [{box: [1, 1]}]", "3 finite"),
        ("obstacles: [{box: [1, 1, -1]}]", "above 0"),
        ("obstacles: [{box: '123'}]", "3 finite"),
        ("obstacles: [{sphere: [1], scale: 2}]", "scale with mesh only"),
        ("obstacles: [{mesh: gone.stl}]", "gone.stl"),
        ("obstacles: [{sphere: [1], wxyz: [1, 1, 0, 0]}]", "unit quaternion"),
        ("obstacles: [{name: a, sphere: [1]}, {name: a, sphere: [1]}]", "share a name"),
        ("a: [", "YAML"),
    ],
)
def test_environment_mistakes_are_named(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text(text)
    with pytest.raises(InputError, match=message):
        read_environment(file)


def test_a_links_distance_is_that_of_its_nearest_sample(
    geometry: RobotGeometry, kinematics: Kinematics, robot: RobotDescription
) -> None:
    ball = SphereField(0.05, (0.5, 0.1, 0.3))
    asked: list[int] = []

    class Counted(SphereField):
        def __call__(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
            asked.append(len(points))
            return super().__call__(points)

    distances = ObjectDistances(geometry, Counted(0.05, (0.5, 0.1, 0.3)))
    patches = geometry.patches
    for q in draw(robot, 5):
        poses = link_poses(kinematics, q[None])
        asked.clear()
        found = distances.by_link(poses)
        turn, at = poses.rotation[0, patches.link], poses.position[0, patches.link]
        world = patches.points @ turn.transpose(0, 2, 1) + at[:, None]
        values = ball(world.reshape(-1, 3)).reshape(len(world), -1).min(axis=1)
        for link in range(len(found)):
            expected = values[patches.link == link].min(initial=np.inf)
            assert found[link] == pytest.approx(expected)
        assert sum(asked) < patches.points.size / 3 / 2
