"""The loss of `train-sdf`, and the measures that accompany it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pointsdf_cli.errors import InputError

KINDS = ("mse", "relative", "sign")


@dataclass(frozen=True)
class SdfLoss:
    """The error of predicted distances.

    `mse` is the paper's loss. `relative` is

        |p − s| / (|s| + near)  +  sign_weight · BCE(−p / temperature, [s < 0])

    whose first part asks for the same relative accuracy at every distance, and whose second asks
    for the right *sign*: a squared error does not care where the zero is, but that is the shape.
    `sign` is that second part alone: occupancy, for VoxelCNN.

    Where a view leaves the surface uncertain, a symmetric loss predicts the median distance. A thin
    wall of uncertain position then vanishes: no place is inside with a probability above 1/2.
    `quantile` q < 0.5 weighs false-outside errors by (1 − q) / q over false-inside errors, so that
    the surface lies where the probability of being inside is q: unseen walls stay, and planning
    errs towards keeping away.

    Attributes:
        kind: `mse`, `relative` or `sign`.
        near: Distance under which the relative error becomes absolute, network units.
        sign_weight: Weight of the sign's cross-entropy.
        temperature: Distance at which a sign counts as certain, network units.
        quantile: Quantile of the distance that is predicted, and chance of being inside at the
            surface.
    """

    kind: str = "relative"
    near: float = 0.05
    sign_weight: float = 0.1
    temperature: float = 0.02
    quantile: float = 0.5

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"no loss {self.kind!r}", where="loss", allowed=", ".join(KINDS))
        scales = self.near > 0 and self.temperature > 0 and self.sign_weight >= 0
        if not scales or not max(self.near, self.temperature, self.sign_weight) < torch.inf:
            raise InputError("a scale of the loss is not positive and finite", where="loss")
        if not 0 < self.quantile < 1:
            raise InputError(f"a quantile of {self.quantile}", where="loss", allowed="0 to 1")

    def __call__(self, predicted: Tensor, sdf: Tensor) -> Tensor:
        """Mean over everything of predicted [B, Q] against sdf [B, Q], network units."""
        if self.kind == "mse":
            return torch.nn.functional.mse_loss(predicted, sdf)
        # Twice the weight, so that a quantile of one half is the plain loss.
        below, above = 2 * (1 - self.quantile), 2 * self.quantile
        inside = sdf < 0
        sign = torch.nn.functional.binary_cross_entropy_with_logits(
            predicted / -self.temperature, inside.float(), torch.where(inside, below, above)
        )
        if self.kind == "sign":
            return self.sign_weight * sign
        error = predicted - sdf
        error = torch.where(error > 0, below * error, -above * error)
        distance = (error / (sdf.abs() + self.near)).mean()
        return distance + self.sign_weight * sign


def label_iou(predicted: Tensor, sdf: Tensor) -> Tensor:
    """[B] intersection over union of the two insides, counted on the labelled points.

    Labels lie mostly near the surface, so this is harsher than a volume's IoU.
    """
    inside, truth = predicted < 0, sdf < 0
    union = (inside | truth).sum(-1).clamp(min=1)
    return (inside & truth).sum(-1) / union
