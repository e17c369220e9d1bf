"""Mirror symmetry of a hand.

A mirrored grasp of a mirrored object succeeds as often as the grasp itself. If the mirror maps the
hand onto itself, it is a grasp of the same hand: one more to learn from, without a simulation.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from pointsdf_cli.models.hand_sweep import HandSweep

SAME, SAME_AT_REST = 0.002, 0.015
"""Largest difference [m] between points of a hand and of its mirror image: samples of a surface are
not quite as symmetric as the surface. Points of links that closing does not move stand for many
centimetres."""


class HandMirror(NamedTuple):
    """For each point and joint of a hand, the number of its mirror image.

    Attributes:
        pads, still, region: [M], [P], [G], for the points of `HandSweep`.
        joints: [K], for the preshape joints.
        signs: f4 [3], −1 for the mirrored axis of the palm.
    """

    pads: Tensor
    still: Tensor
    region: Tensor
    joints: Tensor
    signs: Tensor


@torch.no_grad()
def hand_mirror(sweep: HandSweep, axis: int) -> HandMirror | None:
    """Mirror images of a hand's points and joints across an axis of the palm (0 to 2); None if the
    image is another hand."""
    signs = torch.ones(3)
    signs[axis] = -1.0
    low, high = sweep.preshapes.T
    still, paths = sweep((low + high)[None] / 2)
    pads = _images(paths[0].transpose(0, 1), signs, SAME)
    at_rest = _images(still[0], signs, SAME_AT_REST)
    region = _images(sweep.region, signs, SAME)
    if pads is None or at_rest is None or region is None:
        return None
    under = sweep.pads_under
    joints = torch.tensor([int((under == row[pads]).all(1).long().argmax()) for row in under])
    # Joints that turn the other way in the mirror show at another preshape.
    preshape = (low + (high - low) * torch.linspace(0.2, 0.7, len(low)))[None]
    image = sweep(preshape[:, joints])[1] * signs
    if (sweep(preshape)[1][:, :, pads] - image).abs().max() > SAME:
        return None
    return HandMirror(pads, at_rest, region, joints, signs)


def _images(points: Tensor, signs: Tensor, most: float) -> Tensor | None:
    """For each of `points` [N, ..., 3], the number of its mirror image [N]; None if one is farther
    than `most` [m] from all points along an axis, or two are one."""
    rows = points.flatten(1)
    difference = ((points * signs).flatten(1)[:, None] - rows).abs().amax(2)
    distance, nearest = difference.sort(1)
    same = bool((distance[:, :1] < most).all())
    found = nearest[:, :1].flatten()
    return found if same and len(found.unique()) == len(points) else None
