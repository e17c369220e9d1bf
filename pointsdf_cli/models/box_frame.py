"""Oriented box of a partial cloud, and distances of queries to its faces.

A carton seen from a corner has three hidden faces, each at the end of the visible faces that meet
it. This is a property of the whole cloud along one direction: no local feature contains it, and an
embedding only coarsely. So it is computed: three orthogonal directions that align with the cloud's
normals, the cloud's ends along each, and a query's distance to each of the six planes. Cans, jars
and tools have such ends too.

**The directions** maximise Σ Σₖ (n·rₖ)⁴ over rotations (r₁ r₂ r₃), as in independent component
analysis (Hyvärinen 1999), which aligns each normal with one of them. A fixed point of
R ← polar(Σ (Rn)³ nᵀ) is found in a few rounds from the principal directions of the normals.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from pointsdf_cli.models.revolution import Axis, cylindrical

ROUNDS = 12
INNER = 0.005
"""Share of the points beyond the inner end, which is a second, robust end on each hidden side: the
outermost point of a noisy cloud lies outside the object."""
SHARP, SOFT = 0.01, 0.05
"""Scales of the saturating copies of each distance, network units."""

GAPS = 14
"""Number of distances of a query: three along each direction, four about the axis, one to the
box."""
ALIGNMENT_SIZE = 10
"""Number of features that tell how well the normals align with the directions."""
BOX_SIZE = 3 * GAPS + ALIGNMENT_SIZE + 3


class BoxFrame(NamedTuple):
    """Three orthogonal directions of each cloud and its ends along them, in the network's frame.

    Attributes:
        directions: [B, 3, 3], unit rows that point to the camera's side, the one nearest to the
            viewing direction first.
        ends: [B, 3, 3], along each direction the highest point, the lowest, and the quantile
            `INNER`.
        turned: [B, 4], about the axis of revolution: the largest radius, the highest point, the
            lowest and the inner one.
        trust: [B, 13], alignment of the normals with the directions, and the box's size.
    """

    directions: Tensor
    ends: Tensor
    turned: Tensor
    trust: Tensor


@torch.no_grad()
def box_frame(normals: Tensor, cloud: Tensor, camera: Tensor, axis: Axis) -> BoxFrame:
    """Directions aligned with a cloud's normals, and the cloud's ends along them.

    Args:
        normals: [B, M, 3], of unit length, spread evenly over the cloud.
        cloud: [B, P, 3], network frame.
        camera: [B, 3], network frame.
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
    towards = frame * torch.where(facing < 0, -1.0, 1.0).unsqueeze(-1)
    frame = towards.gather(1, order.unsqueeze(-1).expand(-1, -1, 3))
    facing = facing.abs().gather(1, order)
    kept = (normals @ frame.transpose(1, 2)).square()
    along, aligned = kept.square().mean(1), (kept > 0.9).to(kept.dtype).mean(1)
    askew = 1.0 - kept.square().sum(-1).mean(1, keepdim=True)
    trust = torch.cat([along, aligned, facing, askew], dim=-1)
    return box_around(cloud, axis, frame, trust)


def box_around(cloud: Tensor, axis: Axis, directions: Tensor, alignment: Tensor) -> BoxFrame:
    """The box of a cloud along known directions.

    Args:
        cloud: [B, P, 3], network frame.
        axis: Axis of revolution.
        directions: [B, 3, 3], as in `BoxFrame`.
        alignment: [B, ALIGNMENT_SIZE], the trust without the box's size.
    """
    ends = _ends(cloud @ directions.transpose(1, 2))
    size = ends[..., 0] - ends[..., 1]
    radius, height, _ = cylindrical(cloud, axis)
    turned = torch.cat([radius.amax(1), _ends(height).squeeze(1)], dim=-1)
    return BoxFrame(directions, ends, turned, torch.cat([alignment, size], dim=-1))


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
    rim, top, bottoms = box.turned.unsqueeze(1).split((1, 1, 2), dim=-1)
    around = radius - rim, height - top, bottoms - height
    gaps = torch.cat([before, behind, inner, *around, to_box], dim=-1)
    trust = box.trust.unsqueeze(1).expand(-1, x.shape[1], -1)
    return torch.cat([gaps, torch.tanh(gaps / SHARP), torch.tanh(gaps / SOFT), trust], dim=-1)


def _ends(along: Tensor) -> Tensor:
    """Highest, lowest and inner coordinate [B, D, 3] of points [B, P, D]."""
    beyond = max(1, round(INNER * along.shape[1]))
    inner = along.kthvalue(beyond, dim=1).values
    return torch.stack([along.amax(1), along.amin(1), inner], dim=-1)
