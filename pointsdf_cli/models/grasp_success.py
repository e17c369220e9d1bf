"""The success network h(q_g, o; φ) (paper section IV): probability that a grasp holds.

Two networks:

- `EmbeddingNet` is the published one. It reads the cloud's embedding (256), its size (3) and the
  grasp: preshape joints, and the palm's pose in the object frame. The rotation enters as the first
  two columns of its matrix (6 numbers: no jumps, unlike angles or quaternions; the third column is
  their cross product and says nothing more).
- `GeometryNet` reads the features of `grasp_features.py`. It averages several small networks,
  trained together from different starts: an ensemble against little data.

Training balances the classes, so raw logits assume equally frequent successes and failures;
`Calibration` turns them into probabilities for the planner's thresholds.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from pointsdf_cli.models.linear import dense
from pointsdf_cli.models.rebuildable import Rebuildable

POSE_SIZE = 9
"""Number of inputs for a palm pose: position (3) and two columns of the rotation (6)."""


class Calibration(nn.Module):
    """Calibration log h = log σ(a z + b): a is one over the temperature, b corrects the base
    rate."""

    scale: Tensor
    shift: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("scale", torch.ones(()))
        self.register_buffer("shift", torch.zeros(()))

    def forward(self, logit: Tensor) -> Tensor:
        """Calibrated logits [B]."""
        return logit * self.scale + self.shift


class Standardise(nn.Module):
    """Standardisation (x − mean) / deviation by statistics of the training data."""

    mean: Tensor
    inverse: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("inverse", torch.ones(size))

    @torch.no_grad()
    def fit(self, x: Tensor) -> None:
        """Fit the normalisation to x [N, size]; nearly constant columns are not amplified."""
        self.mean.copy_(x.mean(0))
        self.inverse.copy_(1.0 / (x.std(0) + 0.02))

    def forward(self, x: Tensor) -> Tensor:
        return (x - self.mean) * self.inverse


class EmbeddingNet(Rebuildable):
    """The published network (Lu et al. 2020, with the paper's embedding).

    Configuration → 14 → 8; embedding and size → 128 → 64; both → 64 → 32 → 1; LayerNorm + ReLU.

    Args:
        joints: Number of preshape joints, K.
        embedding: Size of the embedding.
        dropout: Dropout on the hidden layers of the cloud's branch and of the joined branch; 0 as
            published.
    """

    inputs = "embedding"

    def __init__(self, joints: int, embedding: int = 256, dropout: float = 0.0) -> None:
        super().__init__()
        self.keep_arguments(locals())
        self.grasp_scale = Standardise(joints + POSE_SIZE)
        self.size_scale = Standardise(3)
        self.grasp = dense([joints + POSE_SIZE, 14, 8], nn.LayerNorm)
        self.cloud = dense([embedding + 3, 128, 64], nn.LayerNorm, dropout)
        self.joined = dense([72, 64, 32], nn.LayerNorm, dropout)
        self.leave = nn.Linear(32, 1)
        self.calibration = Calibration()

    def forward(self, grasp: Tensor, embedding: Tensor, size: Tensor) -> Tensor:
        """Raw logits [B].

        Args:
            grasp: [B, K + 9], `grasp_numbers`.
            embedding: [C, 256], with C = B, or C = 1 for one cloud of all grasps.
            size: [C, 3], extents of the cloud along the camera's axes, m.
        """
        cloud = self.cloud(torch.cat([embedding, self.size_scale(size)], dim=1))
        cloud = cloud.expand(len(grasp), -1)
        joined = torch.cat([self.grasp(self.grasp_scale(grasp)), cloud], dim=1)
        return self.leave(self.joined(joined)).squeeze(1)


def grasp_numbers(preshape: Tensor, T_object_palm: Tensor) -> Tensor:
    """Network input [B, K + 9] of preshapes [B, K] and palms [B, 4, 4] in the object's frame."""
    columns = T_object_palm[:, :3, :2].transpose(1, 2).flatten(1)
    return torch.cat([preshape, T_object_palm[:, :3, 3], columns], dim=1)


class GeometryNet(Rebuildable):
    """Small networks on the features of the grasp's geometry, averaged before the sigmoid.

    Args:
        features: Number of features, F.
        members: Number of networks, M.
        widths: Widths of the hidden layers.
        dropout: Dropout on hidden layers.
        input_dropout: Dropout on the features.
    """

    inputs = "geometry"

    def __init__(
        self,
        features: int,
        members: int = 5,
        widths: Sequence[int] = (128, 64),
        dropout: float = 0.3,
        input_dropout: float = 0.1,
    ) -> None:
        super().__init__()
        self.keep_arguments(locals())
        self.scale = Standardise(features)
        self.enter = nn.Dropout(input_dropout)
        sizes = [features, *widths]
        layers: list[nn.Module] = []
        for a, b in itertools.pairwise(sizes):
            layers += [Members(members, a, b), nn.LayerNorm(b), nn.GELU(), nn.Dropout(dropout)]
        self.hidden = nn.Sequential(*layers)
        self.leave = Members(members, sizes[-1], 1)
        self.calibration = Calibration()

    @property
    def member_count(self) -> int:
        """Number of networks, M."""
        return len(self.leave.weight)

    def members(self, features: Tensor) -> Tensor:
        """Raw logits [M, B] of each member for features [B, F]."""
        # In training each member drops other features; otherwise all would learn the same.
        copies = self.member_count if self.training else 1
        x = self.scale(features).expand(copies, -1, -1)
        return self.leave(self.hidden(self.enter(x))).squeeze(-1)

    def forward(self, features: Tensor) -> Tensor:
        """Raw logits [B], the members' mean."""
        return self.members(features).mean(0)


class Members(nn.Module):
    """M linear layers side by side: [M or 1, B, in] → [M, B, out]."""

    def __init__(self, members: int, inputs: int, outputs: int) -> None:
        super().__init__()
        bound = inputs**-0.5
        self.weight = nn.Parameter(torch.empty(members, inputs, outputs).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.zeros(members, 1, outputs))

    def forward(self, x: Tensor) -> Tensor:
        if len(x) == 1 and len(self.weight) > 1:
            # One wide product instead of M narrow ones.
            wide = x[0] @ self.weight.transpose(0, 1).flatten(1)
            return wide.unflatten(1, (len(self.weight), -1)).transpose(0, 1) + self.bias
        return torch.baddbmm(self.bias, x, self.weight)


NETWORKS: dict[str, type[EmbeddingNet] | type[GeometryNet]] = {
    net.inputs: net for net in (EmbeddingNet, GeometryNet)
}
