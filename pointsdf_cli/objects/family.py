"""Definition of a family of objects, and the named random draws of its parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
from manifold3d import Manifold

Option = TypeVar("Option", str, int, float)
Value = float | int | str | bool


class Draw:
    """Draws named parameters from a random generator and remembers every one of them.

    Lengths are in metres, angles in radians. Floats are rounded to a millionth as they are drawn,
    so that the recorded number is the number used.

    Args:
        rng: Random generator. `Draw.rng` is open to shapes that need bulk noise, which is not
            recorded.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.values: dict[str, Value] = {}

    def uniform(self, name: str, low: float, high: float) -> float:
        """A number in [low, high)."""
        return self._record(name, float(round(self.rng.uniform(low, high), 6)))

    def log_uniform(self, name: str, low: float, high: float) -> float:
        """A number in [low, high), every ratio equally likely: for lengths that span a decade."""
        return self._record(name, float(round(np.exp(self.rng.uniform(*np.log([low, high]))), 6)))

    def integer(self, name: str, low: int, high: int) -> int:
        """A whole number in [low, high], both ends included."""
        return self._record(name, int(self.rng.integers(low, high + 1)))

    def choice(self, name: str, options: Sequence[Option]) -> Option:
        """Random choice among equally likely options."""
        return self._record(name, options[int(self.rng.integers(len(options)))])

    def chance(self, name: str, probability: float) -> bool:
        """True with the given probability."""
        return self._record(name, bool(self.rng.random() < probability))

    def _record(self, name, value):  # type: ignore[no-untyped-def]
        if name in self.values:
            raise ValueError(f"parameter {name!r} drawn twice")
        self.values[name] = value
        return value


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
