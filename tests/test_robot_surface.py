"""Surface samples cover every link, and the shapes' distances are those of geometry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import cKDTree

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import random_rotation, transform
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.shapes import Shape, cover_points, mesh_shape
from pointsdf_cli.robot.surface import SPACING, link_surface, robot_surface

GRIPPER = Path(__file__).parent / "robots" / "gripper.yaml"


def union_surface(shapes: tuple[Shape, ...], count: int, rng: np.random.Generator) -> np.ndarray:
    """Random points on a union of shapes: on one of them and inside no other."""
    kept = []
    for shape in shapes:
        points, _ = trimesh.sample.sample_surface(
            shape.as_mesh(200), count, seed=int(rng.integers(1 << 31))
        )
        outside = np.ones(len(points), dtype=bool)
        for other in shapes:
            if other is not shape:
                outside &= other.signed_distance(torch.from_numpy(points)).numpy() > 0
        kept.append(points[outside])
    return np.concatenate(kept)


@pytest.mark.parametrize("path", [None, GRIPPER], ids=["lbr4_allegro", "gripper"])
def test_no_part_of_a_link_is_farther_than_one_centimetre_from_a_sample(path: Path | None) -> None:
    robot = load_robot(path)
    rng = np.random.default_rng(0)
    surface = robot_surface(robot)
    assert set(surface) == {link for link in robot.tree.links if robot.tree.shapes[link]}
    for link, points in surface.items():
        probes = union_surface(robot.tree.shapes[link], 4000, rng)
        distance, _ = cKDTree(points).query(probes)
        assert distance.max() <= SPACING + 1e-9, link


@pytest.mark.parametrize(
    "shape",
    [
        Shape("box", (0.05, 0.02, 0.11), np.eye(4)),
        Shape("cylinder", (0.03, 0.08), np.eye(4)),
        Shape("sphere", (0.04,), np.eye(4)),
    ],
    ids=lambda shape: shape.kind,
)
@pytest.mark.parametrize("step", [0.003, 0.01, 0.2])
def test_cover_holds_for_every_shape_and_step(shape: Shape, step: float) -> None:
    samples = cover_points(shape, step)
    on_surface = shape.signed_distance(torch.from_numpy(samples)).abs().max()
    assert on_surface < 1e-9
    rng = np.random.default_rng(1)
    probes = union_surface((shape,), 20_000, rng)
    assert cKDTree(samples).query(probes)[0].max() <= step + 1e-9


def test_signed_distances_are_those_of_geometry() -> None:
    rng = np.random.default_rng(2)
    pose = transform(random_rotation(rng), [0.1, -0.2, 0.05])
    points = torch.from_numpy(rng.uniform(-0.5, 0.5, (500, 3)))
    local = (points.numpy() - pose[:3, 3]) @ pose[:3, :3]
    sphere = Shape("sphere", (0.2,), pose).signed_distance(points).numpy()
    assert sphere == pytest.approx(np.linalg.norm(local, axis=1) - 0.2, abs=1e-9)
    box = Shape("box", (0.3, 0.2, 0.5), pose)
    mesh = trimesh.creation.box((0.3, 0.2, 0.5), transform=pose)
    truth = -trimesh.proximity.signed_distance(mesh, points.numpy())
    assert box.signed_distance(points).numpy() == pytest.approx(truth, abs=1e-8)
    cylinder = Shape("cylinder", (0.1, 0.4), pose).signed_distance(points).numpy()
    radial, along = np.hypot(local[:, 0], local[:, 1]) - 0.1, np.abs(local[:, 2]) - 0.2
    outside = np.hypot(np.maximum(radial, 0), np.maximum(along, 0))
    expected = np.where((radial < 0) & (along < 0), np.maximum(radial, along), outside)
    assert cylinder == pytest.approx(expected, abs=1e-9)


def test_lowest_point_is_that_of_the_mesh() -> None:
    rng = np.random.default_rng(3)
    pose = transform(random_rotation(rng), [0.02, 0.01, -0.03])
    hull = trimesh.creation.icosphere(subdivisions=1, radius=0.05)
    shapes = [
        Shape("box", (0.05, 0.02, 0.11), pose),
        Shape("cylinder", (0.03, 0.08), pose),
        Shape("sphere", (0.04,), pose),
        Shape("hull", (), pose, np.asarray(hull.vertices), np.asarray(hull.faces)),
    ]
    for shape in shapes:
        fine = shape.as_mesh(720)
        for _ in range(5):
            rotation, position = random_rotation(rng), rng.normal(size=3)
            lowest = shape.lowest(torch.from_numpy(rotation), torch.from_numpy(position))
            heights = np.asarray(fine.vertices) @ rotation.T + position
            # A faceted sphere lies within r(1 - cos(half edge)) of the true one.
            tolerance = 3e-4 if shape.kind == "sphere" else 1e-5
            assert float(lowest) == pytest.approx(heights[:, 2].min(), abs=tolerance)


def test_mesh_links_become_hulls(tmp_path: Path) -> None:
    # A torus: its hole is filled, its outside is kept.
    trimesh.creation.torus(0.05, 0.02).export(tmp_path / "ring.stl")
    shape = mesh_shape(tmp_path / "ring.stl", np.array([1.0, 1.0, 2.0]), np.eye(4))
    points = torch.tensor([[0.0, 0, 0], [0.0, 0, 0.05], [0.08, 0, 0]], dtype=torch.float64)
    distance = shape.signed_distance(points).tolist()
    assert distance[0] == pytest.approx(-0.04, abs=1e-3)
    assert distance[1] == pytest.approx(0.01, abs=1e-3)
    assert distance[2] == pytest.approx(0.01, abs=1e-3)
    samples = link_surface((shape,))
    probes, _ = trimesh.sample.sample_surface(shape.as_mesh(), 5000, seed=0)
    assert cKDTree(samples).query(probes)[0].max() <= SPACING


def test_nonsense_spacing_is_refused() -> None:
    with pytest.raises(InputError):
        link_surface((Shape("sphere", (0.1,), np.eye(4)),), 0.0)
