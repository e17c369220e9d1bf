"""The prior g(q_g; ψ) over grasp configurations (paper section IV): a mixture of two Gaussians.

One component for side grasps and one for top grasps, as published. The training data names the
kind, so the components are fitted directly, without EM, and each has a chart of its own about its
mean rotation. Coordinates of a grasp:

    y = [ (Rᵀ (c − t) − (b, 0, 0)) / ℓ ,  log(R̄ₖᵀ A⁻¹ R) ,  (preshape − middle) / width ]

(t, R) is the palm in the world, c the centre of the seen points' upright box, b the extent of that
box from c along the palm's x, ℓ = 0.1 m, A the rotation about the vertical from the world to the
direction robot → object, R̄ₖ the component's mean rotation; middle and width are those of the
preshapes' ranges. The camera's place and the object's yaw enter only through the box: the same
prior serves any view.

The density is exact with respect to dt / ℓ³ · dR · d(preshape / width), dR the invariant volume of
rotations. (A shift by b and a rotation by R have unit Jacobian; the Jacobian of the rotation's
chart is in `rotations.py`.) With these units a uniform preshape contributes nothing for any hand.
Offsets are lengths, not shares of the object's size: the hand determines them, and held-out grasps
are likelier so (docs/notebook.md).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pointsdf_cli.choices import GRASP_KINDS
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.models.rotations import log_volume, rotation_of, rotation_vector

TENSORS = ("weights", "rotations", "means", "choleskys", "ranges")
"""Arguments of `GraspPrior`, in order, as a checkpoint names them."""
LENGTH = 0.1
"""Unit of length ℓ [m]."""
NARROW = 0.01
"""Least width of a preshape range [rad or m]: narrower ranges would dominate the density's
curvature."""


@dataclass(frozen=True)
class ObjectPlace:
    """Pose and size of one object, for the prior.

    Attributes:
        centre: f8 [3], centre of the seen points' upright box in the world, m.
        extent: f8 [3], sides of that box, m.
        azimuth: Direction from the robot's base to the centre, about the vertical [rad].
    """

    centre: Tensor
    extent: Tensor
    azimuth: float

    @classmethod
    def of(cls, points: Array, base: Array) -> ObjectPlace:
        """Measure seen points [N, 3], given the robot's base [3], both in the world."""
        low, high = points.min(axis=0), points.max(axis=0)
        centre = (low + high) / 2
        azimuth = math.atan2(centre[1] - base[1], centre[0] - base[0])
        return cls(torch.tensor(centre), torch.tensor(high - low), azimuth)

    def heading(self) -> Tensor:
        """Rotation A, f8 [3, 3]."""
        c, s = math.cos(self.azimuth), math.sin(self.azimuth)
        return torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)

    def reach(self, rotation: Tensor) -> Tensor:
        """Extent b [B]: half the box's along the palm's x, for palm rotations [B, 3, 3]."""
        return (rotation[:, :, 0].abs() @ self.extent) / 2


class GraspPrior:
    """The mixture, in float64.

    Args:
        weights: [2], shares of side and top grasps; zero for a kind that was not seen.
        rotations: [2, 3, 3], R̄ₖ.
        means: [2, D] with D = 6 + K.
        choleskys: [2, D, D], lower triangular factors of the covariances.
        ranges: [K, 2], ranges of the preshape joints, to which samples are clipped.
    """

    def __init__(
        self, weights: Tensor, rotations: Tensor, means: Tensor, choleskys: Tensor, ranges: Tensor
    ) -> None:
        self.weights, self.rotations, self.means, self.choleskys, self.ranges = (
            tensor.double() for tensor in (weights, rotations, means, choleskys, ranges)
        )
        self._middle = self.ranges.mean(1)
        self._width = (self.ranges[:, 1] - self.ranges[:, 0]).clamp(min=NARROW)

    def coordinates(
        self, kind: int, preshape: Tensor, T_world_palm: Tensor, place: ObjectPlace
    ) -> Tensor:
        """Coordinates y [B, D] in the chart of component `kind`."""
        rotation, position = T_world_palm[:, :3, :3].double(), T_world_palm[:, :3, 3].double()
        offset = ((place.centre - position)[:, None] @ rotation).squeeze(1)
        offset = offset - torch.nn.functional.pad(place.reach(rotation)[:, None], (0, 2))
        turn = (place.heading() @ self.rotations[kind]).T @ rotation
        joints = (preshape.double() - self._middle) / self._width
        return torch.cat([offset / LENGTH, rotation_vector(turn), joints], dim=1)

    def log_density(self, preshape: Tensor, T_world_palm: Tensor, place: ObjectPlace) -> Tensor:
        """log g [B]; differentiable in both.

        Args:
            preshape: [B, K] rad.
            T_world_palm: [B, 4, 4].
            place: The object.
        """
        parts = []
        for kind in range(len(GRASP_KINDS)):
            if self.weights[kind] <= 0:
                continue
            y = self.coordinates(kind, preshape, T_world_palm, place)
            factor = self.choleskys[kind]
            white = torch.linalg.solve_triangular(factor, (y - self.means[kind]).T, upper=False)
            normal = -0.5 * (white**2).sum(0) - factor.diagonal().log().sum()
            normal = normal - 0.5 * y.shape[1] * math.log(2 * math.pi)
            parts.append(self.weights[kind].log() + normal - log_volume(y[:, 3:6]))
        return torch.logsumexp(torch.stack(parts), dim=0)

    def sample(
        self, kind: str, count: int, place: ObjectPlace, rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """Preshapes [N, K], within their ranges, and palms T_world_palm [N, 4, 4] of one component.

        N is `count`, or 0 for a kind that was not seen in training.

        Raises:
            InputError: `kind` is neither "side" nor "top".
        """
        if kind not in GRASP_KINDS:
            raise InputError(f"no kind of grasp {kind!r}", allowed=", ".join(GRASP_KINDS))
        k = GRASP_KINDS.index(kind)
        if self.weights[k] <= 0:
            count = 0
        noise = torch.from_numpy(rng.standard_normal((count, self.means.shape[1])))
        y = self.means[k] + noise @ self.choleskys[k].T
        turn = y[:, 3:6]
        # The chart ends at π: a longer rotation vector means a rotation the other way round.
        angle = turn.norm(dim=1, keepdim=True)
        turn = turn * (angle.clamp(max=math.pi - 1e-6) / angle.clamp(min=1e-12))
        rotation = place.heading() @ self.rotations[k] @ rotation_of(turn)
        offset = y[:, :3] * LENGTH
        offset = offset + torch.nn.functional.pad(place.reach(rotation)[:, None], (0, 2))
        palm = torch.eye(4, dtype=torch.float64).repeat(count, 1, 1)
        palm[:, :3, :3] = rotation
        palm[:, :3, 3] = place.centre - (rotation @ offset[:, :, None]).squeeze(-1)
        preshape = (self._middle + y[:, 6:] * self._width).clamp(*self.ranges.T)
        return preshape.numpy(), palm.numpy()

    def state(self) -> dict[str, Tensor]:
        """Tensors by name, for `from_state`."""
        return {f"prior.{name}": getattr(self, name) for name in TENSORS}

    @classmethod
    def from_state(cls, state: Mapping[str, Tensor]) -> GraspPrior:
        """Rebuild the prior from the tensors of a checkpoint.

        Raises:
            InputError: A tensor is missing.
        """
        missing = [name for name in TENSORS if f"prior.{name}" not in state]
        if missing:
            raise InputError(f"holds no prior ({', '.join(missing)} missing)")
        return cls(*(state[f"prior.{name}"] for name in TENSORS))
