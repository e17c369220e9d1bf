"""Signed distance fields as planning asks them: metres, world frame, negative inside, gradients."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Array = NDArray[np.float64]


class Field(Protocol):
    """A signed distance field of one object."""

    def __call__(self, points: Array) -> Array:
        """Values [N] in m at points [N, 3] of the world."""

    def with_gradient(self, points: Array) -> tuple[Array, Array]:
        """Values [N] and gradients [N, 3]."""


class TorchField:
    """A field from a differentiable function, as a network with its frame is.

    Args:
        function: World points [N, 3] → signed distances [N], m; differentiable in the points.
        batch: Points asked at once.
        dtype: What the function computes in.
    """

    def __init__(
        self,
        function: Callable[[Tensor], Tensor],
        batch: int = 1 << 14,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        self._function, self._batch, self._dtype = function, batch, dtype

    def __call__(self, points: Array) -> Array:
        parts = []
        with torch.no_grad():
            for piece in self._pieces(points):
                parts.append(self._function(piece).double().numpy())
        return np.concatenate(parts) if parts else np.zeros(0)

    def with_gradient(self, points: Array) -> tuple[Array, Array]:
        values, gradients = [np.zeros(0)], [np.zeros((0, 3))]
        for piece in self._pieces(points):
            piece.requires_grad_()
            with torch.enable_grad():
                value = self._function(piece)
                (gradient,) = torch.autograd.grad(value.sum(), piece)
            values.append(value.detach().double().numpy())
            gradients.append(gradient.double().numpy())
        return np.concatenate(values), np.concatenate(gradients)

    def _pieces(self, points: Array) -> list[Tensor]:
        tensor = torch.tensor(np.asarray(points), dtype=self._dtype)
        return list(tensor.split(self._batch)) if len(tensor) else []
