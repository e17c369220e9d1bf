"""Masses of objects: the published one of a YCB object, else an estimate from the mesh.

A scan is closed and does not tell whether it is filled. Objects that fill most of their convex hull
count as filled. Others are hollow or thin, such as a cup or a toy aeroplane, and count as plastic
shells, but never as heavier than filled ones.
"""

from __future__ import annotations

import json
from importlib import resources

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

YCB_MASSES: dict[str, float] = json.loads(
    resources.files("pointsdf_cli.simulation").joinpath("ycb_masses.json").read_text("utf-8")
)
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
