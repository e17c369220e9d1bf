"""What could stand and what could not, by hand; and where what holds it up may hide."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pointsdf_cli.planning.fields import MeshField
from pointsdf_cli.planning.grid import GridConfig, GridField
from pointsdf_cli.planning.support import SPACING, hidden_below, stands


def box(size: tuple[float, float, float], at: tuple[float, float, float]) -> trimesh.Trimesh:
    """A box whose lowest face is centred at `at`."""
    moved = trimesh.creation.box(size)
    moved.apply_translation((at[0], at[1], at[2] + size[2] / 2))
    return moved


TOP = box((0.2, 0.12, 0.02), (0.6, 0.0, 0.08))


def legs(*places: tuple[float, float]) -> trimesh.Trimesh:
    """The table top on thin legs at places relative to its middle."""
    parts = [box((0.006, 0.006, 0.09), (0.6 + x, y, 0.0)) for x, y in places]
    return trimesh.boolean.union([TOP, *parts], engine="manifold")


CORNERS = ((0.09, 0.05), (0.09, -0.05), (-0.09, 0.05), (-0.09, -0.05))


@pytest.mark.parametrize(
    ("mesh", "expected"),
    [
        (box((0.05, 0.05, 0.1), (0.6, 0, 0)), True),
        (box((0.05, 0.05, 0.1), (0.6, 0, 0.005)), True),  # a little off the table
        (TOP, False),
        (legs(*CORNERS), True),  # too thin for the coarse grid
        (legs((0.09, 0.05), (0.09, -0.05)), False),
        (legs((0.0, 0.0)), True),
    ],
)
def test_what_stands_has_its_centre_above_its_feet(mesh: trimesh.Trimesh, expected: bool) -> None:
    field = MeshField(mesh.vertices, mesh.faces)
    low, high = mesh.bounds[0] - 0.01, mesh.bounds[1] + 0.01
    solid = GridField(field, low, high, GridConfig(step=0.01, levels=3, band=0.0)).inside()
    kept = GridField(field, low, high, GridConfig(step=0.01, levels=3, band=0.0))
    assert stands(field, kept, solid, low, high) is expected


def plate() -> np.ndarray:
    """Places inside of the table top, 4 mm apart."""
    axes = (np.arange(0.5, 0.7, 0.004), np.arange(-0.06, 0.06, 0.004), np.arange(0.082, 0.1, 0.004))
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def test_from_above_all_below_is_hidden_and_from_the_side_nothing() -> None:
    solid = plate()
    seen = solid[solid[:, 2] > 0.097] + [0.0, 0.0, 0.002]
    above = np.array([0.6, 0.0, 1.5])
    hidden = hidden_below(solid, [(above, seen)])
    # 26 × 16 columns of 8 mm have a part of the plate above them, ten places high.
    assert len(hidden) == 26 * 16 * 10
    assert hidden[:, 2].min() == pytest.approx(SPACING / 2)
    assert hidden[:, 2].max() < 0.082
    beside = np.array([0.6, -1.5, 0.04])
    assert len(hidden_below(solid, [(beside, seen)])) == 0
    # A second view frees what it sees.
    assert len(hidden_below(solid, [(above, seen), (beside, seen)])) == 0


def test_space_is_hidden_only_well_behind_what_is_seen() -> None:
    x, y = np.arange(0.58, 0.62, 0.004), np.arange(-0.02, 0.02, 0.004)
    solid = np.stack(np.meshgrid(x, y, [0.0205], indexing="ij"), -1).reshape(-1, 3)
    x, y = np.arange(0.56, 0.64, 0.002), np.arange(-0.04, 0.04, 0.002)
    sheet = np.stack(np.meshgrid(x, y, [0.01], indexing="ij"), -1).reshape(-1, 3)
    hidden = hidden_below(solid, [(np.array([0.6, 0.0, 1.5]), sheet)])
    # Of 4, 12 and 20 mm only the first lies more than 5 mm below the sheet.
    assert sorted(set(hidden[:, 2].round(4))) == [0.004]
