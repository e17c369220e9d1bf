"""Signed distances against closed forms, and signs where parity alone would be wrong."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import trimesh

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.sdf_sampling import SamplingConfig, sample_sdf
from pointsdf_cli.geometry.signed_distance import SignedDistance, sample_surface
from pointsdf_cli.geometry.volume import enclosed_volume

POINTS = np.random.default_rng(0).uniform(-0.1, 0.1, (20_000, 3))


def box_distance(points: np.ndarray, half: np.ndarray) -> np.ndarray:
    q = np.abs(points) - half
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)


def torus_distance(points: np.ndarray, major: float, minor: float) -> np.ndarray:
    ring = np.hypot(points[:, 0], points[:, 1]) - major
    return np.hypot(ring, points[:, 2]) - minor


CASES = {
    "sphere": (
        trimesh.creation.icosphere(subdivisions=7, radius=0.05),
        np.linalg.norm(POINTS, axis=1) - 0.05,
        0.1,
    ),
    "box": (
        trimesh.creation.box((0.08, 0.06, 0.04)),
        box_distance(POINTS, np.array([0.04, 0.03, 0.02])),
        0.08,
    ),
    "torus": (
        trimesh.creation.torus(0.04, 0.015, major_sections=400, minor_sections=200),
        torus_distance(POINTS, 0.04, 0.015),
        0.11,
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_distances_are_those_of_the_closed_form(name: str) -> None:
    mesh, expected, size = CASES[name]
    found = SignedDistance(mesh.vertices, mesh.faces, threads=1)(POINTS)
    assert np.abs(found - expected).max() <= 1e-4 * size
    clear = np.abs(expected) > 1e-4 * size
    assert ((found < 0) == (expected < 0))[clear].all()


def test_far_from_the_origin_distances_are_as_exact() -> None:
    shift = np.array([12.0, -7.0, 3.0])
    mesh = trimesh.creation.box((0.08, 0.06, 0.04)).apply_translation(shift)
    found = SignedDistance(mesh.vertices, mesh.faces, threads=1)(POINTS + shift)
    assert np.abs(found - box_distance(POINTS, np.array([0.04, 0.03, 0.02]))).max() < 1e-6


def test_the_overlap_of_two_boxes_is_inside_although_a_ray_crosses_twice() -> None:
    one = trimesh.creation.box((0.1, 0.1, 0.1))
    both = trimesh.util.concatenate([one, one.copy().apply_translation([0.05, 0.01, 0.02])])
    field = SignedDistance(both.vertices, both.faces, threads=1)
    inside_both = np.array([[0.025, 0.0, 0.0], [0.02, 0.02, 0.03]])
    assert field.inside(inside_both).all()
    assert (field(inside_both) < 0).all()
    assert not field.inside([[0.2, 0, 0], [-0.06, 0, 0]]).any()


def test_two_boxes_that_touch_face_to_face_are_inside_on_both_sides() -> None:
    one = trimesh.creation.box((0.1, 0.1, 0.1))
    both = trimesh.util.concatenate([one, one.copy().apply_translation([0.1, 0, 0])])
    probes = np.random.default_rng(3).uniform([-0.04, -0.04, -0.04], [0.14, 0.04, 0.04], (500, 3))
    assert SignedDistance(both.vertices, both.faces, threads=1).inside(probes).all()


def test_no_points_give_no_distances(box_mesh: trimesh.Trimesh) -> None:
    field = SignedDistance(box_mesh.vertices, box_mesh.faces)
    assert field(np.zeros((0, 3))).shape == (0,)
    assert field.inside(np.zeros((0, 3))).shape == (0,)


def test_surface_samples_lie_on_the_surface_and_cover_it_by_area(box_mesh: trimesh.Trimesh) -> None:
    points, normals = sample_surface(
        box_mesh.vertices, box_mesh.faces, 60_000, np.random.default_rng(0)
    )
    half = np.array([0.04, 0.03, 0.02])
    assert np.abs(box_distance(points, half)).max() < 1e-12
    # A box of 8 × 6 × 4: the ±z faces hold 48 of 104 halves of the area.
    assert abs((np.abs(normals[:, 2]) > 0.5).mean() - 48 / 104) < 0.01
    assert (np.einsum("ij,ij->i", points, normals) > 0).all()


def test_the_inside_share_of_uniform_labels_is_the_volume_of_the_ball() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.05)
    config = SamplingConfig(points=40_000, wide_share=0.0, near_share=0.0)
    samples = sample_sdf(ball.vertices, ball.faces, config, np.random.default_rng(0))
    # The ball's diameter is 1/1.03 of the unit; the box has sides of 1.2 units.
    expected = 4 / 3 * np.pi * (0.5 / 1.03) ** 3 / 1.2**3
    assert samples.uniform_inside == pytest.approx(expected, abs=0.01)
    assert samples.expected_inside == pytest.approx(expected, rel=0.01)


def test_label_jitter_has_the_paper_s_variances() -> None:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.05)
    config = SamplingConfig(points=30_000, wide_share=0.5, near_share=0.5)
    samples = sample_sdf(ball.vertices, ball.faces, config, np.random.default_rng(0))
    unit = 1.03 * 0.1
    wide, near = np.split(samples.sdf / unit, 2)
    # Across a nearly flat surface the jitter's normal part is the distance itself.
    assert wide.std() == pytest.approx(np.sqrt(0.0025), rel=0.05)
    assert near.std() == pytest.approx(np.sqrt(0.00025), rel=0.05)


def test_shares_that_both_round_up_leave_no_negative_rest(box_mesh: trimesh.Trimesh) -> None:
    vertices, faces = np.asarray(box_mesh.vertices), box_mesh.faces.astype(np.int32)
    samples = sample_sdf(vertices, faces, SamplingConfig(4003, 0.5, 0.5), np.random.default_rng(0))
    assert samples.points.shape == (4003, 3)


def test_a_surface_that_crosses_itself_is_refused() -> None:
    # A box with its top half turned inside out through the bottom: volume and signs disagree.
    mesh = trimesh.creation.box((0.1, 0.1, 0.1))
    inverted = mesh.copy()
    inverted.apply_scale([1, 1, 0.5])
    inverted.invert()
    soup = trimesh.util.concatenate([mesh, inverted.apply_translation([0.05, 0, 0])])
    with pytest.raises(InputError, match="inside and outside mean nothing"):
        sample_sdf(
            soup.vertices,
            np.asarray(soup.faces, np.int32),
            SamplingConfig(20_000),
            np.random.default_rng(0),
        )


def test_enclosed_volume_does_not_depend_on_the_origin(box_mesh: trimesh.Trimesh) -> None:
    moved = box_mesh.vertices + [3.0, 4.0, 5.0]
    assert enclosed_volume(moved, np.asarray(box_mesh.faces)) == pytest.approx(0.08 * 0.06 * 0.04)


def test_threads_that_ask_for_open3d_at_once_both_get_it() -> None:
    """In a new process: one thread imports it, the other must wait until it is whole."""
    program = """
import threading, numpy as np
from concurrent.futures import ThreadPoolExecutor
from pointsdf_cli.geometry.signed_distance import SignedDistance
corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
together = threading.Barrier(4)
def distance(_):
    together.wait()
    return SignedDistance(corners, faces, threads=1)(np.array([[0.0, 0.0, -0.5]]))[0]
with ThreadPoolExecutor(4) as pool:
    print(sum(pool.map(distance, range(4))))
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert float(run.stdout) == pytest.approx(2.0)
