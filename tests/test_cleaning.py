"""Cleaning drops what no surface returned and nothing of thin or hollow objects."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pointsdf_cli.camera.cleaning import clean, flying_pixels
from pointsdf_cli.camera.pinhole import CAMERAS
from pointsdf_cli.camera.raycast import MeshCaster, depth_image
from pointsdf_cli.errors import InputError
from pointsdf_cli.viz.shading import look_at

CAMERA = CAMERAS["reference"]


def _tube(radius: float, inner: float, height: float) -> trimesh.Trimesh:
    """An open vessel with its foot at z = 0: an outer and an inner wall, and a bottom."""
    wall = trimesh.creation.annulus(inner, radius, height)
    wall.apply_translation((0, 0, height / 2))
    bottom = trimesh.creation.cylinder(radius, 0.004)
    bottom.apply_translation((0, 0, 0.002))
    return trimesh.util.concatenate([wall, bottom])


def _mug() -> trimesh.Trimesh:
    handle = trimesh.creation.torus(0.028, 0.005)
    handle.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    handle.apply_translation((0.045, 0, 0.05))
    return trimesh.util.concatenate([_tube(0.042, 0.038, 0.1), handle])


def _bowl() -> trimesh.Trimesh:
    return _tube(0.08, 0.076, 0.055)


def _marker() -> trimesh.Trimesh:
    marker = trimesh.creation.cylinder(0.01, 0.12)
    marker.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (0, 1, 0)))
    return marker


def _spatula() -> trimesh.Trimesh:
    handle = trimesh.creation.cylinder(0.006, 0.2)
    handle.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (0, 1, 0)))
    blade = trimesh.creation.box((0.09, 0.07, 0.0015))
    blade.apply_translation((0.14, 0, 0))
    return trimesh.util.concatenate([handle, blade])


THIN = {"mug": _mug, "bowl": _bowl, "marker": _marker, "spatula": _spatula}


def _seen(
    mesh: trimesh.Trimesh, azimuth: float, elevation: float, distance: float, noise: float = 0.001
) -> np.ndarray:
    """A depth image [480, 640] with noise that grows with the square of depth."""
    away = np.array([np.cos(azimuth), np.sin(azimuth), 0]) * np.cos(elevation)
    away[2] = np.sin(elevation)
    middle = mesh.bounds.mean(axis=0)
    pose = look_at(middle + distance * away, middle)
    patch = MeshCaster(mesh.vertices, mesh.faces, CAMERA).cast(np.linalg.inv(pose))
    depth = depth_image(patch, CAMERA).astype(float)
    rng = np.random.default_rng(0)
    return np.where(depth > 0, depth + noise * depth**2 * rng.standard_normal(depth.shape), 0.0)


def _points(depth: np.ndarray, count: int = 2000, seed: int = 0) -> np.ndarray:
    v, u = np.nonzero(depth)
    points = CAMERA.back_project(u, v, depth[v, u])
    rng = np.random.default_rng(seed)
    return points[rng.permutation(len(points))[:count]]


@pytest.mark.parametrize("name", THIN)
@pytest.mark.parametrize("elevation", [0.25, 0.6, 1.2])
def test_nothing_thin_or_hollow_is_eaten(name: str, elevation: float) -> None:
    mesh = THIN[name]()
    for azimuth in (0.0, 0.9, 1.6, 2.5, 4.0):
        for distance in (0.5, 1.0):
            depth = _seen(mesh, azimuth, elevation, distance)
            for count in (1000, 2000, 100_000):
                points = _points(depth, count)
                cleaned = clean(points)
                assert cleaned.kept.mean() > 0.99, (azimuth, distance, count, cleaned.report())
            on_edge = flying_pixels(depth, CAMERA.fx)
            assert on_edge.sum() < 0.01 * (depth > 0).sum()


def test_both_walls_of_a_mug_are_kept_where_an_eroded_mask_parts_them() -> None:
    # Seen almost from the side, the rim hides most of the far inner wall.
    depth = _seen(_mug(), 2.5, 0.45, 0.7)
    near = depth[depth > 0].min()
    jump = np.zeros(depth.shape, dtype=bool)
    for axis in (0, 1):
        for step in (-3, -2, -1, 1, 2, 3):
            beside = np.roll(depth, step, axis)
            jump |= np.abs(beside - depth) > 0.01
    depth[jump] = 0
    points = _points(depth, 2000)
    far_wall = points[:, 2] > near + 0.055
    assert 20 < far_wall.sum() < 0.5 * len(points)
    assert clean(points).kept[far_wall].mean() > 0.98


@pytest.mark.parametrize("size", [1, 6, 40])
@pytest.mark.parametrize("name", THIN)
def test_a_speck_behind_the_object_goes(name: str, size: int) -> None:
    points = _points(_seen(THIN[name](), 0.9, 0.6, 0.8), 1500)
    rng, count = np.random.default_rng(1), len(points)
    speck = np.median(points, axis=0) * (1 + 0.2 / 0.8) + 0.002 * rng.standard_normal((size, 3))
    cleaned = clean(np.concatenate([points, speck]))
    assert not cleaned.kept[count:].any()
    assert cleaned.kept[:count].mean() > 0.995
    assert cleaned.dropped == np.count_nonzero(~cleaned.kept)
    assert f"of {count + size} points" in cleaned.report()


def test_pixels_between_an_object_and_the_wall_behind_it_fly() -> None:
    depth = np.full((120, 160), 1.2)
    depth[40:80, 50:100] = 0.8
    true = depth.copy()
    rng = np.random.default_rng(2)
    edge = np.zeros(depth.shape, dtype=bool)
    edge[40:80, 100] = True
    depth[edge] = rng.uniform(0.85, 1.15, 40)
    found = flying_pixels(depth, 570.0)
    assert found[edge].mean() > 0.9
    assert not found[~edge].any()
    assert not flying_pixels(true, 570.0).any()
    v, u = np.nonzero(depth)
    points = CAMERA.back_project(u + 240, v + 180, depth[v, u])
    cleaned = clean(points, specks=False)
    assert cleaned.kept[~edge[v, u]].all()
    assert (~cleaned.kept[edge[v, u]]).mean() > 0.8
    assert cleaned.flying > 0.8 * 40
    assert "flying pixels" in cleaned.report()


def test_a_steep_surface_is_no_flying_pixel() -> None:
    camera = CAMERA
    v, u = np.mgrid[0:480, 0:640]
    # The plane is seen at 80° in its middle: n·x = n·(0, 0, 0.8).
    normal = np.array([np.sin(np.radians(80)), 0, np.cos(np.radians(80))])
    rays = camera.back_project(u, v, np.ones(u.shape))
    depth = normal[2] * 0.8 / (rays @ normal)
    seen = (np.abs(u - 320) < 40) & (np.abs(v - 240) < 60)
    assert not flying_pixels(np.where(seen, depth, 0), camera.fx).any()
    assert clean((rays * depth[..., None])[seen]).kept.all()


def test_a_clean_cloud_is_kept_whole_and_said_nothing_about() -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform((-0.05, -0.05, 0.7), (0.05, 0.05, 0.7), (1000, 3))
    cleaned = clean(points)
    assert cleaned.kept.all()
    assert cleaned.report() == ""


@pytest.mark.parametrize(
    "points",
    [
        np.ones((1, 3)),
        np.ones((3, 3)),
        np.ones((500, 3)),
        np.repeat(np.random.default_rng(0).uniform(0.5, 0.6, (60, 3)), 20, axis=0),
        np.random.default_rng(0).uniform(-0.1, 0.1, (500, 3)),
    ],
    ids=["one", "three", "one place", "repeated", "around the origin"],
)
def test_odd_clouds_are_no_error(points: np.ndarray) -> None:
    assert clean(points).kept.mean() > 0.9
    assert not len(clean(np.zeros((0, 3))).kept)


def test_repeats_and_order_do_not_matter() -> None:
    points = np.concatenate([_points(_seen(_mug(), 0.9, 0.6, 0.8), 1500), [[0, 0, 1.1]]])
    order = np.random.default_rng(4).permutation(len(points))
    first, shuffled = clean(points), clean(points[order])
    assert np.array_equal(first.kept[order], shuffled.kept)
    assert not first.kept[-1]


def test_wrong_input_is_refused() -> None:
    with pytest.raises(InputError, match="shape"):
        clean(np.zeros((5, 2)))
