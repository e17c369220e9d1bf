"""Axis of revolution of a partial cloud, and the symmetric point of a query about it.

Half of all tabletop objects are surfaces of revolution: cups, bowls, cans, bottles, balls, fruit.
One view of such an object shows nearly all of it, once the view is turned about its axis. Two
steps:

**The axis.** The normals of a surface of revolution all meet its axis. The line through p along n
meets the line through c along a where n·ā + (p × n)·a = 0 with the moment ā = c × a, which is
linear in (a, ā): the axis is the eigenvector of a 3 × 3 matrix (ā eliminated), found with
reweighting, so that handles and spouts do not count (Pottmann and Wallner, Computational Line
Geometry, 2001, chapter 3). The distance by which the normals miss the axis tells a cup from a box.

**The symmetric point of a query** is the query turned about that axis to an observed azimuth: the
same height and distance from the axis, at the azimuth of the observed point that is nearest in
height and distance. If the axis is right, evidence about the symmetric point holds for the query.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from pointsdf_cli.models.neighbours import gather, nearest_neighbours

ROUNDS = 5
"""Rounds of reweighting."""
TOLERANCE = 0.03
"""Distance between normal and axis (network units) at which the normal's weight is one half."""
RIDGE = 1e-3
"""Regularisation: fixes the undetermined part of a line, as for cylinders and planes."""
NEARNESS = 0.15
"""Weight of the distance in space when a symmetric point's azimuth is chosen: among points observed
at the same height and radius, the one nearest to the query wins."""

TRUST_SIZE = 8
"""Number of features that tell the trust in a symmetric point."""


class Axis(NamedTuple):
    """A line for each cloud, in the network's frame.

    Attributes:
        direction: [B, 3], of unit length, pointing to the camera's side.
        point: [B, 3], on the line, nearest to the origin.
        miss: [B], median distance between the cloud's normals and the line.
        spread: [B], relative gap to the second best direction: 0 (fits as well) to 1.
    """

    direction: Tensor
    point: Tensor
    miss: Tensor
    spread: Tensor


@torch.no_grad()
def surface_normals(points: Tensor, neighbours: Tensor, cloud: Tensor, camera: Tensor) -> Tensor:
    """Normals by plane fits, turned to the camera.

    Args:
        points: [B, M, 3].
        neighbours: int64 [B, M, K] into the cloud.
        cloud: [B, P, 3].
        camera: [B, 3].

    Returns:
        [B, M, 3], of unit length.
    """
    around = gather(cloud, neighbours)
    around = around - around.mean(2, keepdim=True)
    covariance = around.transpose(-1, -2) @ around
    normal = torch.linalg.eigh(covariance).eigenvectors[..., 0]
    towards = ((camera.unsqueeze(1) - points) * normal).sum(-1, keepdim=True)
    return torch.where(towards < 0, -normal, normal)


@torch.no_grad()
def revolution_axis(points: Tensor, normals: Tensor, camera: Tensor, sideways: float = 0.0) -> Axis:
    """Fit the line that most normals meet.

    A ball has an axis through its centre in every direction, and many shapes have more than one.
    Turning about an axis that points to the camera maps hidden surface to hidden surface; turning
    about an axis across the view maps it to observed surface. Among axes that fit nearly equally
    well, the one across the view is preferred.

    Args:
        points: [B, M, 3], float32.
        normals: [B, M, 3], of unit length.
        camera: [B, 3].
        sideways: Preference for an axis across the viewing direction over one along it, as a mean
            square of the distance between normals and axis, network units.
    """
    moment = torch.cross(points, normals, dim=-1)
    weight = torch.ones_like(points[..., 0])
    view = torch.nn.functional.normalize(camera, dim=-1)
    along_view = sideways * view.unsqueeze(-1) * view.unsqueeze(-2)
    eye = torch.eye(3, dtype=points.dtype, device=points.device)
    for _ in range(ROUNDS):
        weighted_normals = weight.unsqueeze(-1) * normals
        total = weight.sum(1).view(-1, 1, 1)
        along = moment.transpose(1, 2) @ (weight.unsqueeze(-1) * moment)
        mixed = moment.transpose(1, 2) @ weighted_normals
        across = normals.transpose(1, 2) @ weighted_normals + RIDGE * total * eye
        eliminated = torch.linalg.solve(across, mixed.transpose(1, 2))
        fit = along - mixed @ eliminated + total * along_view
        values, vectors = torch.linalg.eigh(fit)
        direction = vectors[..., 0]
        line_moment = -(eliminated @ direction.unsqueeze(-1)).squeeze(-1)
        miss = (normals @ line_moment.unsqueeze(-1) + moment @ direction.unsqueeze(-1)).squeeze(-1)
        weight = 1.0 / (1.0 + (miss / TOLERANCE).square())
    point = torch.cross(direction, line_moment, dim=-1)
    away = ((camera - point) * direction).sum(-1, keepdim=True) < 0
    spread = (values[:, 1] - values[:, 0]) / values[:, 1].clamp(min=1e-12)
    towards = torch.where(away, -direction, direction)
    return Axis(towards, point, miss.abs().median(1).values, spread)


def cylindrical(x: Tensor, axis: Axis) -> tuple[Tensor, Tensor, Tensor]:
    """Distance from the axis [B, N, 1], height along it [B, N, 1], and unit radial vector."""
    relative = x - axis.point.unsqueeze(1)
    direction = axis.direction.unsqueeze(1)
    height = (relative * direction).sum(-1, keepdim=True)
    radial = relative - height * direction
    radius = (radial.square().sum(-1, keepdim=True) + 1e-8).sqrt()
    return radius, height, radial / radius


def places(x: Tensor, axis: Axis) -> Tensor:
    """Search keys [B, N, 5] for symmetric points: radius, height and weighted position."""
    radius, height, _ = cylindrical(x, axis)
    return torch.cat([radius, height, NEARNESS * x], dim=-1)


def symmetric_points(
    x: Tensor, axis: Axis, cloud: Tensor, cloud_places: Tensor
) -> tuple[Tensor, Tensor]:
    """Turn queries about the axis to an observed azimuth.

    Args:
        x: [B, Q, 3].
        axis: Axis of each cloud.
        cloud: [B, P, 3].
        cloud_places: [B, P, 5], `places` of the cloud.

    Returns:
        Symmetric points [B, Q, 3] and their trust features [B, Q, TRUST_SIZE]. Both are
        differentiable in x while the nearest observed point stays the same.
    """
    radius, height, radial = cylindrical(x, axis)
    wanted = torch.cat([radius, height, NEARNESS * x], dim=-1)
    nearest = nearest_neighbours(wanted, cloud_places, 1)
    seen = gather(cloud, nearest.squeeze(-1))
    seen_radius, seen_height, seen_radial = cylindrical(seen, axis)
    direction = axis.direction.unsqueeze(1)
    symmetric = axis.point.unsqueeze(1) + height * direction + radius * seen_radial
    turned = (radial * seen_radial).sum(-1, keepdim=True)
    miss = torch.stack([axis.miss / 0.01, axis.miss / 0.05], dim=-1).unsqueeze(1)
    trust = torch.cat(
        [
            torch.tanh(miss).expand(-1, x.shape[1], -1),
            axis.spread.view(-1, 1, 1).expand(-1, x.shape[1], 1),
            turned,
            torch.tanh((radius - seen_radius) / 0.05),
            torch.tanh((height - seen_height) / 0.05),
            radius,
            height,
        ],
        dim=-1,
    )
    return symmetric, trust
