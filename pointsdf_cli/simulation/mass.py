"""Masses of objects: the published one of a YCB object, else an estimate from the mesh.

A scan is closed and does not tell whether it is filled. Objects that fill most of their convex hull
count as filled. Others are hollow or thin, such as a cup or a toy aeroplane, and count as plastic
shells, but never as heavier than filled ones.
"""

from __future__ import annotations

import numpy as np
import trimesh

DENSITY = 400.0
"""Mean density of a filled object [kg/m³]: between a full bottle and a toy."""
LIGHTEST, HEAVIEST = 0.05, 0.6
"""Bounds of the estimate [kg]; published masses are not bounded."""
FULLNESS = 0.5
"""Share of the convex hull below which a mesh is hollow or thin."""
WALL = 0.002
"""Thickness of a shell [m]."""
WALL_DENSITY = 1100.0
"""Density of a shell [kg/m³]: plastics have 900 to 1400."""

YCB_MASSES = {
    "001_chips_can": 0.205,
    "002_master_chef_can": 0.414,
    "003_cracker_box": 0.411,
    "004_sugar_box": 0.514,
    "005_tomato_soup_can": 0.349,
    "006_mustard_bottle": 0.603,
    "007_tuna_fish_can": 0.171,
    "008_pudding_box": 0.187,
    "009_gelatin_box": 0.097,
    "010_potted_meat_can": 0.370,
    "011_banana": 0.066,
    "012_strawberry": 0.018,
    "013_apple": 0.068,
    "014_lemon": 0.029,
    "015_peach": 0.033,
    "016_pear": 0.049,
    "017_orange": 0.047,
    "018_plum": 0.025,
    "019_pitcher_base": 0.178,
    "021_bleach_cleanser": 1.131,
    "022_windex_bottle": 1.022,
    "024_bowl": 0.147,
    "025_mug": 0.118,
    "026_sponge": 0.0062,
    "028_skillet_lid": 0.652,
    "029_plate": 0.279,
    "030_fork": 0.034,
    "032_knife": 0.031,
    "033_spatula": 0.0515,
    "035_power_drill": 0.895,
    "036_wood_block": 0.729,
    "037_scissors": 0.082,
    "040_large_marker": 0.0158,
    "042_adjustable_wrench": 0.252,
    "043_phillips_screwdriver": 0.097,
    "044_flat_screwdriver": 0.0984,
    "048_hammer": 0.665,
    "050_medium_clamp": 0.059,
    "051_large_clamp": 0.125,
    "052_extra_large_clamp": 0.202,
    "053_mini_soccer_ball": 0.123,
    "054_softball": 0.191,
    "056_tennis_ball": 0.058,
    "057_racquetball": 0.041,
    "058_golf_ball": 0.046,
    "061_foam_brick": 0.028,
    "062_dice": 0.0052,
    "071_nine_hole_peg_test": 1.435,
    "077_rubiks_cube": 0.094,
}
"""Masses [kg] of YCB objects, as bought (Calli et al. 2015, table of the objects).

Left out: objects weighed only as a set (aeroplanes 072, bricks 073), and objects on which copies of
the table differ (031, 038, 055, 059, 063, 065, 070, 076).
"""


def mass_of(name: str, solid: trimesh.Trimesh) -> float:
    """Mass [kg] of an object: published for YCB names, else estimated from the closed mesh.

    Args:
        name: Name of the mesh, with or without folders.
        solid: The mesh, closed and facing outwards [m].
    """
    known = YCB_MASSES.get(name.rpartition("/")[2])
    if known is not None:
        return known
    mass = unbounded_mass(float(solid.volume), float(solid.area), float(solid.convex_hull.volume))
    return float(np.clip(mass, LIGHTEST, HEAVIEST))


def unbounded_mass(volume: float, area: float, hull_volume: float) -> float:
    """Estimated mass [kg], without bounds, of a closed surface by its volume [m³], area [m²] and
    convex hull's volume [m³]."""
    mass = DENSITY * volume
    if volume < FULLNESS * hull_volume:
        mass = min(mass, WALL_DENSITY * WALL * area)
    return mass
