"""Type aliases for arrays, whose shapes, units and frames stand where an alias is used; and arrays
of what a caller gives."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pointsdf_cli.errors import InputError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]
Surface = tuple[Array, NDArray[np.integer]]
"""Vertices [V, 3] and faces [F, 3]."""


def numbers(values: ArrayLike, where: str, allowed: str) -> Array:
    """A copy of the values as an array.

    Args:
        values: Nested lists or an array.
        where: Name of the argument, for messages.
        allowed: Description of what it may be, for messages.

    Raises:
        InputError: They are no array of numbers.
    """
    try:
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("is not an array of numbers", where=where, allowed=allowed) from error
