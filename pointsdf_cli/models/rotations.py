"""Rotation vectors in torch: the chart of rotations on which the prior is a Gaussian.

    ω = log R,   R = exp ω,   dR = (2 − 2 cos |ω|) / |ω|² dω

dR is the invariant volume of rotations, scaled to agree with dω at the identity. The chart is
smooth for all turns below π.
"""

from __future__ import annotations

import torch
from torch import Tensor


def quaternion(rotation: Tensor) -> Tensor:
    """Unit quaternions wxyz [..., 4] with w ≥ 0 of rotations [..., 3, 3]; differentiable.

    For each rotation, uses the one of Shepperd's four formulas with the largest divisor.
    """
    m = rotation
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    a, b, c = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    d, e, f = m[..., 1, 0] + m[..., 0, 1], m[..., 0, 2] + m[..., 2, 0], m[..., 2, 1] + m[..., 1, 2]
    rows = torch.stack(
        [
            torch.stack([1 + xx + yy + zz, a, b, c], dim=-1),
            torch.stack([a, 1 + xx - yy - zz, d, e], dim=-1),
            torch.stack([b, d, 1 - xx + yy - zz, f], dim=-1),
            torch.stack([c, e, f, 1 - xx - yy + zz], dim=-1),
        ],
        dim=-2,
    )
    best = rows.diagonal(dim1=-2, dim2=-1).argmax(-1)
    wxyz = rows.gather(-2, best[..., None, None].expand(*best.shape, 1, 4)).squeeze(-2)
    wxyz = wxyz / wxyz.norm(dim=-1, keepdim=True)
    return torch.where(wxyz[..., :1] < 0, -wxyz, wxyz)


def rotation_vector(rotation: Tensor) -> Tensor:
    """Rotation vectors ω [..., 3] with |ω| ≤ π of rotations [..., 3, 3]."""
    wxyz = quaternion(rotation)
    w, xyz = wxyz[..., :1], wxyz[..., 1:]
    squared = (xyz * xyz).sum(-1, keepdim=True)
    small = squared < 1e-12
    sine = torch.where(small, torch.ones_like(squared), squared).sqrt()
    factor = torch.where(small, 2.0 / w, 2.0 * torch.atan2(sine, w) / sine)
    return xyz * factor


def rotation_of(vector: Tensor) -> Tensor:
    """Rotations [..., 3, 3] of rotation vectors ω [..., 3]."""
    x, y, z = vector.unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1)
    return torch.linalg.matrix_exp(cross.unflatten(-1, (3, 3)))


def log_volume(vector: Tensor) -> Tensor:
    """Log of invariant volume per volume of the chart at ω [..., 3]: log((2 − 2 cos θ) / θ²)
    [...]."""
    squared = (vector * vector).sum(-1)
    small = squared < 1e-4
    safe = torch.where(small, torch.ones_like(squared), squared)
    exact = torch.log((2.0 - 2.0 * torch.cos(safe.sqrt())) / safe)
    return torch.where(small, -squared / 12.0, exact)
