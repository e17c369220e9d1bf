"""The objective of the paper's section IV: a learned score of the grasp, as one cost.

    s = −log h(q_g, o) − α log g(q_g)          cost = max(s − β, 0)²

h is the predicted probability of success, g the prior's density of the grasp configuration. The
paper prints max(β − s, 0)², which is zero for bad grasps; s is a cost: it must be max(s − β, 0)².
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.planning.variables import Variables
from pointsdf_cli.robot.kinematics import Kinematics


class GraspScore(Protocol):
    """Protocol of the success network and its prior for planning; both are differentiable.

    One score belongs to one object: it holds the object's cloud, size and frame.
    """

    def log_success(self, preshape: Tensor, T_world_palm: Tensor) -> Tensor:
        """log h [B] of preshape joints [B, K] and palm poses [B, 4, 4] in the world."""

    def log_prior(self, preshape: Tensor, T_world_palm: Tensor) -> Tensor:
        """log g [B] of preshape joints [B, K] and palm poses [B, 4, 4] in the world."""


ALPHA = 0.5
"""Weight of the prior."""
BETA = -2.0
"""The cost is zero for s below this: the grasp is good enough."""


class Cost(NamedTuple):
    """The objective at B configurations.

    Attributes:
        value: [B], max(s − β, 0)².
        residual: [B], max(s − β, 0).
        residual_gradient: [B, n], of the residual with respect to x; zero where the residual is.
        log_success: [B], log h.
        log_prior: [B], log g.
    """

    value: Array
    residual: Array
    residual_gradient: Array
    log_success: Array
    log_prior: Array

    @property
    def gradient(self) -> Array:
        """[B, n], of the value."""
        return 2 * self.residual[:, None] * self.residual_gradient


class Objective:
    """Evaluates the cost and its gradient for a batch of x at once."""

    def __init__(self, kinematics: Kinematics, variables: Variables, score: GraspScore) -> None:
        self._kinematics, self._variables, self.score = kinematics, variables, score

    def __call__(self, x: Array) -> Cost:
        """The cost of x [B, n]."""
        leaf = torch.tensor(x, requires_grad=True)
        with torch.enable_grad():
            palm = self._kinematics.palm(self._variables.configuration_tensor(leaf))
            preshape = self._variables.preshape(leaf)
            success, prior, residual = self._terms(preshape, palm)
            (gradient,) = torch.autograd.grad(residual.sum(), leaf)
        r = residual.detach().numpy()
        return Cost(r**2, r, gradient.numpy(), success.detach().numpy(), prior.detach().numpy())

    def of_palms(self, preshape: Array, T_world_palm: Array) -> Array:
        """The cost [B] of preshapes [B, K] at palm poses [B, 4, 4], independent of the arm."""
        hand, palm = torch.from_numpy(preshape), torch.from_numpy(T_world_palm)
        with torch.no_grad():
            _, _, residual = self._terms(hand, palm)
        return np.asarray(residual.square().numpy())

    def _terms(self, preshape: Tensor, T_world_palm: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """log h, log g and the residual [B]."""
        success = self.score.log_success(preshape, T_world_palm).double()
        prior = self.score.log_prior(preshape, T_world_palm).double()
        return success, prior, (-success - ALPHA * prior - BETA).clamp(min=0)
