"""Masses: filled things by volume, shells by surface, YCB objects by what was published."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pointsdf_cli.objects.ycb_names import YCB_OBJECTS
from pointsdf_cli.simulation.mass import YCB_MASSES, mass_of, unbounded_mass


def unbounded(solid: trimesh.Trimesh) -> float:
    return unbounded_mass(solid.volume, solid.area, solid.convex_hull.volume)


def hollow_box(outer: float, wall: float) -> trimesh.Trimesh:
    """A closed cubic box with walls of one thickness around a cavity."""
    cavity = trimesh.creation.box([outer - 2 * wall] * 3)
    cavity.invert()
    return trimesh.util.concatenate([trimesh.creation.box([outer] * 3), cavity])


def cup(radius: float, height: float, wall: float) -> trimesh.Trimesh:
    """An open cup: a cylinder's wall and floor."""
    profile = [(0, 0), (radius, 0), (radius, height), (radius - wall, height),
               (radius - wall, wall), (0, wall)]  # fmt: skip
    return trimesh.creation.revolve(np.array(profile, dtype=float), sections=256)


def winged(span: float, thickness: float) -> trimesh.Trimesh:
    """A cross of two boards, as thin as a toy's wings."""
    boards = [trimesh.creation.box(s) for s in ([span, thickness, thickness * 2],
                                                [thickness, span, thickness * 2])]  # fmt: skip
    return trimesh.boolean.union(boards, engine="manifold")


def test_a_filled_cube_weighs_by_its_volume() -> None:
    cube = trimesh.creation.box([0.08] * 3)
    assert mass_of("cube", cube) == pytest.approx(400 * 0.08**3)


def test_a_box_with_a_cavity_weighs_by_its_walls() -> None:
    """Walls of 4 mm: 400 kg/m³ of them are less than plastic of 2 mm on both sides."""
    walls = 0.1**3 - 0.092**3
    box = hollow_box(0.1, 0.004)
    assert box.volume == pytest.approx(walls)
    assert mass_of("box", box) == pytest.approx(400 * walls)


def test_a_cross_of_boards_weighs_as_a_plastic_shell() -> None:
    """Thick boards that fill a third of their hull are a toy, not a solid."""
    span, t = 0.3, 0.04
    cross = winged(span, t)
    volume = 2 * t * (2 * span * t - t * t)
    area = 2 * (2 * span * t - t * t) + 2 * t * 4 * span
    assert cross.volume == pytest.approx(volume)
    assert cross.area == pytest.approx(area)
    assert unbounded(cross) == pytest.approx(1100 * 0.002 * area)
    assert 1100 * 0.002 * area < 400 * volume


def test_a_thin_cup_never_weighs_more_than_its_filled_walls() -> None:
    radius, height, wall = 0.04, 0.1, 0.002
    walls = np.pi * (radius**2 * height - (radius - wall) ** 2 * (height - wall))
    thin = cup(radius, height, wall)
    assert thin.volume == pytest.approx(walls, rel=1e-3)
    assert unbounded(thin) == pytest.approx(400 * walls, rel=1e-3)
    # The estimate of something so light is not believed.
    assert mass_of("cup", thin) == 0.05


def test_no_estimate_is_heavier_than_a_household_thing() -> None:
    assert mass_of("crate", trimesh.creation.box([0.3] * 3)) == 0.6


def test_a_ycb_object_has_its_published_mass_under_any_folder() -> None:
    """The bleach cleanser is heavier, and the sponge lighter, than any estimate."""
    cube = trimesh.creation.box([0.08] * 3)
    assert mass_of("021_bleach_cleanser", cube) == 1.131
    assert mass_of("ycb/026_sponge", cube) == 0.0062
    assert mass_of("my_021_bleach_cleanser", cube) == pytest.approx(400 * 0.08**3)


def test_published_masses_are_of_single_ycb_objects() -> None:
    assert set(YCB_MASSES) <= set(YCB_OBJECTS)
    assert not [name for name in YCB_MASSES if name.startswith(("063", "072", "073"))]
