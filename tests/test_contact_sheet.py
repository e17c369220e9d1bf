"""Contact sheets: what a ball and a box look like, and how tiles are laid out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from pointsdf_cli.errors import InputError
from pointsdf_cli.viz.contact_sheet import (
    BACKGROUND,
    COLUMNS,
    SheetItem,
    draw_sheet,
    items_from_files,
    shaded_view,
    size_caption,
    write_sheet,
)


def item(mesh: trimesh.Trimesh, label: str = "thing") -> SheetItem:
    return SheetItem(np.asarray(mesh.vertices), np.asarray(mesh.faces), label)


def covered(picture: np.ndarray) -> np.ndarray:
    return (np.abs(picture.astype(int) - BACKGROUND) > 20).any(axis=-1)


def test_ball_is_a_disc_that_nearly_fills_the_tile() -> None:
    ball = trimesh.creation.icosphere(4, radius=0.05)
    mask = covered(shaded_view(ball.vertices, ball.faces, 128))
    assert mask.mean() == pytest.approx(np.pi / 4 / 1.08**2, rel=0.03)
    rows, columns = np.nonzero(mask)
    assert np.ptp(rows) == pytest.approx(np.ptp(columns), abs=2)


def test_box_from_above_shows_its_top_alone() -> None:
    box = trimesh.creation.box((0.1, 0.05, 0.2))
    picture = shaded_view(
        box.vertices, box.faces, 96, azimuth=-np.pi / 2, elevation=np.deg2rad(89.99)
    )
    rows, columns = np.nonzero(covered(picture))
    assert np.ptp(columns) / np.ptp(rows) == pytest.approx(2.0, rel=0.06)


def test_light_comes_from_above() -> None:
    ball = trimesh.creation.icosphere(4, radius=0.05)
    picture = shaded_view(ball.vertices, ball.faces, 128).mean(axis=-1)
    assert picture[30, 64] > 1.5 * picture[104, 64]


def test_inside_of_an_open_surface_is_red() -> None:
    ball = trimesh.creation.icosphere(3, radius=0.05)
    inside_out = shaded_view(ball.vertices, np.asarray(ball.faces)[:, ::-1], 64)
    assert inside_out[32, 32, 0] > 3 * inside_out[32, 32, 1]


def test_sheet_has_the_rows_it_needs(tmp_path: Path) -> None:
    box = item(trimesh.creation.box((0.1, 0.1, 0.1)))
    one, two = draw_sheet([box] * COLUMNS).size, draw_sheet([box] * (COLUMNS + 1)).size
    assert one[0] == two[0]
    assert two[1] > 1.7 * one[1]
    write_sheet(tmp_path / "sheet.png", [box] * (COLUMNS + 1))
    with Image.open(tmp_path / "sheet.png") as picture:
        assert picture.size == two


def test_files_are_labelled_by_what_they_hold(tmp_path: Path) -> None:
    for name in ("00012_spray_can", "mustard"):
        trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / f"{name}.ply")
    labels = [each.label for each in items_from_files(sorted(tmp_path.glob("*.ply")))]
    assert labels == ["spray can", "mustard"]


def test_caption_is_in_centimetres() -> None:
    assert size_caption(np.array([[0, 0, 0], [0.1, 0.055, 0.21]])) == "10.0 × 5.5 × 21.0 cm"


def test_nothing_to_draw_is_refused() -> None:
    with pytest.raises(InputError, match="no mesh"):
        draw_sheet([])
