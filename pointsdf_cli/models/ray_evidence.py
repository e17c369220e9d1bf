"""Evidence of a single depth view about one query point, as numbers for a decoder.

A depth camera gives more than points: the space before the surface is free along every ray, and so
is the space outside the silhouette. For a query x and the observed points p_j,

    in space    offsets and distances to the nearest p_j;
    in image    for the p_j with the nearest pixels: the depth of x *behind* each (z_x − z_j), and
                its lateral distance (large outside the silhouette).

All of it is differentiable in x; the neighbours themselves are chosen without gradients.
"""

from __future__ import annotations

import torch
from torch import Tensor

from pointsdf_cli.models.neighbours import gather, nearest_neighbours

SPACE_NEIGHBOURS = 4
IMAGE_NEIGHBOURS = 6
SHARP, SOFT = 0.025, 0.1
"""Scales of the saturating copies of each distance: about one point spacing, and a part's size."""

SCALARS = 9
EVIDENCE_SIZE = 3 * SCALARS + 8


def image_coordinates(points: Tensor, camera: Tensor) -> Tensor:
    """Pinhole coordinates and depth as seen from the camera.

    Args:
        points: [B, N, 3], network frame (the camera's axes).
        camera: [B, 3], the camera's centre in that frame.

    Returns:
        [B, N, 3]: lateral x and y, scaled to lengths at the cloud's centre plane, and depth along z
        relative to the camera. Points behind the camera, or hardly before it, are divided by a
        small positive depth instead of their own.
    """
    relative = points - camera.unsqueeze(1)
    reference = camera[:, 2].neg().clamp(min=0.1).view(-1, 1, 1)
    depth = relative[..., 2:]
    lateral = relative[..., :2] * (reference / torch.maximum(depth, 0.05 * reference))
    return torch.cat([lateral, depth], dim=-1)


def ray_evidence(
    x: Tensor,
    x_image: Tensor,
    cloud: Tensor,
    cloud_image: Tensor,
    cloud_plane: Tensor,
    camera: Tensor,
) -> Tensor:
    """The evidence of each query.

    Args:
        x: [B, Q, 3], network frame.
        x_image: [B, Q, 3], their `image_coordinates`.
        cloud: [B, P, 3], network frame.
        cloud_image: [B, P, 3], `image_coordinates` of the cloud.
        cloud_plane: [B, P, 2], the first two of these.
        camera: [B, 3], network frame.

    Returns:
        [B, Q, EVIDENCE_SIZE], float32.
    """
    near = nearest_neighbours(x, cloud, SPACE_NEIGHBOURS)
    offset = x.unsqueeze(2) - gather(cloud, near)
    distance = _length(offset)
    closest = distance.detach().argmin(-1, keepdim=True)

    seen = nearest_neighbours(x_image[..., :2], cloud_plane, IMAGE_NEIGHBOURS)
    gap = x_image.unsqueeze(2) - gather(cloud_image, seen)
    aside, behind = gap[..., :2], gap[..., 2]
    lateral = _length(aside)
    in_front = lateral.detach().argmin(-1, keepdim=True)

    away = distance.amin(-1), distance.mean(-1), lateral.amin(-1), lateral.mean(-1)
    hidden = behind.gather(-1, in_front).squeeze(-1)
    depths = hidden, behind.mean(-1), behind.amin(-1), behind.amax(-1)
    depth = x_image[..., 2] + camera[:, 2].unsqueeze(1)
    scalars = torch.stack([*away, *depths, depth], dim=-1)
    vectors = _pick(offset, closest) / SOFT, offset.mean(2) / SOFT, aside.mean(2) / SOFT
    saturating = torch.tanh(scalars / SHARP), torch.tanh(scalars / SOFT)
    return torch.cat([scalars, *saturating, *vectors], dim=-1)


def _pick(vectors: Tensor, index: Tensor) -> Tensor:
    """Select [B, Q, D] from vectors [B, Q, K, D] by an index [B, Q, 1] into K."""
    wanted = index.unsqueeze(-1).expand(*index.shape, vectors.shape[-1])
    return vectors.gather(2, wanted).squeeze(2)


def _length(vectors: Tensor) -> Tensor:
    # The small constant keeps the gradient finite where a query meets an observed point.
    return (vectors.square().sum(-1) + 1e-10).sqrt()
