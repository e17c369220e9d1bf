"""The view's evidence about the space around the object, as input of a decoder.

`geometry/visibility.py` gives the free depth of each ray and the region where the object was seen.
For a query x at image place (u, v) and depth z the decoder reads

    z_free(u, v) − z    above zero: the camera saw through this point;
    d_free(u, v)        signed distance to the region of wholly free rays (below zero inside);
    d_seen(u, v)        signed distance to the region where the object was seen (below zero inside);
    unknown(u, v)       share of the neighbouring cells without evidence;
    h(x)                height above the support plane, with the plane's normal,

and flags of the available evidence. Lateral distances are those of `image_coordinates`. All inputs
are bilinear or smooth in x, and zero without evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
import torch
from numpy.typing import NDArray
from torch import Tensor

from pointsdf_cli.geometry.visibility import SIZE, ViewEvidence
from pointsdf_cli.models.normalise import NetworkFrame

CHANNELS = 4
FARTHEST = 1.2
"""Largest depth relative to the network's origin; others are clipped [network units]."""
WIDEST = 0.5
"""Largest lateral distance; others are clipped [network units]."""
THROUGH = 0.6
"""Depth behind the network's origin from which a ray counts as wholly free [network units]."""
SHARP, SOFT = 0.025, 0.1
"""Scales of the saturating copies of each distance, network units, as in `ray_evidence.py`."""

VISIBILITY_SIZE = 3 * 3 + 1
PLANE_SIZE = 3 + 3 + 2
SURROUNDINGS_SIZE = VISIBILITY_SIZE + PLANE_SIZE + 2


class Surroundings(NamedTuple):
    """The evidence of B views in the network's frame.

    Attributes:
        maps: [B, CHANNELS, SIZE, SIZE]: free depth of the rays minus the depth of the network's
            origin; signed distances to free rays and to the seen object; 1 for unknown cells.
        to_map: [B, 2, 3], affine map from `image_coordinates` (x, y) to coordinates in [−1, 1].
        plane: [B, 4], the support plane n·x = d.
        known: [B, 2], 1 with a visibility image, and 1 with a plane; else 0.
    """

    maps: Tensor
    to_map: Tensor
    plane: Tensor
    known: Tensor


def surroundings_arrays(
    evidence: ViewEvidence, frame: NetworkFrame
) -> tuple[NDArray[np.float32], ...]:
    """One view's `Surroundings` without the batch axis.

    Args:
        evidence: The view's evidence, camera frame, m.
        frame: The network's frame of the same view, camera axes.
    """
    maps = np.zeros((CHANNELS, SIZE, SIZE), np.float32)
    to_map = np.zeros((2, 3), np.float32)
    plane, known = np.zeros(4, np.float32), np.zeros(2, np.float32)
    if evidence.visibility is not None:
        window, seen, free = evidence.visibility
        reference = frame.centre[2] * frame.scale
        cell = window[2] / SIZE * reference
        depth = np.clip(free * frame.scale - reference, -FARTHEST, FARTHEST)
        maps[0] = np.where(free > 0, depth, -FARTHEST)
        maps[1] = signed_distance(maps[0] > THROUGH, cell, WIDEST)
        maps[2] = signed_distance(seen, cell, WIDEST)
        maps[3] = free == 0
        to_map[:, :2] = np.diag(2.0 / (window[2:] * reference))
        to_map[:, 2] = -2.0 * window[:2] / window[2:] - 1.0
        known[0] = 1.0
    if evidence.support_plane is not None:
        normal, offset = evidence.support_plane[:3], evidence.support_plane[3]
        plane[:3] = normal
        plane[3] = (offset - normal @ frame.centre) * frame.scale
        known[1] = 1.0
    return maps, to_map, plane, known


def surroundings_of(
    evidence: Sequence[ViewEvidence], frames: Sequence[NetworkFrame], device: torch.device
) -> Surroundings:
    """The evidence of several views as one batch."""
    rows = [surroundings_arrays(e, f) for e, f in zip(evidence, frames, strict=True)]
    columns = map(np.stack, zip(*rows, strict=True))
    return Surroundings(*(torch.from_numpy(column).to(device) for column in columns))


def no_surroundings(count: int, device: torch.device) -> Surroundings:
    """Surroundings of `count` views without evidence."""
    shapes = ((count, CHANNELS, SIZE, SIZE), (count, 2, 3), (count, 4), (count, 2))
    return Surroundings(*(torch.zeros(shape, device=device) for shape in shapes))


def without_evidence(
    surroundings: Surroundings, has_visibility: Tensor, has_plane: Tensor
) -> Surroundings:
    """Drop the visibility and the plane of views where bool [B] `has_visibility`, `has_plane` are
    False."""
    image = has_visibility.to(surroundings.maps.dtype)
    plane = has_plane.to(surroundings.plane.dtype)
    return Surroundings(
        surroundings.maps * image.view(-1, 1, 1, 1),
        surroundings.to_map * image.view(-1, 1, 1),
        surroundings.plane * plane.view(-1, 1),
        surroundings.known * torch.stack([image, plane], dim=-1),
    )


def lower_plane(surroundings: Surroundings, by: Tensor) -> Surroundings:
    """Lower the views' support planes by `by` [B], network units."""
    by = by.to(surroundings.plane.dtype) * surroundings.known[:, 1]
    plane = torch.cat([surroundings.plane[:, :3], (surroundings.plane[:, 3] - by)[:, None]], dim=-1)
    return surroundings._replace(plane=plane)


def transformed(
    surroundings: Surroundings, turn: Tensor, centre: Tensor, scale: Tensor
) -> Surroundings:
    """The evidence after x → (R x − c) · s of the network's frame.

    Args:
        surroundings: Surroundings before.
        turn: [B, 3, 3], R: only rotations about z and reflections in planes through it.
        centre: [B, 3], c, with z = 0.
        scale: [B], s.
    """
    maps, to_map, plane, known = surroundings
    lengths = torch.ones(len(maps), CHANNELS, 1, 1, dtype=maps.dtype, device=maps.device)
    lengths[:, :3] = scale.view(-1, 1, 1, 1)
    linear = to_map[:, :, :2] @ turn[:, :2, :2].transpose(1, 2) / scale.view(-1, 1, 1)
    normal = (turn @ plane[:, :3, None]).squeeze(-1)
    offset = (plane[:, 3] - (normal * centre).sum(-1)) * scale
    to_map = torch.cat([linear, to_map[:, :, 2:]], dim=-1)
    plane = torch.cat([normal, offset[:, None]], dim=-1)
    return Surroundings(maps * lengths, to_map, plane, known)


def visibility_evidence(x_image: Tensor, camera: Tensor, around: Surroundings) -> Tensor:
    """Evidence of the depth image about each query.

    Args:
        x_image: [B, Q, 3], `image_coordinates` of the queries.
        camera: [B, 3], network frame.
        around: Surroundings of the same views.

    Returns:
        [B, Q, VISIBILITY_SIZE], float32, differentiable in x_image.
    """
    linear, shift = around.to_map[:, :, :2], around.to_map[:, :, 2]
    place = x_image[..., :2] @ linear.transpose(1, 2) + shift.unsqueeze(1)
    read = torch.nn.functional.grid_sample(
        around.maps, place.unsqueeze(1), padding_mode="border", align_corners=False
    )
    free, to_free, to_seen, unknown = read.squeeze(2).unbind(1)
    depth = x_image[..., 2] + camera[:, 2].unsqueeze(1)
    known = around.known[:, :1]
    lengths = torch.stack([(free - depth).clamp(-1.0, 1.0), to_free, to_seen], dim=-1)
    lengths = lengths * known.unsqueeze(-1)
    saturating = torch.tanh(lengths / SHARP), torch.tanh(lengths / SOFT)
    return torch.cat([lengths, *saturating, unknown.unsqueeze(-1)], dim=-1)


def plane_evidence(x: Tensor, cloud: Tensor, around: Surroundings) -> Tensor:
    """Positions of queries above the support plane.

    Args:
        x: [B, Q, 3], network frame.
        cloud: [B, P, 3], network frame.
        around: Surroundings of the same views.

    Returns:
        [B, Q, PLANE_SIZE + 2], float32; the last two are flags of the available evidence.
    """
    normal, offset = around.plane[:, :3, None], around.plane[:, 3, None]
    known = around.known[:, 1:]
    height = ((x @ normal).squeeze(-1) - offset) * known
    heights = (cloud @ normal).squeeze(-1) - offset
    ends = torch.stack([heights.amin(1), heights.amax(1)], dim=-1) * known
    count = x.shape[1]
    return torch.cat(
        [
            torch.stack([height, torch.tanh(height / SHARP), torch.tanh(height / SOFT)], dim=-1),
            around.plane[:, None, :3].expand(-1, count, -1),
            ends.unsqueeze(1).expand(-1, count, -1),
            around.known.unsqueeze(1).expand(-1, count, -1),
        ],
        dim=-1,
    )


def signed_distance(inside: NDArray[np.bool_], cell: float, widest: float) -> NDArray[np.float64]:
    """Distances to a region of cells bool [H, W], below zero inside, clipped to ±`widest`.

    Args:
        inside: The cells of the region.
        cell: Side of a cell.
        widest: Largest distance, in the unit of `cell`.
    """
    if inside.all() or not inside.any():
        return np.full(inside.shape, -widest if inside.all() else widest)
    outer = scipy.ndimage.distance_transform_edt(~inside)
    inner = scipy.ndimage.distance_transform_edt(inside)
    distance: NDArray[np.float64] = (outer - inner - np.sign(outer - inner) * 0.5) * cell
    return np.clip(distance, -widest, widest)
