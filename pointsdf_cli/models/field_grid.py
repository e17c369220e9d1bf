"""A signed distance field as a dense grid in torch: many differentiable look-ups of one object.

The field is asked once at the nodes of a box around the object. After that a look-up is a trilinear
interpolation (`grid_sample`), a few nanoseconds a point, and autograd gives its exact gradient.
Points outside of the box get the value at the box's nearest point: the box is made wide enough that
this only happens where features have saturated.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Array = NDArray[np.float64]

NODES = 20_000
"""Nodes at most, whatever the object's size; the step grows instead."""


class FieldGrid:
    """See the module's docstring.

    Args:
        field: Signed distances [N] m at points [N, 3] m.
        low, high: [3], the box, m.
        step: Wanted side of a cell, m.
        nodes: At most so many nodes.

    Attributes:
        step: f8 [3], the sides of a cell, m.
    """

    def __init__(
        self,
        field: Callable[[Array], NDArray[np.floating]],
        low: Array,
        high: Array,
        step: float,
        nodes: int = NODES,
    ) -> None:
        wide = np.asarray(high, dtype=np.float64) - low
        step = max(step, float(np.cbrt(np.prod(wide) / nodes)))
        counts = np.maximum(2, np.ceil(wide / step).astype(int) + 1)
        axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True)]
        places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        values = np.asarray(field(places), dtype=np.float32).reshape(counts)
        self.step = wide / (counts - 1)
        # grid_sample reads the last axis first.
        self._values = torch.from_numpy(values.transpose(2, 1, 0).copy())[None, None]
        self._centre = torch.tensor((np.asarray(low) + high) / 2, dtype=torch.float32)
        self._scale = torch.tensor(2.0 / wide, dtype=torch.float32)

    def __call__(self, points: Tensor) -> Tensor:
        """Values [...] m at points [..., 3] m, float32."""
        place = ((points - self._centre) * self._scale).reshape(1, -1, 1, 1, 3)
        values = torch.nn.functional.grid_sample(
            self._values, place, padding_mode="border", align_corners=True
        )
        return values.reshape(points.shape[:-1])
