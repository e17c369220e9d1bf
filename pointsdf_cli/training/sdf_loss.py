"""The loss of `train-sdf`, and the measures that accompany it."""

from __future__ import annotations

import torch
from torch import Tensor

from pointsdf_cli.training.sdf_config import SdfLoss


def sdf_loss(settings: SdfLoss, predicted: Tensor, sdf: Tensor) -> Tensor:
    """Mean loss of predicted [B, Q] against sdf [B, Q], network units."""
    if settings.kind == "mse":
        return torch.nn.functional.mse_loss(predicted, sdf)
    # Twice the weight, so that a quantile of one half is the plain loss.
    below, above = 2 * (1 - settings.quantile), 2 * settings.quantile
    inside = sdf < 0
    sign = torch.nn.functional.binary_cross_entropy_with_logits(
        predicted / -settings.temperature, inside.float(), torch.where(inside, below, above)
    )
    if settings.kind == "sign":
        return settings.sign_weight * sign
    error = predicted - sdf
    error = torch.where(error > 0, below * error, -above * error)
    distance = (error / (sdf.abs() + settings.near)).mean()
    return distance + settings.sign_weight * sign


def label_iou(predicted: Tensor, sdf: Tensor) -> Tensor:
    """[B] intersection over union of the two insides, counted on the labelled points.

    Labels lie mostly near the surface, so this is harsher than a volume's IoU.
    """
    inside, truth = predicted < 0, sdf < 0
    union = (inside | truth).sum(-1).clamp(min=1)
    return (inside & truth).sum(-1) / union
