"""A signed distance field as a dense grid in torch: many differentiable look-ups of one object.

The field is evaluated once at the nodes of a box around the object. A look-up is then a trilinear
interpolation, a few nanoseconds a point, with its exact gradient: every cell stores the eight
coefficients of its polynomial, so value and slope take one gather. Points outside the box get the
value at its nearest point: the box is wide enough that features are saturated there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from pointsdf_cli.geometry.arrays import Array

CELLS = 20_000
"""Approximate limit on the number of cells, for objects of any size; the step grows instead."""


class TensorGrid:
    """See the module's docstring.

    Args:
        field: Signed distances [N] m at points [N, 3] m.
        low, high: [3], the box, m.
        step: Desired side of a cell, m.
        cells: Approximate limit on the number of cells; along each side one more node than cells.

    Attributes:
        step: f8 [3], the sides of a cell, m.
    """

    def __init__(
        self,
        field: Callable[[Array], NDArray[np.floating]],
        low: Array,
        high: Array,
        step: float,
        cells: int = CELLS,
    ) -> None:
        wide = np.asarray(high, dtype=np.float64) - low
        step = max(step, float(np.cbrt(np.prod(wide) / cells)))
        counts = np.maximum(2, np.ceil(wide / step).astype(int) + 1)
        axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True)]
        places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        values = np.asarray(field(places), dtype=np.float64).reshape(counts)
        self.step = wide / (counts - 1)
        self._coefficients = torch.from_numpy(_polynomials(values).reshape(8, -1))
        self._cells = [int(n) - 1 for n in counts]
        self._low = [float(v) for v in low]
        self._inverse = [float(1.0 / v) for v in self.step]

    def __call__(self, points: Tensor) -> Tensor:
        """Values [...] m at points [..., 3] m, float32; fastest if the last axis is the slowest
        in memory."""
        planes = points.movedim(-1, 0)
        values: Tensor = _LookUp.apply(planes.reshape(3, -1), self)
        return values.reshape(planes.shape[1:])

    def look_up(self, planes: Tensor, with_gradient: bool) -> tuple[Tensor, Tensor | None]:
        """Values [N] m and gradients [3, N] at the coordinates [3, N] m."""
        parts, inside = [], []
        index: Tensor | None = None
        axes = zip(planes, self._low, self._inverse, self._cells, strict=True)
        for plane, low, inverse, cells in axes:
            free = (plane - low).mul_(inverse)
            place = free.clamp(0.0, cells)
            # Clamped again as a cell index: NaN has none.
            cell = place.int().clamp_(0, cells - 1)
            if with_gradient:
                inside.append(place.eq(free).float().mul_(inverse))
            parts.append(place.sub_(cell))
            index = cell if index is None else index.mul_(cells).add_(cell)
        assert index is not None
        x, y, z = parts
        c, cx, cy, cz, cxy, cxz, cyz, cxyz = self._coefficients.index_select(1, index)
        yz = y * z
        along_x = cx.addcmul_(cxy, y).addcmul_(cxz, z).addcmul_(cxyz, yz)
        value = torch.addcmul(c, along_x, x).addcmul_(cy, y).addcmul_(cz, z).addcmul_(cyz, yz)
        if not with_gradient:
            return value, None
        along_y = cy.addcmul_(cxy, x).addcmul_(cyz.addcmul_(cxyz, x), z)
        along_z = cz.addcmul_(cxz, x).addcmul_(cyz, y)
        slopes = zip((along_x, along_y, along_z), inside, strict=True)
        return value, torch.stack([slope.mul_(within) for slope, within in slopes])


class _LookUp(torch.autograd.Function):
    """Autograd function of `TensorGrid.look_up`: computes the gradient with the value."""

    @staticmethod
    def forward(ctx: Any, planes: Tensor, grid: TensorGrid) -> Tensor:
        value, gradient = grid.look_up(planes, ctx.needs_input_grad[0])
        if gradient is not None:
            ctx.save_for_backward(gradient)
        return value

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, slope: Tensor) -> tuple[Tensor, None]:
        (gradient,) = ctx.saved_tensors
        return gradient * slope, None


def _polynomials(values: Array) -> NDArray[np.float32]:
    """Coefficients [8, X, Y, Z] of 1, x, y, z, xy, xz, yz, xyz in each cell, from values at nodes.

    x, y and z run from 0 to 1 through the cell.
    """

    def differences(parts: list[Array], axis: int) -> list[Array]:
        """Each part at a cell's lower end along an axis, and its difference to the upper end."""
        lower = [np.delete(part, -1, axis) for part in parts]
        return lower + [np.diff(part, axis=axis) for part in parts]

    one, z, y, yz, x, xz, xy, xyz = differences(differences(differences([values], 2), 1), 0)
    return np.stack([one, x, y, z, xy, xz, yz, xyz]).astype(np.float32)
