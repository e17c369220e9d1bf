"""Surfaces whose finest values are interpolated: where they lie, that they are closed, what they
cost."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pointsdf_cli.geometry.cubic_cells import STENCIL, bends, cubic_cells
from pointsdf_cli.geometry.field import FieldFunction
from pointsdf_cli.geometry.isosurface import IsosurfaceConfig, extract_isosurface
from pointsdf_cli.geometry.mise import SearchRules

RNG = np.random.default_rng(0)
TILT = np.linalg.qr(RNG.normal(size=(3, 3)))[0].astype(np.float32)


def ball(x: np.ndarray) -> np.ndarray:
    return np.linalg.norm(x - 0.013, axis=1) - 0.4


def ring(x: np.ndarray) -> np.ndarray:
    return np.hypot(np.hypot(x[:, 0], x[:, 1]) - 0.35, x[:, 2] - 0.01) - 0.12


def block(x: np.ndarray) -> np.ndarray:
    q = np.abs(x @ TILT) - np.float32([0.3, 0.2, 0.1])
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)


def plate(x: np.ndarray) -> np.ndarray:
    """A fiftieth thick: less than a cell of 64³."""
    return np.maximum(np.abs(x @ TILT[:, 0]) - 0.01, np.linalg.norm(x, axis=1) - 0.5)


def cut_off(x: np.ndarray) -> np.ndarray:
    """Sticks out of the box on two sides."""
    return np.linalg.norm(x - np.float32([0.6, 0.1, -0.5]), axis=1) - 0.5


def diamond(x: np.ndarray) -> np.ndarray:
    """Through corners of every grid, so that rounding decides the signs there."""
    return (np.abs(x).sum(axis=1) - 0.4) / np.sqrt(3)


def noisy(x: np.ndarray) -> np.ndarray:
    """A ball whose field jumps a little from cell to cell of a grid of its own, as networks' do."""
    steps = np.floor(x * 37).astype(np.int64) @ np.array([7919, 104729, 1299709])
    return ball(x) + 0.004 * ((steps % 101) / 50 - 1)


def spiky(seed: int) -> FieldFunction:
    """A ball with spikes at corners of 64³, where no bound is true."""
    drawn = np.random.default_rng(seed).uniform(-1, 1, 4099)

    def field(x: np.ndarray) -> np.ndarray:
        corner = np.rint((x.astype(np.float64) + 0.8) / 0.025)
        apart = np.linalg.norm(x - (corner * 0.025 - 0.8), axis=1)
        which = drawn[(corner.astype(np.int64) @ np.array([7919, 104729, 1299709])) % 4099]
        height = np.where(np.abs(which) < 0.2, np.sign(which) * 0.15, 0)
        return (ball(x) + height * np.exp(-((apart / 0.004) ** 2))).astype("f4")

    return field


FIELDS = {"ball": ball, "ring": ring, "block": block, "plate": plate, "cut": cut_off}
FIELDS |= {"diamond": diamond, "noisy": noisy}


def surface(field: FieldFunction, resolution: int, asked: int = 512, smooth: float = 0.0):
    rules = SearchRules(smooth=smooth)
    made = extract_isosurface(
        field, IsosurfaceConfig(resolution, asked=asked, rules=rules, newton=False)
    )
    return made, trimesh.Trimesh(made.vertices, made.faces, process=False)


@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.parametrize(("asked", "smooth"), [(64, 0.0), (512, 0.8), (128, 0.8)])
def test_interpolated_surfaces_are_closed_and_face_outwards(
    name: str, asked: int, smooth: float
) -> None:
    _, mesh = surface(FIELDS[name], 256, asked, smooth)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    assert np.abs(mesh.vertices).max() < 0.8


@pytest.mark.parametrize("seed", range(6))
def test_bounds_that_are_refuted_while_looking_for_smooth_cells_leave_no_hole(seed: int) -> None:
    rules = SearchRules(smooth=0.8)
    config = IsosurfaceConfig(128, rules=rules, newton=False, smallest_part=0)
    made = extract_isosurface(spiky(seed), config)
    assert trimesh.Trimesh(made.vertices, made.faces, process=False).is_watertight


@pytest.mark.parametrize("field", [ball, ring])
def test_where_the_field_is_smooth_interpolation_finds_its_zero(field: FieldFunction) -> None:
    """Radii of curvature of 0.12 and more on cells of 0.0125."""
    made, mesh = surface(field, 256, asked=128)
    exact, _ = surface(field, 256)
    off, of_exact = (np.abs(field(s.vertices.astype("f4"))).max() for s in (made, exact))
    assert off < of_exact + 5e-6  # marching cubes interpolates along edges too
    assert len(made.vertices) == pytest.approx(len(exact.vertices), rel=1e-3)
    assert made.queries < 0.6 * exact.queries
    assert mesh.euler_number == (2 if field is ball else 0)


def test_where_the_field_bends_it_is_asked() -> None:
    """A plate thinner than the cells of 64³ comes out as if all were asked, a ball's surface is
    hardly asked at all."""
    made, mesh = surface(plate, 128, smooth=0.8)
    exact, whole = surface(plate, 128)
    assert mesh.volume == pytest.approx(whole.volume, rel=1e-3)
    # What is known already shows most of it to bend: little is asked only to see that.
    assert 0.9 * exact.queries < made.queries < 1.05 * exact.queries
    made, exact = surface(ball, 128, smooth=0.8)[0], surface(ball, 128)[0]
    assert made.queries < 0.65 * exact.queries
    assert np.abs(ball(made.vertices.astype("f4"))).max() < 5e-5


def test_interpolation_leaves_what_was_asked_as_it_is() -> None:
    """Corners of the asked grid keep their values, whatever lies between."""
    around = RNG.normal(size=(5, 64)).astype("f4")
    block = cubic_cells(around, 4)
    grid = around.reshape(5, 4, 4, 4)[:, 1:3, 1:3, 1:3]
    assert block[:, ::4, ::4, ::4] == pytest.approx(grid, abs=1e-6)


def test_parabolas_are_interpolated_exactly_and_do_not_bend() -> None:
    curve = RNG.normal(size=(3, 3))
    slope = RNG.normal(size=3)

    def parabola(x: np.ndarray) -> np.ndarray:
        return np.einsum("...i,ij,...j->...", x, curve, x) + x @ slope + 0.3

    around = parabola(STENCIL.astype(float)).astype("f4")[None]
    axis = np.arange(6) / 5
    inside = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    assert cubic_cells(around, 5)[0] == pytest.approx(parabola(inside), abs=1e-4)
    assert bends(around) == pytest.approx(0, abs=1e-4)


def test_bends_are_seen_on_the_lines_that_are_known() -> None:
    around = (STENCIL[:, 0] ** 3).astype("f4")[None]
    assert bends(around)[0] == 6
    for missing in (0, 1, 63):  # each on one line along each axis
        some = around.copy()
        some[:, missing] = np.nan
        assert bends(some)[0] == 6
    assert bends(np.full_like(around, np.nan))[0] == 0


def test_a_kink_bends_by_its_change_of_slope() -> None:
    """|x| at −1, 0, 1 and 2: its slope changes by two."""
    kink = np.abs(STENCIL[:, 0]).astype("f4")[None]
    assert bends(kink)[0] == pytest.approx(abs(2 - 3 * 1 + 3 * 0 - 1))
    assert bends(0 * kink)[0] == 0
