"""VoxelCNN, the paper's baseline: a 32³ occupancy grid in, a 32³ occupancy grid out.

Trained by the cross-entropy of its logits at the labelled points instead of at all voxels. Between
voxel centres the logits are interpolated; divided by a constant slope they replace a signed
distance: negative inside, zero at probability 0.5, right in sign but not in length.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from pointsdf_cli.models.normalise import MARGIN
from pointsdf_cli.models.shape_model import Encoding, ShapeModel
from pointsdf_cli.models.surroundings import Surroundings

GRID = 32
VIEW_VOXELS = 26
"""Number of voxels along the partial view's largest extent; the rest is for the unseen part."""

VOXEL = 1.0 / MARGIN / VIEW_VOXELS
"""Side of a voxel, network units."""
LOGIT_SLOPE = 0.02
"""Network units per logit; `SdfLoss.temperature` divides by it again."""


class VoxelCNN(ShapeModel):
    """See the module's docstring. It has no sizes to choose."""

    architecture = "voxelcnn"
    box = VOXEL * GRID / 2.0
    gives_distances = False
    encoder_parts = ("encoder", "to_embedding")

    def __init__(self) -> None:
        super().__init__()
        self.encoder = nn.Sequential(
            *_normed(nn.Conv3d(1, 8, 5)),
            *_normed(nn.Conv3d(8, 16, 3, stride=2, padding=1)),
            *_normed(nn.Conv3d(16, 32, 3)),
            *_normed(nn.Conv3d(32, 64, 3, stride=2, padding=1)),
            nn.Flatten(),
        )
        with torch.no_grad():
            flat = self.encoder.eval()(torch.zeros(1, 1, GRID, GRID, GRID)).shape[1]
        self.encoder.train()
        self.to_embedding = nn.Sequential(
            nn.Linear(flat, self.embedding_size), nn.BatchNorm1d(self.embedding_size), nn.ELU()
        )
        self.from_embedding = nn.Sequential(
            nn.Linear(self.embedding_size, 7**3), nn.BatchNorm1d(7**3), nn.ELU()
        )
        self.decoder = nn.Sequential(
            *_normed(nn.Conv3d(1, 64, 3, padding=1)),
            *_normed(nn.ConvTranspose3d(64, 32, 3, stride=2)),
            *_normed(nn.Conv3d(32, 16, 3, padding=1)),
            *_normed(nn.ConvTranspose3d(16, 8, 3, stride=2)),
            # 7 → 15 → 31; one more plane of padding and the last layer gives 32.
            nn.ConstantPad3d((1, 2, 1, 2, 1, 2), 0.0),
            nn.Conv3d(8, 1, 3),
        )

    def embed(self, cloud: Tensor, camera: Tensor, neighbours: Tensor | None = None) -> Tensor:
        return self.to_embedding(self.encoder(occupancy(cloud).unsqueeze(1)))

    def encode(
        self,
        cloud: Tensor,
        camera: Tensor,
        neighbours: Tensor | None = None,
        surroundings: Surroundings | None = None,
    ) -> Encoding:
        embedding = self.embed(cloud, camera, neighbours)
        logits = self.decoder(self.from_embedding(embedding).view(-1, 1, 7, 7, 7))
        return Encoding(embedding, {"logits": logits})

    def decode(self, encoding: Encoding, x: Tensor) -> Tensor:
        # grid_sample wants coordinates (last axis first) with ±1 at the outer voxels' centres.
        place = (x.flip(-1) / (VOXEL * (GRID - 1) / 2.0))[:, :, None, None, :]
        known = encoding.evidence["logits"].to(x.dtype)
        logits = nn.functional.grid_sample(known, place, padding_mode="border", align_corners=True)
        return -LOGIT_SLOPE * logits[:, 0, :, 0, 0]


def occupancy(cloud: Tensor) -> Tensor:
    """[B, 32, 32, 32] ones where a voxel holds a point of the cloud [B, P, 3] (network frame)."""
    voxel = (cloud / VOXEL + GRID / 2.0).floor().long().clamp_(0, GRID - 1)
    flat = (voxel[..., 0] * GRID + voxel[..., 1]) * GRID + voxel[..., 2]
    grid = torch.zeros(len(cloud), GRID**3, device=cloud.device, dtype=cloud.dtype)
    return grid.scatter_(1, flat, 1.0).view(-1, GRID, GRID, GRID)


def _normed(layer: nn.Conv3d | nn.ConvTranspose3d) -> list[nn.Module]:
    return [layer, nn.BatchNorm3d(layer.out_channels), nn.ELU()]
