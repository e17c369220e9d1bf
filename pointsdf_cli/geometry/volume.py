"""Volume inside of a closed surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def enclosed_volume(vertices: ArrayLike, faces: NDArray[np.integer]) -> float:
    """The volume that a closed surface encloses (divergence theorem), negative if its faces look
    inwards.

    Args:
        vertices: [V, 3].
        faces: [F, 3], counter-clockwise seen from outside.
    """
    places = np.asarray(vertices, dtype=np.float64)
    a, b, c = (places - places.mean(axis=0))[faces].swapaxes(0, 1)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)
