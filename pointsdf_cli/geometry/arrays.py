"""Type aliases for arrays; shapes, units and frames stand where an alias is used."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]
Surface = tuple[Array, NDArray[np.integer]]
"""Vertices [V, 3] and faces [F, 3]."""
