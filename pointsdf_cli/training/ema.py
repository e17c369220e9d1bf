"""An exponential moving average of a model's weights, which validates better than the last ones."""

from __future__ import annotations

import copy
from typing import Generic, TypeVar

import torch
from torch import Tensor, nn

Model = TypeVar("Model", bound=nn.Module)


class WeightAverage(Generic[Model]):
    """Average of the weights over about 1 / (1 − decay) steps; shorter in the beginning.

    Buffers (running statistics of batch norm) are averages already and are copied.
    """

    def __init__(self, model: Model, decay: float, every: int = 4) -> None:
        self.decay, self.every = decay, every if decay else 1
        self.model: Model = copy.deepcopy(model).requires_grad_(False).eval()

    @torch.no_grad()
    def update(self, model: nn.Module, step: int) -> None:
        """Add the weights after `step` (only every few steps: it costs as much as a step of
        Adam)."""
        if step % self.every:
            return
        decay = min(self.decay**self.every, (step + 1.0) / (step + 20.0)) if self.decay else 0.0
        torch._foreach_lerp_(list(self.model.parameters()), list(model.parameters()), 1.0 - decay)
        for mine, theirs in zip(self.model.buffers(), model.buffers(), strict=True):
            mine.copy_(theirs)

    def weights(self) -> dict[str, Tensor]:
        """The averaged weights by name, also the state for `load`."""
        return dict(self.model.state_dict())

    def load(self, state: dict[str, Tensor]) -> None:
        """Continue from `weights`."""
        self.model.load_state_dict(state)
