"""The camera against geometry computed by hand."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import trimesh

from pointsdf_cli.camera.intrinsics import read_intrinsics
from pointsdf_cli.camera.noise import DepthNoise
from pointsdf_cli.camera.pinhole import CAMERAS, Camera
from pointsdf_cli.camera.raycast import MeshCaster, depth_image
from pointsdf_cli.camera.views import ViewConfig, render_views, sample_cloud
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import apply_transform, invert_transform, transform
from pointsdf_cli.geometry.signed_distance import SignedDistance
from pointsdf_cli.io.meshes import LoadedMesh

REFERENCE = CAMERAS["reference"]


def loaded(mesh: trimesh.Trimesh) -> LoadedMesh:
    return LoadedMesh("m", np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32), "0", "none")


def test_the_reference_camera_has_the_paper_s_field_of_view() -> None:
    top = REFERENCE.back_project(REFERENCE.cx, -0.5, 1.0)
    bottom = REFERENCE.back_project(REFERENCE.cx, 479.5, 1.0)
    angle = math.atan2(-top[1], 1) + math.atan2(bottom[1], 1)
    assert angle == pytest.approx(0.820305, abs=1e-9)


def test_projection_undoes_back_projection() -> None:
    points = np.array([[0.1, -0.2, 1.5], [0.0, 0.0, 0.7], [-0.3, 0.1, 2.0]])
    pixels = REFERENCE.project(points)
    np.testing.assert_allclose(
        REFERENCE.back_project(pixels[:, 0], pixels[:, 1], points[:, 2]), points, atol=1e-12
    )


def test_plus_y_is_down_and_plus_x_is_right() -> None:
    u, v = REFERENCE.project(np.array([0.1, 0.2, 1.5]))
    assert u > REFERENCE.cx
    assert v > REFERENCE.cy


def test_a_box_face_on_is_a_rectangle_of_constant_depth() -> None:
    # Its near face, 8 × 6 cm at 1.48 m, spans f·0.08/1.48 by f·0.06/1.48 pixels.
    box = trimesh.creation.box((0.08, 0.06, 0.04))
    patch = MeshCaster(box.vertices, box.faces, REFERENCE).cast(transform(np.eye(3), [0, 0, 1.5]))
    assert np.abs(patch.depth - 1.48).max() < 1e-6
    assert np.ptp(patch.u) + 1 == pytest.approx(REFERENCE.fx * 0.08 / 1.48, abs=1)
    assert np.ptp(patch.v) + 1 == pytest.approx(REFERENCE.fy * 0.06 / 1.48, abs=1)
    assert patch.covered == len(patch.u) / (640 * 480)


def test_the_window_misses_nothing_that_the_whole_image_sees() -> None:
    torus = trimesh.creation.torus(0.05, 0.02)
    caster = MeshCaster(torus.vertices, torus.faces, REFERENCE)
    rotation = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    pose = transform(rotation, [0.3, -0.25, 1.0])  # off centre, towards a corner
    windowed = caster.cast(pose)
    caster.window_around = lambda _: (0, 640, 0, 480)
    whole = caster.cast(pose)
    np.testing.assert_array_equal(
        depth_image(windowed, REFERENCE) > 0, depth_image(whole, REFERENCE) > 0
    )


def test_a_mesh_around_the_camera_is_seen_everywhere() -> None:
    room = trimesh.creation.box((1.0, 1.0, 1.0))
    patch = MeshCaster(room.vertices, room.faces, REFERENCE).cast(np.eye(4))
    assert patch.covered == 1.0


def test_noise_is_a_millimetre_at_one_and_a_half_metres_and_grows_with_the_square() -> None:
    noise = DepthNoise()
    rng = np.random.default_rng(0)
    for depth, expected in ((1.5, 1e-3), (3.0, 4e-3)):
        true = np.full(40_000, depth, dtype=np.float32)
        assert (noise.apply(true, rng) - true).std() == pytest.approx(expected, rel=0.02)


def test_views_lie_on_the_surface_when_there_is_no_noise() -> None:
    torus = trimesh.creation.torus(0.05, 0.02)
    views, _ = render_views(
        loaded(torus), ViewConfig(views=5, noise=DepthNoise(0.0)), np.random.default_rng(0)
    )
    field = SignedDistance(torus.vertices, torus.faces, threads=1)
    for cloud, pose in zip(views.cloud, views.T_camera_object, strict=True):
        assert np.abs(field(apply_transform(invert_transform(pose), cloud))).max() < 1e-6


def test_views_from_above_see_into_a_cup_and_turn_it_evenly() -> None:
    """Cameras above the horizon only, as many at every height, and never a mirrored object."""
    cup = trimesh.creation.annulus(0.03, 0.035, 0.08)
    config = ViewConfig(views=200, noise=DepthNoise(0.0), above=True)
    views, _ = render_views(loaded(cup), config, np.random.default_rng(0))
    cameras = np.array([invert_transform(pose)[:3, 3] for pose in views.T_camera_object])
    height = cameras[:, 2] / 1.5  # of directions spread evenly over the half sphere: 0 to 1, evenly
    assert height.min() > 0
    assert np.percentile(height, [25, 50, 75]) == pytest.approx([0.25, 0.5, 0.75], abs=0.08)
    assert np.abs(cameras[:, :2].mean(axis=0)).max() < 0.15
    assert np.linalg.det(views.T_camera_object[:, :3, :3]) == pytest.approx(1)
    anywhere, _ = render_views(
        loaded(cup), ViewConfig(views=50, noise=DepthNoise(0.0)), np.random.default_rng(0)
    )
    below = [invert_transform(pose)[2, 3] < 0 for pose in anywhere.T_camera_object]
    assert 10 < sum(below) < 40


def test_views_see_the_near_side_only_at_the_distance_asked_for() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.05)
    views, _ = render_views(
        loaded(ball), ViewConfig(views=8, distance=1.2), np.random.default_rng(0)
    )
    centres = views.T_camera_object[:, :3, 3]
    np.testing.assert_allclose(centres, np.broadcast_to([0, 0, 1.2], (8, 3)), atol=1e-9)
    # The silhouette of a ball lies at its centre's depth, less r²/d.
    assert views.cloud[..., 2].max() < 1.2
    assert views.cloud[..., 2].min() == pytest.approx(1.15, abs=0.005)


def test_few_pixels_fill_the_cloud_by_repetition_and_many_are_drawn_once() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.012)
    patch = MeshCaster(ball.vertices, ball.faces, REFERENCE).cast(transform(np.eye(3), [0, 0, 1.5]))
    few = sample_cloud(patch, REFERENCE, np.random.default_rng(0))
    assert len(few) == 1000
    assert len(np.unique(few, axis=0)) == len(patch.u) < 1000
    many = sample_cloud(patch, REFERENCE, np.random.default_rng(0), count=40)
    assert len(np.unique(many, axis=0)) == 40


def test_what_cannot_be_seen_is_refused() -> None:
    speck = trimesh.creation.icosphere(subdivisions=1, radius=0.002)
    with pytest.raises(InputError, match="saw fewer than"):
        render_views(loaded(speck), ViewConfig(views=1), np.random.default_rng(0))


def test_a_camera_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "K.json"
    K = [[600, 0, 320], [0, 610, 240], [0, 0, 1]]
    path.write_text(json.dumps({"width": 640, "height": 480, "K": K}))
    np.testing.assert_array_equal(read_intrinsics(str(path)).K, K)


@pytest.mark.parametrize(("cx", "cy"), [(319.5, 239.5), (320.0, 240.0)])
def test_without_a_size_the_principal_point_is_the_middle(
    tmp_path: Path, cx: float, cy: float
) -> None:
    """Centres of pixels are whole numbers, but many files call half the width the middle."""
    path = tmp_path / "K.json"
    path.write_text(json.dumps({"K": [[575, 0, cx], [0, 575, cy], [0, 0, 1]]}))
    camera = read_intrinsics(str(path))
    assert (camera.width, camera.height) == (640, 480)


def test_rays_of_a_mask_are_the_tangents_of_its_pixels() -> None:
    camera = Camera(640, 480, 500.0, 400.0, 320.0, 240.0)
    mask = np.zeros((3, 4), dtype=bool)
    mask[2, 1] = mask[0, 3] = True
    # Pixels (23, 10) and (21, 12), row by row.
    rays = camera.rays_of(mask, origin=(20, 10))
    assert rays == pytest.approx(np.array([[-297 / 500, -230 / 400], [-299 / 500, -228 / 400]]))
