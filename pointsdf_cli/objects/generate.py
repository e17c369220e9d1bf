"""Generation of object number i of a seed: family, parameters, mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pointsdf_cli.errors import InputError
from pointsdf_cli.objects.families import choose_families
from pointsdf_cli.objects.family import Draw, Family, Value
from pointsdf_cli.objects.finish import (
    UnusableShape,
    fit_size,
    limit_faces,
    stand,
    to_arrays,
    uneven,
)

# Draws that make no valid solid are rare (1 in 124); so many in a row are a bug.
MOST_ATTEMPTS = 20
GENERATOR_VERSION = 1
"""Version of the generator; increases when any object of a given seed and index changes."""

GOLDEN_RATIO = (5**0.5 - 1) / 2


@dataclass(frozen=True)
class GeneratedObject:
    """A procedural object.

    Attributes:
        name: `NNNNN_family`, the index with at least five digits; also the file's stem.
        family: A key of `families.FAMILIES`.
        vertices: [V, 3] float32 m, +z up, lowest point at z = 0, box centred on the z axis.
        faces: [F, 3] int32, counter-clockwise seen from outside; one closed surface.
        parameters: Every named draw: lengths in metres, angles in radians, ratios without unit.
    """

    name: str
    family: str
    vertices: np.ndarray
    faces: np.ndarray
    parameters: dict[str, Value]


def make_object(seed: int, index: int, families: Sequence[str] | None = None) -> GeneratedObject:
    """Make object `index` of the endless series of a seed.

    It depends only on the arguments, not on the number or order of the objects.

    Args:
        seed: 0 or more.
        index: 0 or more.
        families: Names to choose from with their relative weights; None for all.

    Raises:
        InputError: The seed or index is negative, or a family is unknown.
    """
    if index < 0:
        raise InputError(f"the index is {index}", where="index", allowed="0 or more")
    family = family_of(seed, index, choose_families(families))
    for attempt in range(MOST_ATTEMPTS):
        draw = Draw(np.random.default_rng([seed, index, attempt]))
        try:
            vertices, faces = build(family, draw)
        except UnusableShape:
            continue
        name = f"{index:05d}_{family.name}"
        return GeneratedObject(name, family.name, vertices, faces, draw.values)
    raise RuntimeError(f"{family.name}: {MOST_ATTEMPTS} draws in a row made no valid solid")


def build(family: Family, draw: Draw) -> tuple[np.ndarray, np.ndarray]:
    """One member of a family: vertices [V, 3] float32 m and faces [F, 3] int32.

    Raises:
        UnusableShape: The parameters drawn do not make a valid solid.
    """
    solid = fit_size(family.build(draw))
    solid = fit_size(uneven(solid, draw, family.unevenness))
    solid = limit_faces(solid)
    if family.genus is not None and solid.genus() != family.genus:
        raise UnusableShape(f"genus {solid.genus()}, not {family.genus}")
    return to_arrays(stand(solid))


def family_of(seed: int, index: int, choices: Sequence[Family]) -> Family:
    """Family of object `index`, by golden-ratio steps through the table of weights.

    Any range of indices then has the families nearly in proportion to their weights; independent
    draws would have so only on average.

    Raises:
        InputError: The seed is negative.
    """
    if seed < 0:
        raise InputError(f"the seed is {seed}", where="--seed", allowed="0 or more")
    start = np.random.default_rng(seed).random()
    place = (start + index * GOLDEN_RATIO) % 1.0
    edges = np.cumsum([family.weight for family in choices])
    return choices[int(np.searchsorted(edges / edges[-1], place, side="right"))]
