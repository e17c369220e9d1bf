"""The loss of `train-sdf`, the measures that accompany it, and both on views not trained on."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from pointsdf_cli.geometry.sdf_sampling import (
    BOX,
    NEAR_VARIANCE,
    WIDE_VARIANCE,
    SamplingConfig,
)
from pointsdf_cli.models.shape_model import ShapeModel
from pointsdf_cli.training.sdf_config import SdfLoss
from pointsdf_cli.training.sdf_data import Split, predict, read_batch
from pointsdf_cli.training.sdf_pack import Pack

AREA = 1.5
"""Typical surface of an object whose longest side is 1."""


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
    insides = settings.sign_weight * sign
    if settings.overlap_weight:
        likely = torch.sigmoid(predicted.float() / -settings.temperature)
        overlap = soft_iou(likely, inside, label_volumes(sdf))
        insides = insides + settings.overlap_weight * (1 - overlap).mean()
    if settings.kind == "sign":
        return insides
    error = predicted - sdf
    error = torch.where(error > 0, below * error, -above * error)
    distance = (error / (sdf.abs() + settings.near)).mean()
    return distance + insides


def soft_iou(likely: Tensor, inside: Tensor, volumes: Tensor) -> Tensor:
    """Intersection over union of two insides in each cloud (Rahman and Wang 2016, eq. 3 to 5).

    Args:
        likely: [B, Q], probabilities of being inside.
        inside: bool [B, Q], truth.
        volumes: [B, Q], volume that each place stands for, in any unit.

    Returns:
        [B]; 0 where nothing is inside.
    """
    both = (volumes * likely * inside).sum(-1)
    either = (volumes * (likely + inside - likely * inside)).sum(-1)
    return both / either.clamp(min=1e-6)


def label_volumes(sdf: Tensor) -> Tensor:
    """Volume that each label stands for, network units: the inverse of the density of `sample_sdf`
    at its distance [B, Q] from a flat surface of `AREA`."""
    config = SamplingConfig()
    jittered = config.wide_share * _normal_density(sdf, WIDE_VARIANCE)
    jittered = jittered + config.near_share * _normal_density(sdf, NEAR_VARIANCE)
    uniform = 1 - config.wide_share - config.near_share
    return 1 / (jittered / AREA + uniform / (2 * BOX) ** 3)


def _normal_density(x: Tensor, variance: float) -> Tensor:
    return torch.exp(-x.square() / (2 * variance)) / math.sqrt(2 * math.pi * variance)


def label_iou(predicted: Tensor, sdf: Tensor) -> Tensor:
    """[B] intersection over union of the two insides, counted on the labelled points.

    Labels lie mostly near the surface, so this is harsher than a volume's IoU.
    """
    inside, truth = predicted < 0, sdf < 0
    union = (inside | truth).sum(-1).clamp(min=1)
    return (inside & truth).sum(-1) / union


QUERIES, BATCH = 1024, 32


class Validation(NamedTuple):
    """Means over held-out objects, and over held-out views of training objects.

    Attributes:
        object_loss, object_iou: Loss and label IoU on objects never trained on.
        view_loss, view_iou: The same on other views of the training objects.
    """

    object_loss: float
    object_iou: float
    view_loss: float
    view_iou: float


@torch.no_grad()
def validate(
    pack: Pack,
    split: Split,
    model: ShapeModel,
    loss: SdfLoss,
    low_precision: torch.dtype | None,
    device: torch.device,
) -> Validation:
    """Loss and label IoU on both held-out sets, with the same queries every time."""
    numbers: list[float] = []
    for views in (split.held_out_objects, split.held_out_views):
        losses, ious = [], []
        for start in range(0, len(views), BATCH):
            chosen = views[start : start + BATCH]
            rng = np.random.default_rng([3, start])
            batch = read_batch(pack, chosen, QUERIES, rng).to(device)
            with torch.autocast(device.type, low_precision, enabled=low_precision is not None):
                predicted = predict(model, batch)
            losses += [float(sdf_loss(loss, predicted, batch.sdf))] * len(chosen)
            ious += label_iou(predicted, batch.sdf).tolist()
        numbers += [float(np.mean(each)) if each else float("nan") for each in (losses, ious)]
    return Validation(*numbers)
