"""Quality of a network on views it was not trained on: of known objects, and of new ones."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from pointsdf_cli.models.shape_model import ShapeModel
from pointsdf_cli.training.sdf_config import SdfLoss
from pointsdf_cli.training.sdf_data import Split, predict, read_batch
from pointsdf_cli.training.sdf_loss import label_iou, sdf_loss
from pointsdf_cli.training.sdf_pack import Pack

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
