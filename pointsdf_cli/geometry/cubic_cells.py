"""A field inside the cells of a grid, from its values at the 4³ corners around each.

The piecewise cubic of Catmull and Rom (1974), once along each axis: continuous with its slopes, and
equal to the field at every corner.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

STENCIL = np.array(list(product((-1, 0, 1, 2), repeat=3)), dtype=np.int32)
"""[64, 3]: the corners that a cell's field is made of, in cells from its lowest corner."""


def cubic_cells(around: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """The field on finer corners of cells.

    Args:
        around: [C, 64], values in the order of `STENCIL`.
        factor: Finer cells along each side of one.

    Returns:
        [C, f + 1, f + 1, f + 1].
    """
    t = np.arange(factor + 1) / factor
    weights = np.stack(
        [-t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, t**3 - t**2]
    ).astype(np.float32) / np.float32(2)
    # Cells last, so that each sum runs along memory. A matrix product is avoided: its rounding
    # depends on the row's position, so that two neighbouring cells could round a corner of their
    # common face to different signs, which would leave a hole.
    block = np.ascontiguousarray(around.reshape(-1, 64).T).reshape(4, 4, 4, -1)
    for _ in range(3):  # along the first axis, which then becomes the last of the three
        rows = [sum(weights[k, j] * block[k] for k in range(4)) for j in range(factor + 1)]
        block = np.stack(rows, axis=2)
    return np.ascontiguousarray(np.moveaxis(block, -1, 0))


def bends(around: NDArray[np.float32]) -> NDArray[np.float32]:
    """Deviation of fields from parabolas: the largest third difference [C] along any line of four
    values without NaN; zero without such a line.

    In sides of a cell: a slope that jumps by 1 gives 1 if it does so at a corner, 0 midway between
    two; an SDF with a radius of curvature of 10 gives 0.01.
    """
    block = around.reshape(-1, 4, 4, 4)
    largest = np.zeros(len(block), dtype=np.float32)
    for axis in (1, 2, 3):
        a, b, c, d = np.moveaxis(block, axis, 0)
        third = np.abs(d - a + 3 * (b - c)).reshape(len(block), 16)
        largest = np.fmax(largest, np.fmax.reduce(third, axis=1))
    return largest
