"""Views and labels of make_views.py in a GPU's memory, and the batches of each training step.

A batch is what `training/sdf_data.py` makes of a pack, by operations on the device: other points of
the view, mirrored and turned, with other labels and now and then without evidence. Every tensor
has the same shape in every step, so that CUDA graphs can record it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import kernels
import numpy as np
import torch
from make_views import LABELS, MOST_POINTS, UNKNOWN
from torch import Tensor

from pointsdf_cli.geometry.visibility import SIZE
from pointsdf_cli.models.box_frame import ALIGNMENT_SIZE, box_frame
from pointsdf_cli.models.neighbours import gather
from pointsdf_cli.models.normalise import MARGIN
from pointsdf_cli.models.revolution import Axis, revolution_axis, surface_normals
from pointsdf_cli.models.shape_model import PACKED_CENTRES, PACKED_NEIGHBOURS
from pointsdf_cli.models.surroundings import (
    FARTHEST,
    WIDEST,
    Surroundings,
    lower_plane,
    without_evidence,
)
from pointsdf_cli.training.sdf_data import FORGET_ALL, FORGET_IMAGE, HIGHEST, RAISED, Batch

CLOUD_SIZE = 1000
"""Points of a cloud, unless more are asked for."""
COLUMNS = {
    "points": ((MOST_POINTS, 3), torch.float16),
    "count": ((), torch.int32),
    "camera": ((3,), torch.float32),
    "to_network": ((3, 4), torch.float32),
    "scale": ((), torch.float32),
    "free": ((SIZE, SIZE), torch.float16),
    "regions": ((2, SIZE, SIZE), torch.float16),
    "window": ((4,), torch.float32),
    "plane": ((4,), torch.float32),
    "known": ((2,), torch.float32),
    "object": ((), torch.int32),
    "direction": ((3,), torch.float32),
    "axis_point": ((3,), torch.float32),
    "miss": ((), torch.float32),
    "spread": ((), torch.float32),
    "box_directions": ((3, 3), torch.float32),
    "alignment": ((ALIGNMENT_SIZE,), torch.float32),
}


class Symmetry(NamedTuple):
    """Axis of revolution and directions of the box of B views, found once a view."""

    axis: Axis
    directions: Tensor
    alignment: Tensor


class Views:
    """Views and labels on a device, filled while training goes on.

    Args:
        capacity: Most views.
        objects: Most objects.
        device: Device of the tensors.
        sideways: As in `revolution_axis`.
        sizes: Sizes of clouds that `draw` is asked for, the smallest first.
        samplings: Clouds of each size that come with each view; 0: each batch makes its own.
    """

    def __init__(
        self,
        capacity: int,
        objects: int,
        device: torch.device,
        sideways: float,
        sizes: Sequence[int] = (CLOUD_SIZE,),
        samplings: int = 0,
    ) -> None:
        self.device, self.capacity, self._sideways = device, capacity, sideways
        self.sizes, self._samplings = tuple(sizes), samplings
        columns = COLUMNS | (_sampling_columns(self.sizes, samplings) if samplings else {})
        self._rows = {
            name: torch.zeros((capacity, *shape), dtype=kind, device=device)
            for name, (shape, kind) in columns.items()
        }
        self._x = torch.zeros((objects, LABELS, 3), device=device)
        self._sdf = torch.zeros((objects, LABELS), device=device)
        self._centre = torch.zeros((objects, 3), device=device)
        self._is_labelled = np.zeros(objects, bool)
        self.count = 0
        # The views with enough points for each size; recorded steps read from how many they draw.
        self._enough = {
            size: torch.zeros(capacity, dtype=torch.int64, device=device) for size in self.sizes
        }
        self._counts = dict.fromkeys(self.sizes, 0)
        self._drawn_from = {size: torch.zeros((), device=device) for size in self.sizes}

    @torch.no_grad()
    def add(self, files: Sequence[Path]) -> None:
        """Read files; their views count when all of them are there."""
        parts = []
        for path in files:
            with np.load(path) as data:
                arrays = {name: data[name] for name in data.files}
            self._label(arrays)
            parts.append(arrays)
        self.add_arrays(parts)

    @torch.no_grad()
    def add_arrays(self, parts: Sequence[dict[str, np.ndarray]]) -> None:
        """Add views whose objects have labels."""
        labelled = self._is_labelled[np.concatenate([p["object"] for p in parts])]
        room = self.capacity - self.count
        new = slice(self.count, self.count + min(room, int(labelled.sum())))
        if new.stop == new.start:
            return
        for name, rows in self._rows.items():
            if name in parts[0]:
                values = np.concatenate([p[name] for p in parts])[labelled][:room]
                rows[new] = torch.from_numpy(values).to(self.device)
        self._find_symmetry(new)
        for size in self.sizes:
            views = new.start + self._fits(size, new).nonzero()[:, 0]
            end = self._counts[size] + len(views)
            self._enough[size][self._counts[size] : end] = views
            self._counts[size] = end
        if self.device.type == "cuda":
            torch.cuda.current_stream().synchronize()
        self.count = new.stop

    def _label(self, arrays: dict[str, np.ndarray]) -> None:
        """Signed distances of objects that have none yet."""
        if "label_object" not in arrays:
            return
        ends = np.cumsum(arrays["label_faces"])
        for row, number in enumerate(arrays["label_object"]):
            if number >= len(self._is_labelled):
                raise IndexError(f"object {number} of {len(self._is_labelled)} in the recipe")
            if not self._is_labelled[number]:
                x = torch.from_numpy(arrays["label_points"][row]).to(self.device)
                if "label_sdf" in arrays:
                    self._sdf[number] = torch.from_numpy(arrays["label_sdf"][row])
                else:
                    first = ends[row] - arrays["label_faces"][row]
                    triangles = torch.from_numpy(arrays["label_triangles"][first : ends[row]])
                    self._sdf[number] = kernels.signed_distance(x, triangles.to(self.device))
                self._x[number] = x
                self._centre[number] = torch.from_numpy(arrays["label_centre"][row])
                self._is_labelled[number] = True

    def _find_symmetry(self, new: slice) -> None:
        """Axes and boxes: eigenvectors of small matrices are slow on GPUs, and hardly depend on
        which of a view's points a step draws."""
        rows, camera = self._rows, self._rows["camera"][new]
        views = torch.arange(new.start, new.stop, device=self.device)
        cloud, neighbours = self._clouds(views, self.sizes[0])
        centres = cloud[:, :PACKED_CENTRES]
        normals = surface_normals(centres, neighbours, cloud, camera)
        axis = revolution_axis(centres, normals, camera, self._sideways)
        box = box_frame(normals, cloud, camera, axis)
        rows["direction"][new], rows["axis_point"][new] = axis.direction, axis.point
        rows["miss"][new], rows["spread"][new] = axis.miss, axis.spread
        rows["box_directions"][new] = box.directions
        rows["alignment"][new] = box.trust[:, :ALIGNMENT_SIZE]

    def refresh(self) -> None:
        """Let `draw` draw from all views that are there by now."""
        for size in self.sizes:
            self._drawn_from[size].fill_(float(self._counts[size]))

    def drawn_sizes(self) -> list[int]:
        """The sizes of clouds for which there are views."""
        return [size for size in self.sizes if self._counts[size]]

    def draw(self, batch_size: int, size: int = CLOUD_SIZE) -> Tensor:
        """Random views with enough points for clouds of a size, int64 [B]."""
        row = (torch.rand(batch_size, device=self.device) * self._drawn_from[size]).long()
        return self._enough[size][row]

    def of_size(self, size: int) -> Tensor:
        """The views whose largest of `sizes` this is, int64 [N]."""
        here = slice(0, self.count)
        mine = self._fits(size, here)
        for larger in self.sizes[self.sizes.index(size) + 1 :]:
            mine = mine & ~self._fits(larger, here)
        return mine.nonzero()[:, 0]

    def _fits(self, size: int, views: slice) -> Tensor:
        """Whether views have enough points for a size, bool [N]; for the smallest all have."""
        return self._rows["count"][views] >= (0 if size == self.sizes[0] else size)

    def _clouds(self, views: Tensor, size: int) -> tuple[Tensor, Tensor]:
        """Clouds [B, size, 3] of views, their farthest points first, and the neighbours of these
        [B, M, K]."""
        if not self._samplings:
            return _first_layer(self._sample(views, size))
        drawn = (torch.rand(len(views), device=self.device) * self._samplings).long()
        index = self._rows[f"indices{size}"][views, drawn].long()
        cloud = gather(self._rows["points"][views].float(), index)
        return cloud, self._rows[f"neighbours{size}"][views, drawn].long()

    def _sample(self, views: Tensor, size: int = CLOUD_SIZE) -> Tensor:
        """Points [B, size, 3] of each view, as `systematic_sample` takes them."""
        total = self._rows["count"][views].float()[:, None]
        step = torch.arange(size, device=self.device).float()[None]
        start = torch.rand(len(views), 1, device=self.device)
        again = torch.rand(len(views), size, device=self.device)
        even = ((step + start) * (total / size)).floor()
        few = torch.where(step < total, step, (again * total).floor())
        index = torch.where(total < size, few, even).minimum(total - 1).long()
        points = self._rows["points"][views].float()
        return points.gather(1, index[..., None].expand(-1, -1, 3))

    def batch(
        self,
        views: Tensor,
        queries: int,
        augment: bool = True,
        evidence: bool | None = None,
        size: int = CLOUD_SIZE,
    ) -> tuple[Batch, Symmetry]:
        """A batch of the views [B] with `queries` labels each, and their symmetry.

        Args:
            views: int64 [B], numbers of views.
            queries: Labels of each.
            augment: Mirror and turn the views, and lower their planes.
            evidence: Whether the space around the objects is known; None: as in training.
            size: Points of each cloud.
        """
        rows = {name: self._rows[name][views] for name in COLUMNS if name != "points"}
        count, device = len(views), self.device
        (cloud, neighbours), turn = self._clouds(views, size), self._turns(count, augment)
        back = turn.transpose(1, 2)
        cloud = cloud @ back
        low, high = cloud.amin(1, keepdim=True), cloud.amax(1, keepdim=True)
        centre, scale = (low + high) / 2.0, 1.0 / (MARGIN * (high - low).amax(-1, keepdim=True))

        objects = rows["object"].long()
        picked = (torch.rand(count, queries, device=device) * LABELS).long().clamp(max=LABELS - 1)
        x = self._x[objects[:, None], picked] + self._centre[objects][:, None]
        x = x @ rows["to_network"][:, :, :3].transpose(1, 2) + rows["to_network"][:, None, :, 3]
        sdf = self._sdf[objects[:, None], picked] * (rows["scale"] * scale[:, 0, 0])[:, None]

        cloud = (cloud - centre) * scale
        camera = ((rows["camera"][:, None] @ back - centre) * scale)[:, 0]
        around = _surroundings(rows, turn, centre[:, 0], scale[:, 0, 0], camera)
        has_image, has_plane = rows["known"].bool().unbind(1)
        if evidence is None:
            lost = torch.rand(count, device=device)
            has_image, has_plane = (
                has_image & (lost > FORGET_IMAGE),
                has_plane & (lost > FORGET_ALL),
            )
        elif not evidence:
            has_image, has_plane = torch.zeros_like(has_image), torch.zeros_like(has_plane)
        around = without_evidence(around, has_image, has_plane)
        if augment:
            raised = (torch.rand(count, device=device) < RAISED).float()
            around = lower_plane(around, raised * HIGHEST * torch.rand(count, device=device))
        x = (x @ back - centre) * scale
        symmetry = _turned_symmetry(rows, turn, centre[:, 0], scale[:, 0])
        return Batch(cloud, camera, neighbours, x, sdf, around), symmetry

    def _turns(self, count: int, augment: bool) -> Tensor:
        """Rotations about the optical axis [B, 3, 3], half of them mirrored; or none."""
        turn = torch.eye(3, device=self.device).repeat(count, 1, 1)
        if augment:
            angle = 2.0 * math.pi * torch.rand(count, device=self.device)
            mirror = (torch.rand(count, device=self.device) < 0.5).float() * 2.0 - 1.0
            turn[:, 0, 0], turn[:, 0, 1] = angle.cos() * mirror, -angle.sin()
            turn[:, 1, 0], turn[:, 1, 1] = angle.sin() * mirror, angle.cos()
        return turn


def _sampling_columns(
    sizes: Sequence[int], samplings: int
) -> dict[str, tuple[tuple[int, ...], torch.dtype]]:
    """The columns of `make_views.sampled`."""
    shapes = {f"indices{size}": (samplings, size) for size in sizes}
    nearest = (samplings, PACKED_CENTRES, PACKED_NEIGHBOURS)
    every = shapes | {f"neighbours{size}": nearest for size in sizes}
    return {name: (shape, torch.int16) for name, shape in every.items()}


def _first_layer(cloud: Tensor) -> tuple[Tensor, Tensor]:
    """Clouds with their farthest points first, and the neighbours of these [B, M, K]."""
    count, total = cloud.shape[:2]
    rank = torch.arange(total, 2 * total, device=cloud.device).repeat(count, 1)
    first = torch.arange(PACKED_CENTRES, device=cloud.device).expand(count, -1)
    rank.scatter_(1, kernels.farthest_first(cloud, PACKED_CENTRES), first)
    cloud = gather(cloud, rank.argsort(dim=1))
    return cloud, kernels.nearest(cloud[:, :PACKED_CENTRES], cloud, PACKED_NEIGHBOURS)


def _surroundings(
    rows: dict[str, Tensor], turn: Tensor, centre: Tensor, scale: Tensor, camera: Tensor
) -> Surroundings:
    """The evidence after x → (R x − c) · s, as `surroundings_arrays` of the new frame gives it; the
    region of wholly free rays stays that of the view's own frame."""
    free, window = rows["free"].float(), rows["window"]
    unknown = free < UNKNOWN / 2
    depth = (free - centre[:, 2].view(-1, 1, 1)) * scale.view(-1, 1, 1)
    depth = torch.where(unknown, -FARTHEST, depth.clamp(-FARTHEST, FARTHEST))
    size, reference = window[:, 2:].clamp(min=1e-6), -camera[:, 2:]
    cell = (size[:, :1] / SIZE * reference).view(-1, 1, 1, 1)
    regions = (rows["regions"].float() * cell).clamp(-WIDEST, WIDEST)
    linear = torch.diag_embed(2.0 / (size * reference)) @ turn[:, :2, :2].transpose(1, 2)
    shift = -2.0 * window[:, :2] / size - 1.0
    normal = (turn @ rows["plane"][:, :3, None]).squeeze(-1)
    offset = (rows["plane"][:, 3] - (normal * centre).sum(-1)) * scale
    return Surroundings(
        torch.cat([depth[:, None], regions, unknown.float()[:, None]], dim=1),
        torch.cat([linear, shift[..., None]], dim=-1),
        torch.cat([normal, offset[:, None]], dim=-1),
        rows["known"],
    )


def _turned_symmetry(
    rows: dict[str, Tensor], turn: Tensor, centre: Tensor, scale: Tensor
) -> Symmetry:
    """Axis and box of each view after x → (R x − c) · s."""
    direction = (turn @ rows["direction"][..., None]).squeeze(-1)
    point = ((turn @ rows["axis_point"][..., None]).squeeze(-1) - centre) * scale
    point = point - (point * direction).sum(-1, keepdim=True) * direction
    axis = Axis(direction, point, rows["miss"] * scale[:, 0], rows["spread"])
    return Symmetry(axis, rows["box_directions"] @ turn.transpose(1, 2), rows["alignment"])
