"""Surfaces of fields known in closed form: closed, outward, in place, and as the dense grid's."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from pointsdf_cli.errors import InputError, RgraspError
from pointsdf_cli.geometry.field import FieldFunction
from pointsdf_cli.geometry.frames import random_rotation
from pointsdf_cli.geometry.isosurface import (
    EmptySurfaceError,
    Isosurface,
    IsosurfaceConfig,
    extract_isosurface,
)
from pointsdf_cli.geometry.marching_cubes import CORNERS, cross_cells
from pointsdf_cli.geometry.mise import SearchRules

ROTATION = random_rotation(np.random.default_rng(1)).astype("f4")


def ball(radius: float, centre: tuple[float, float, float] = (0, 0, 0)) -> FieldFunction:
    return lambda x: np.linalg.norm(x - np.float32(centre), axis=1) - radius


def block(half: tuple[float, float, float]) -> FieldFunction:
    def distance(x: np.ndarray) -> np.ndarray:
        q = np.abs(x @ ROTATION) - np.float32(half)
        return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)

    return distance


def ring(x: np.ndarray) -> np.ndarray:
    return np.hypot(np.hypot(x[:, 0], x[:, 1]) - 0.4, x[:, 2]) - 0.08


def bowl(x: np.ndarray) -> np.ndarray:
    """Half a shell, 0.02 thick: a fifth of a cell of the coarse grid."""
    return np.maximum(np.abs(np.linalg.norm(x, axis=1) - 0.45) - 0.01, x[:, 2] - 0.1)


def wavy(x: np.ndarray) -> np.ndarray:
    """Steeper than a distance, as networks are: slopes up to 1.6."""
    waves = np.sin(30 * x[:, 0]) * np.sin(25 * x[:, 1] + 1) * np.sin(20 * x[:, 2])
    return np.linalg.norm(x, axis=1) - 0.45 + 0.03 * waves


FIELDS = {
    "ball": ball(0.45),
    "block": block((0.5, 0.3, 0.2)),
    "ring": ring,
    "bowl": bowl,
    "plate": block((0.5, 0.5, 0.006)),
    "wavy": wavy,
    "cut off": ball(0.6, (0.5, 0.5, 0.5)),
}


def as_mesh(surface: Isosurface) -> trimesh.Trimesh:
    return trimesh.Trimesh(surface.vertices, surface.faces, process=False)


@pytest.mark.parametrize("name", FIELDS)
def test_equals_the_dense_surface_and_is_closed(name: str) -> None:
    sparse = extract_isosurface(FIELDS[name], IsosurfaceConfig(64, coarse=16, smallest_part=0))
    dense = extract_isosurface(
        FIELDS[name], IsosurfaceConfig(64, coarse=64, rules=SearchRules(math.inf), smallest_part=0)
    )
    assert len(sparse.vertices) == len(dense.vertices)
    assert len(sparse.faces) == len(dense.faces)
    distance, match = cKDTree(dense.vertices).query(sparse.vertices)
    assert distance.max() < 1e-6
    assert len(np.unique(match)) == len(dense.vertices)
    mesh = as_mesh(sparse)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    assert sparse.queries < 0.15 * dense.queries


@pytest.mark.parametrize("slope", [1.0, math.inf])
def test_bounds_save_queries_without_changing_the_surface(slope: float) -> None:
    rules = SearchRules(slope=slope)
    surface = extract_isosurface(ball(0.4), IsosurfaceConfig(128, rules=rules))
    plain = extract_isosurface(ball(0.4), IsosurfaceConfig(128))
    assert np.array_equal(np.sort(surface.vertices, axis=0), np.sort(plain.vertices, axis=0))
    assert (surface.queries < plain.queries) == (slope == 1)


def test_ball_has_the_volume_and_normals_of_a_ball() -> None:
    mesh = as_mesh(extract_isosurface(ball(0.5), IsosurfaceConfig(128)))
    assert mesh.volume == pytest.approx(4 / 3 * math.pi * 0.5**3, rel=5e-4)
    assert mesh.euler_number == 2
    outward = np.einsum("ij,ij->i", mesh.face_normals, mesh.triangles_center)
    assert (outward[mesh.area_faces > 1e-9] > 0).all()


def test_ring_has_one_hole() -> None:
    assert as_mesh(extract_isosurface(ring, IsosurfaceConfig(64))).euler_number == 0


def test_newton_step_brings_the_vertices_to_zero() -> None:
    def bent(x: np.ndarray) -> np.ndarray:
        """Zero on the ball, but curved along every edge."""
        d = np.linalg.norm(x, axis=1) - 0.45
        return d + 4 * d**2

    residual = {
        newton: np.abs(bent(extract_isosurface(bent, IsosurfaceConfig(64, newton=newton)).vertices))
        for newton in (False, True)
    }
    # Not the greatest: a vertex keeps a thousandth of its edge away from the edge's ends.
    assert np.percentile(residual[True], 95) < 0.05 * np.percentile(residual[False], 95)


def test_distance_of_the_surface_halves_fourfold_with_the_resolution() -> None:
    volumes = [
        as_mesh(extract_isosurface(ball(0.5), IsosurfaceConfig(n))).volume for n in (32, 64, 128)
    ]
    missing = 1 - np.array(volumes) / (4 / 3 * math.pi * 0.5**3)
    assert missing[0] / missing[1] == pytest.approx(4, rel=0.05)
    assert missing[1] / missing[2] == pytest.approx(4, rel=0.05)


def test_closed_where_it_meets_the_box() -> None:
    mesh = as_mesh(extract_isosurface(lambda x: x[:, 2], IsosurfaceConfig(64)))
    assert mesh.is_watertight
    assert mesh.bounds == pytest.approx(
        np.array([[-0.8, -0.8, -0.8], [0.8, 0.8, 0]]), abs=0.5 * 1.6 / 64 + 1e-6
    )


def test_keeps_the_large_parts_only() -> None:
    def three_balls(x: np.ndarray) -> np.ndarray:
        balls = [ball(0.3), ball(0.2, (0.55, 0, 0)), ball(0.05, (0, 0, 0.5))]
        return np.min([b(x) for b in balls], axis=0)

    default = extract_isosurface(three_balls, IsosurfaceConfig(64))
    assert (as_mesh(default).body_count, default.parts_dropped) == (2, 1)
    largest = extract_isosurface(three_balls, IsosurfaceConfig(64, smallest_part=1))
    assert (as_mesh(largest).body_count, largest.parts_dropped) == (1, 2)
    assert np.abs(largest.vertices).max() < 0.31
    everything = extract_isosurface(three_balls, IsosurfaceConfig(64, smallest_part=0))
    assert as_mesh(everything).body_count == 3


def test_cavity_stays_hollow() -> None:
    shell = extract_isosurface(
        lambda x: np.abs(np.linalg.norm(x, axis=1) - 0.4) - 0.1, IsosurfaceConfig(128)
    )
    assert as_mesh(shell).volume == pytest.approx(4 / 3 * math.pi * (0.5**3 - 0.3**3), rel=2e-3)


def test_follows_a_sheet_that_the_coarse_grid_sees_only_a_part_of() -> None:
    """A plate thinner than a coarse cell, lying between two layers of coarse corners."""

    def plate_with_a_knob(x: np.ndarray) -> np.ndarray:
        q = np.abs(x - np.float32([0, 0, 0.025])) - np.float32([0.6, 0.6, 0.004])
        plate = np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)
        return np.minimum(plate, ball(0.1)(x))

    blind = IsosurfaceConfig(256, rules=SearchRules(reach=0))
    mesh = as_mesh(extract_isosurface(plate_with_a_knob, blind))
    assert np.ptp(mesh.vertices, axis=0)[:2] == pytest.approx([1.2, 1.2], abs=0.01)


def test_every_marching_cubes_case_separates_inside_from_outside() -> None:
    """In a grid of 4³ corners, all outside but those of one cell: the surface must close."""
    shape = (4, 4, 4)
    lows = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), axis=-1).reshape(-1, 1, 3)
    rows = np.ravel_multi_index(tuple(np.moveaxis(lows + CORNERS, -1, 0)), shape)
    places = np.stack(np.unravel_index(np.arange(64), shape), axis=1)
    for case in range(1, 256):
        grid = np.ones(shape, dtype=np.float32)
        for k in np.flatnonzero([case >> k & 1 for k in range(8)]):
            grid[tuple(CORNERS[k] + 1)] = -1
        crossed = cross_cells(rows, grid.ravel())
        edges = np.sort(crossed.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all(), case
        middles = (places[crossed.low] + places[crossed.high]) / 2
        assert trimesh.Trimesh(middles, crossed.faces, process=False).volume > 0, case


def test_nothing_inside_is_an_error() -> None:
    with pytest.raises(EmptySurfaceError, match="nowhere negative"):
        extract_isosurface(lambda x: np.ones(len(x)), IsosurfaceConfig(64))


def test_a_field_that_is_not_finite_is_an_error() -> None:
    with pytest.raises(RgraspError, match="not finite"):
        extract_isosurface(lambda x: np.full(len(x), np.nan), IsosurfaceConfig(64))


@pytest.mark.parametrize("resolution", [0, 31, 100, 1024, -64])
def test_resolution_must_be_a_power_of_two_times_the_coarse_grid(resolution: int) -> None:
    with pytest.raises(InputError, match="32, 64, 128, 256, 512"):
        IsosurfaceConfig(resolution)
