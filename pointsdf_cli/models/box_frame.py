"""The box that a partial cloud was cut from, and where a query lies between its faces.

Of a carton seen from a corner three faces are hidden, and the view says exactly where: each lies at
the end of the faces that meet it. That is a number about the whole cloud along one direction, which
no local feature holds and an embedding holds coarsely. So it is computed: three orthogonal
directions that the cloud's normals keep to, the cloud's ends along each, and for a query how far it
lies from each of the six planes. Cans, jars and tools have such ends too.

**The directions** maximise Σ Σₖ (n·rₖ)⁴ over rotations (r₁ r₂ r₃), as independent component
analysis does (Hyvärinen 1999): each normal wants to lie along one of them. A fixed point of
R ← polar(Σ (Rn)³ nᵀ) is found in a few rounds from the principal directions of the normals.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from pointsdf_cli.models.revolution import Axis, cylindrical

ROUNDS = 12
INNER = 0.005
"""Share of the points beyond the inner one of the two ends that are given for each hidden side:
the outermost point of a noisy cloud lies outside of the object."""
SHARP, SOFT = 0.01, 0.05
"""Scales of the saturating copies of each distance, network units."""

GAPS = 14
"""Distances of a query: three along each direction, four about the axis, one from the whole box."""
BOX_SIZE = 3 * GAPS + 13


class BoxFrame(NamedTuple):
    """Three orthogonal directions of each cloud and its ends along them, in the network's frame.

    Attributes:
        directions: [B, 3, 3], rows of unit length that point to the camera's side, the one most
            along the viewing direction first.
        ends: [B, 3, 3], along each direction the highest point, the lowest, and the one that a
            share `INNER` of the points lies below.
        turned: [B, 4], of the axis of revolution: the largest radius, the highest point, the lowest
            and the inner one.
        trust: [B, 13]: how well the normals keep to the directions, and the box's size.
    """

    directions: Tensor
    ends: Tensor
    turned: Tensor
    trust: Tensor


@torch.no_grad()
def box_frame(normals: Tensor, cloud: Tensor, camera: Tensor, axis: Axis) -> BoxFrame:
    """The directions that a cloud's normals keep to, and its ends.

    Args:
        normals: [B, M, 3], of unit length, spread evenly over the cloud.
        cloud: [B, P, 3].
        camera: [B, 3].
        axis: Axis of revolution.
    """
    frame = torch.linalg.eigh(normals.transpose(1, 2) @ normals).eigenvectors.transpose(1, 2)
    for _ in range(ROUNDS):
        along = normals @ frame.transpose(1, 2)
        left, _, right = torch.linalg.svd((along**3).transpose(1, 2) @ normals)
        frame = left @ right
    view = torch.nn.functional.normalize(camera, dim=-1)
    facing = (frame @ view.unsqueeze(-1)).squeeze(-1)
    order = facing.abs().argsort(dim=1, descending=True, stable=True)
    frame = (frame * torch.where(facing < 0, -1.0, 1.0).unsqueeze(-1)).gather(
        1, order.unsqueeze(-1).expand(-1, -1, 3)
    )
    facing = facing.abs().gather(1, order)
    kept = (normals @ frame.transpose(1, 2)).square()
    trust = torch.cat(
        [
            kept.square().mean(1),
            (kept > 0.9).to(kept.dtype).mean(1),
            facing,
            (1.0 - kept.square().sum(-1).mean(1, keepdim=True)),
        ],
        dim=-1,
    )
    ends = _ends(cloud @ frame.transpose(1, 2))
    size = ends[..., 0] - ends[..., 1]
    radius, height, _ = cylindrical(cloud, axis)
    turned = torch.cat([radius.amax(1), _ends(height).squeeze(1)], dim=-1)
    return BoxFrame(frame, ends, turned, torch.cat([trust, size], dim=-1))


def box_evidence(x: Tensor, box: BoxFrame, axis: Axis) -> Tensor:
    """Positions of queries between the faces of the box and the ends of the body of revolution.

    Args:
        x: [B, Q, 3].
        box: Box of each cloud.
        axis: Axis of each cloud.

    Returns:
        [B, Q, BOX_SIZE], differentiable in x.
    """
    place = x @ box.directions.transpose(1, 2)
    ends = box.ends.unsqueeze(1)
    before, behind, inner = place - ends[..., 0], ends[..., 1] - place, ends[..., 2] - place
    outside = torch.maximum(before, inner)
    to_box = (outside.clamp(min=0.0).square().sum(-1, keepdim=True) + 1e-8).sqrt()
    to_box = to_box + outside.amax(-1, keepdim=True).clamp(max=0.0)
    radius, height, _ = cylindrical(x, axis)
    turned = box.turned.unsqueeze(1)
    around = torch.cat(
        [
            radius - turned[..., :1],
            height - turned[..., 1:2],
            turned[..., 2:3] - height,
            turned[..., 3:4] - height,
        ],
        dim=-1,
    )
    gaps = torch.cat([before, behind, inner, around, to_box], dim=-1)
    trust = box.trust.unsqueeze(1).expand(-1, x.shape[1], -1)
    return torch.cat([gaps, torch.tanh(gaps / SHARP), torch.tanh(gaps / SOFT), trust], dim=-1)


def _ends(along: Tensor) -> Tensor:
    """[B, D, 3] from places [B, P, D]: the highest, the lowest and the inner one."""
    beyond = max(1, round(INNER * along.shape[1]))
    inner = along.kthvalue(beyond, dim=1).values
    return torch.stack([along.amax(1), along.amin(1), inner], dim=-1)
