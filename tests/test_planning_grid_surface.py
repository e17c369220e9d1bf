"""Surface of a field on a grid: true, closed, and cheap."""

from __future__ import annotations

import numpy as np
import trimesh
from planning_worlds import BoxField, SphereField

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.planning.grid import GridConfig, GridField, grid_surface

LOW, HIGH = np.full(3, -0.1), np.full(3, 0.1)
COARSE = GridConfig(step=0.01, levels=3, band=0.0)


def body(field: object) -> trimesh.Trimesh:
    surface = grid_surface(GridField(field, LOW, HIGH, COARSE), field)
    assert surface is not None
    return trimesh.Trimesh(*surface, process=False)


def test_a_sphere_is_closed_and_true_to_a_tenth_of_a_millimetre() -> None:
    field = SphereField(0.05)
    made = body(field)
    assert made.is_watertight
    assert made.is_winding_consistent
    # A chord of half a cell, 5 mm, of this sphere lies 0.06 mm below it.
    assert np.abs(field(np.asarray(made.vertices))).max() < 1e-4
    np.testing.assert_allclose(made.volume, 4 / 3 * np.pi * 0.05**3, rtol=0.01)


def test_a_sheet_thinner_than_the_cells_is_found() -> None:
    # 8 mm thick, between nodes 10 mm apart that it does not reach.
    field = BoxField((0.12, 0.12, 0.008), (0.0, 0.0, 0.005))
    made = body(field)
    assert made.is_watertight
    np.testing.assert_allclose(made.extents[:2], 0.12, atol=0.003)


def test_a_body_that_leaves_the_box_is_closed_at_its_sides() -> None:
    made = body(BoxField((0.05, 0.05, 0.4)))
    assert made.is_watertight
    np.testing.assert_allclose(made.bounds[:, 2], [-0.1, 0.1], atol=0.006)


def test_the_field_is_asked_near_its_surface_alone() -> None:
    field, asked = SphereField(0.05), []

    def noted(points: Array) -> Array:
        asked.append(points)
        return field(points)

    grid = GridField(field, LOW, HIGH, COARSE)
    before = grid.queries
    grid_surface(grid, noted)
    (places,) = asked
    assert grid.queries - before == len(places)
    assert np.abs(field(places)).max() < 0.006


def test_there_is_no_surface_where_nothing_is_inside() -> None:
    field = SphereField(0.05, (1.0, 0.0, 0.0))
    assert grid_surface(GridField(field, LOW, HIGH, COARSE), field) is None
