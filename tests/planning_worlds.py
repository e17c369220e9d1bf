"""Small worlds with known answers that the planning tests share."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.planning.target import Target

REST = np.array([0.0] * 6 + [1.3, 0.5])
"""Preshape of the Allegro hand for side grasps."""
CAN = (0.6, 0.0, 0.12)
"""Middle of a can that stands in reach."""


class _Differences:
    """Gradients by central differences: the fields below are exact, and so is this to 1e-6."""

    def __call__(self, points: Array) -> Array:
        raise NotImplementedError

    def with_gradient(self, points: Array) -> tuple[Array, Array]:
        step = 1e-6
        shifts = np.eye(3) * step
        gradient = [(self(points + s) - self(points - s)) / (2 * step) for s in shifts]
        return self(points), np.stack(gradient, axis=1)


class SphereField(_Differences):
    """The distance to a ball."""

    def __init__(self, radius: float, centre: tuple[float, float, float] = (0, 0, 0)) -> None:
        self.radius, self.centre = radius, np.array(centre, dtype=float)

    def __call__(self, points: Array) -> Array:
        return np.linalg.norm(points - self.centre, axis=1) - self.radius

    def with_gradient(self, points: Array) -> tuple[Array, Array]:
        offset = points - self.centre
        length = np.linalg.norm(offset, axis=1)
        return length - self.radius, offset / length[:, None]


class BoxField(_Differences):
    """The distance to an upright box."""

    def __init__(
        self,
        size: tuple[float, float, float],
        centre: tuple[float, float, float] = (0, 0, 0),
    ) -> None:
        self.half, self.centre = np.array(size) / 2, np.array(centre, dtype=float)

    def __call__(self, points: Array) -> Array:
        excess = np.abs(points - self.centre) - self.half
        outside = np.linalg.norm(np.maximum(excess, 0), axis=1)
        return outside + np.minimum(excess.max(axis=1), 0)


class CylinderField(_Differences):
    """The distance to an upright cylinder."""

    def __init__(
        self, radius: float, height: float, centre: tuple[float, float, float] = (0, 0, 0)
    ) -> None:
        self.radius, self.half, self.centre = radius, height / 2, np.array(centre, dtype=float)

    def __call__(self, points: Array) -> Array:
        offset = points - self.centre
        excess = np.stack(
            [
                np.linalg.norm(offset[:, :2], axis=1) - self.radius,
                np.abs(offset[:, 2]) - self.half,
            ],
            axis=1,
        )
        return np.linalg.norm(np.maximum(excess, 0), axis=1) + np.minimum(excess.max(axis=1), 0)


class NearPalm:
    """A score with a known optimum: the palm at one place, its x axis along one direction.

    log h = −(‖p − place‖ / width)² − (1 − x · direction) − …, log g of the preshape about `rest`.
    """

    def __init__(
        self,
        place: tuple[float, float, float],
        direction: tuple[float, float, float],
        rest: Array,
        width: float = 0.05,
    ) -> None:
        self.place = torch.tensor(place, dtype=torch.float64)
        self.direction = torch.tensor(direction, dtype=torch.float64)
        self.rest, self.width = torch.tensor(rest), width

    def log_success(self, preshape: Tensor, T_world_palm: Tensor) -> Tensor:
        way = (T_world_palm[:, :3, 3] - self.place).square().sum(dim=1)
        turn = 1 - T_world_palm[:, :3, 0] @ self.direction
        return -way / self.width**2 - turn

    def log_prior(self, preshape: Tensor, T_world_palm: Tensor) -> Tensor:
        # Fingers level: the z axis of the palm has no height.
        level = T_world_palm[:, 2, 2].square()
        return 1.0 - (preshape - self.rest).square().sum(dim=1) - level


class AroundObject:
    """Side grasps of an upright thing: palms about its axis, facing it, thumb up or fingers down.

    Implements the prior's protocol with draws that a hand can work out.
    """

    def __init__(
        self, centre: tuple[float, float, float], distance: float, rest: Array, spread: float = 0.6
    ) -> None:
        self.centre, self.distance = np.array(centre), distance
        self.rest, self.spread = rest, spread

    def sample(self, kind: str, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        angle = rng.uniform(-self.spread, self.spread, count)
        palm = np.tile(np.eye(4), (count, 1, 1))
        if kind == "side":
            x = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
            y = np.tile([0.0, 0.0, 1.0], (count, 1))
            z = np.cross(x, y)
        else:
            x = np.tile([0.0, 0.0, -1.0], (count, 1))
            z = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
            y = np.cross(z, x)
        palm[:, :3, :3] = np.stack([x, y, z], axis=2)
        palm[:, :3, 3] = self.centre - self.distance * x
        palm[:, :3, 3] += rng.normal(0, 0.01, (count, 3))
        preshape = self.rest + rng.normal(0, 0.05, (count, len(self.rest)))
        return preshape, palm


def can_target(at: tuple[float, float, float] = CAN) -> Target:
    """A can of 7 x 24 cm whose best palm is 9 cm in front of its axis."""
    place = (at[0] - 0.09, at[1], at[2])
    return Target(
        CylinderField(0.035, 0.24, at),
        np.array(at) - 0.15,
        np.array(at) + 0.15,
        NearPalm(place, (1.0, 0.0, 0.0), REST, width=0.08),
        AroundObject(at, 0.09, REST),
    )
