"""Types of signed distance fields: metres, negative inside."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.arrays import Array

FieldFunction = Callable[[Array], NDArray[np.floating[Any]]]
"""Signed distances [N] at points [N, 3], without gradients, in the frame that its user states."""


class Field(Protocol):
    """A signed distance field of one object."""

    def __call__(self, points: Array) -> Array:
        """Values [N] in m at points [N, 3] of the world."""

    def with_gradient(self, points: Array) -> tuple[Array, Array]:
        """Values [N] and gradients [N, 3]."""
