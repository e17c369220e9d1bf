"""Features of the reconstruction at a grasp, for the success network.

An embedding of the whole cloud blurs the contacts. These features are local: signed distances along
the paths of the pads of the closing links and in the region between them, in the palm's frame, so
that equal contacts give equal features; and the certainty and time of each pad's contact. Further
features tell of gravity and the table: heights of the links, the downward direction, size and
weight of the object.

Differences between neighbouring points contain the field's gradient. All features are
differentiable in the preshape and in the palm's pose; frame: world, z up, table top at z = 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.models.hand_mirror import hand_mirror
from pointsdf_cli.models.hand_sweep import HandSweep

FAR = 0.04
"""Distance [m] at which the hyperbolic tangent of a distance saturates."""

TOUCH, TOUCH_WIDTH = 0.004, 0.004
"""Distance [m] below which a pad touches, and width [m] of the soft transition."""

EVERY = 2
"""Stride over the moments of the closing motion whose distances are features."""

LENGTH = 0.1
"""Unit of the lengths among the features [m]."""

BODY_CELLS = 8
"""Cells along each side of the box in which the object's volume is measured."""

BODY_SIZE = 6


@dataclass(frozen=True)
class ObjectBody:
    """Properties of the object that the features need besides its field, in the world.

    Attributes:
        centre: f4 [3] or [B, 3], centre of the seen points' upright bounding box, m.
        mass_centre: f4 [3] or [B, 3], centre of the reconstructed volume, m.
        numbers: f4 [BODY_SIZE] or [B, BODY_SIZE], size features of `object_body`.
    """

    centre: Tensor
    mass_centre: Tensor
    numbers: Tensor


def object_body(points: Array, field: Callable[[Array], NDArray[np.floating]]) -> ObjectBody:
    """Size, volume and centre of one object.

    Args:
        points: [N, 3], seen points, world, m.
        field: Signed distances of its reconstruction [m] at points of the world.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    extent = high - low
    spare = 0.25 * extent.max()
    a, b = low - spare, high + spare
    a[2] = min(0.0, low[2])  # what is unseen rests on the table
    cell = (b - a) / BODY_CELLS
    axes = [a[k] + (np.arange(BODY_CELLS) + 0.5) * cell[k] for k in range(3)]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    distance = np.asarray(field(places), dtype=np.float64)
    # A soft step half a cell wide: thin bodies between the samples still count.
    inside = 1.0 / (1.0 + np.exp(np.clip(4.0 * distance / cell.mean(), -30, 30)))
    total = inside.sum()
    volume = float(total * cell.prod())
    centre = (low + high) / 2
    mass_centre = (inside @ places) / total if total > 1e-6 else centre
    level = np.sqrt(np.clip(np.linalg.eigvalsh(np.cov(points[:, :2].T)), 0, None))
    numbers = [
        np.cbrt(volume) / LENGTH,
        volume / LENGTH**3,
        high[2] / LENGTH,
        level[0] / LENGTH,
        level[1] / LENGTH,
        extent.max() / LENGTH,
    ]
    return ObjectBody(*(torch.tensor(np.array(v), dtype=torch.float32) for v in
                        (centre, mass_centre, numbers)))  # fmt: skip


class GraspFeatures:
    """Features of grasps of one object.

    Args:
        sweep: Sweep of the closing hand.
        preshape_ranges: [K, 2], ranges that scale the preshape.
    """

    def __init__(self, sweep: HandSweep, preshape_ranges: NDArray[np.floating]) -> None:
        self._sweep = sweep
        ranges = torch.tensor(np.array(preshape_ranges), dtype=torch.float32)
        self._middle, self._half = ranges.mean(1), (ranges[:, 1] - ranges[:, 0]).clamp(min=1e-3) / 2

    @property
    def size(self) -> int:
        """Number of features, F."""
        stages, (still, moving) = self._sweep.config.stages, self._sweep.sizes
        seen = len(range(0, stages, EVERY))
        on_links = seen * moving + 2 * moving + still + seen
        other = 1 + len(self._middle) + 3 + 3 + 3 + 1 + BODY_SIZE
        return on_links + len(self._sweep.region) + other

    def __call__(
        self,
        preshape: Tensor,
        T_world_palm: Tensor,
        body: ObjectBody,
        field: Callable[[Tensor], Tensor],
    ) -> Tensor:
        """Features [B, F], float32.

        Args:
            preshape: [B, K].
            T_world_palm: [B, 4, 4].
            body: The object.
            field: Its signed distances [...] m at points [..., 3] of the world, differentiable.
        """
        points = self.points(preshape, T_world_palm)
        # In the order of the memory, which the field reads fastest.
        distance = field(points.transpose(0, 1)).transpose(0, 1)
        return self.assemble(preshape, T_world_palm, body, points, distance)

    def points(self, preshape: Tensor, T_world_palm: Tensor) -> Tensor:
        """Points [B, P, 3] in the world at which the field is read: pads stage by stage, points of
        links that do not move, and the closing region."""
        return self._sweep.in_world(preshape.float(), T_world_palm.float())

    def mirrored(self) -> list[tuple[Tensor, Tensor]]:
        """For each axis across the palm's that mirrors the hand onto itself: the features of the
        mirror image of a grasp and its object are `x[:, index] * sign` with index [F], sign [F].

        A mirrored grasp succeeds as often as the grasp itself, so it is one more to learn from.
        """
        stages, (_, moving) = self._sweep.config.stages, self._sweep.sizes
        read = range(0, stages, EVERY)
        found = []
        for mirror in filter(None, (hand_mirror(self._sweep, axis) for axis in (1, 2))):
            seen = torch.cat([mirror.pads + k * moving for k in range(len(read))])
            of_links = [seen, mirror.pads, mirror.pads, mirror.still, mirror.region]
            alike = torch.arange(len(read) + 1)  # heights
            index, start = torch.arange(self.size), 0
            for block in (*of_links, alike, mirror.joints):
                index[start : start + len(block)] = start + block
                start += len(block)
            sign = torch.ones(self.size)
            sign[start : start + 9] = mirror.signs.repeat(3)  # upwards, to the centre, to the mass
            found.append((index, sign))
        return found

    def assemble(
        self,
        preshape: Tensor,
        T_world_palm: Tensor,
        body: ObjectBody,
        points: Tensor,
        distance: Tensor,
    ) -> Tensor:
        """Features [B, F] from signed distances [B, P] m at `points` [B, P, 3].

        `body` may hold one object for all grasps, or a row for each.
        """
        palm = T_world_palm.float()
        rotation, position = palm[:, :3, :3], palm[:, :3, 3]
        stages, (still, moving) = self._sweep.config.stages, self._sweep.sizes
        swept = stages * moving
        # Grasps along the last axis from here on: long rows, whatever their number.
        pads, elsewhere = distance.T.split([swept, still + len(self._sweep.region)])
        pads = pads.unflatten(0, (stages, moving))
        height = points[:, :swept, 2].T.unflatten(0, (stages, moving))
        seen = pads[::EVERY].flatten(0, 1)
        up = rotation[:, 2]
        to_centre = _turned_back(rotation, body.centre - position)
        to_mass = _turned_back(rotation, body.mass_centre - position)
        # Lever arm of the weight about the palm. The small constant keeps the root smooth.
        lever = torch.linalg.cross(up, to_mass).square().sum(1, keepdim=True)
        rows = [
            torch.tanh(seen / FAR),
            *_touching(pads),
            torch.tanh(elsewhere / FAR),
            torch.tanh(height[::EVERY].amin(1) / FAR),
            position[:, 2:].T / LENGTH,
            ((preshape.float() - self._middle) / self._half).T,
            up.T,
            to_centre.T / LENGTH,
            to_mass.T / LENGTH,
            (lever.T + 1e-8).sqrt() / LENGTH,
            body.numbers.expand(len(palm), -1).T,
        ]
        return torch.cat(rows).T


def _touching(pads: Tensor) -> tuple[Tensor, Tensor]:
    """Probability of each pad's contact while the hand closes, and its expected time, both [M, B]
    in 0 to 1.

    The distance at a stage gives the probability of contact there; the product of the complements
    is the probability of no contact so far. Its mean over all stages is the expected time.

    Args:
        pads: [S, M, B], distances m.
    """
    free = torch.sigmoid((pads - TOUCH) / TOUCH_WIDTH).cumprod(0)
    return 1.0 - free[-1], free.mean(0)


def _turned_back(rotation: Tensor, vector: Tensor) -> Tensor:
    """Product Rᵀ v of [B, 3, 3] and [B, 3]."""
    return (vector[:, None] @ rotation).squeeze(1)
