"""Smoothing takes ripples off a sphere and leaves the sphere."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pointsdf_cli.geometry.smoothing import taubin_smooth
from pointsdf_cli.geometry.volume import enclosed_volume

BALL = trimesh.creation.icosphere(subdivisions=5, radius=0.05)
FACES = np.asarray(BALL.faces, np.int32)


def normal_error(vertices: np.ndarray) -> float:
    """Mean of 1 − |cosine| between face normals and the sphere's."""
    corners = vertices[FACES]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = corners.mean(axis=1)
    cosine = np.einsum("ij,ij->i", normals, outward) / (
        np.linalg.norm(normals, axis=1) * np.linalg.norm(outward, axis=1)
    )
    return float(1 - np.abs(cosine).mean())


def test_ripples_go_and_the_volume_stays() -> None:
    rng = np.random.default_rng(0)
    rough = BALL.vertices * (1 + 0.01 * rng.standard_normal((len(BALL.vertices), 1)))
    smooth = taubin_smooth(rough, FACES, 25)
    assert normal_error(smooth) < 0.1 * normal_error(rough)
    assert enclosed_volume(smooth, FACES) == pytest.approx(BALL.volume, rel=0.005)
    assert np.abs(np.linalg.norm(smooth, axis=1) - 0.05).max() < 0.001  # 1.8 mm before


def test_a_smooth_sphere_hardly_moves() -> None:
    # Vertices may slide along the surface; their distance from the centre is what counts.
    radius = np.linalg.norm(taubin_smooth(BALL.vertices, FACES, 25), axis=1)
    assert np.abs(radius - 0.05).max() < 1e-4


def test_no_iterations_change_nothing() -> None:
    assert taubin_smooth(BALL.vertices, FACES, 0) is BALL.vertices
