"""Definition of a family of objects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from manifold3d import Manifold

from pointsdf_cli.objects.draw import Draw

Kind = Literal["solid", "round", "vessel", "flat", "tool", "toy", "compound"]


@dataclass(frozen=True)
class Family:
    """A kind of household object, made by drawing parameters.

    Attributes:
        name: Name in files and for `--families`.
        build: Function that draws the parameters and returns the closed solid in metres, +z up,
            standing or lying as on a table, at any place.
        weight: Relative frequency of the family.
        kind: Kind of shape, for the balance of the mix.
        unevenness: Largest displacement of the surface by its smooth irregularities, as a fraction
            of the object's largest extent: fruit is uneven, steel is not.
        genus: Number of through holes of every member; None if it varies.
    """

    name: str
    build: Callable[[Draw], Manifold]
    weight: float
    kind: Kind
    unevenness: float = 0.004
    genus: int | None = None
