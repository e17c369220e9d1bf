"""Batches for `train-sdf`: packed views, random queries, mirrored and rotated on the fly.

`sdf_pack.py` turns the view and label artifacts into memory-mapped arrays once; here they are read
a batch at a time. The batch of a step is a pure function of (seed, step), so a resumed run sees
exactly the batches that an uninterrupted one would have seen.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pointsdf_cli.errors import InputError
from pointsdf_cli.models.normalise import MARGIN
from pointsdf_cli.models.shape_model import ShapeModel
from pointsdf_cli.models.surroundings import (
    Surroundings,
    lower_plane,
    transformed,
    without_evidence,
)
from pointsdf_cli.training.sdf_pack import SURROUNDINGS, Pack

FORGET_IMAGE, FORGET_ALL = 0.5, 0.4
"""Share of training views that keep no visibility image, and of those that keep no plane either."""
RAISED, HIGHEST = 0.2, 1.0
"""Share of training views whose support plane lies lower by up to so much [network units]: the
object may rest on another one."""


class Batch(NamedTuple):
    """B clouds with Q labelled queries each, all in the network's frame.

    Attributes:
        cloud: f4 [B, P, 3], farthest points first.
        camera: f4 [B, 3].
        neighbours: int64 [B, M, K] of the first encoder layer.
        x: f4 [B, Q, 3].
        sdf: f4 [B, Q], network units, negative inside.
        around: Evidence about the space around the objects.
    """

    cloud: Tensor
    camera: Tensor
    neighbours: Tensor
    x: Tensor
    sdf: Tensor
    around: Surroundings

    def to(self, device: torch.device) -> Batch:
        """The same batch on a device."""
        return self._each(lambda t: t.to(device, non_blocking=True))

    def rows(self, first: int, last: int) -> Batch:
        """Clouds `first` to `last` − 1 of the batch."""
        return self._each(lambda t: t[first:last])

    def _each(self, change: Callable[[Tensor], Tensor]) -> Batch:
        around = Surroundings(*map(change, self.around))
        changed = {name: change(getattr(self, name)) for name in self._fields if name != "around"}
        return Batch(**changed, around=around)


class Split(NamedTuple):
    """Split of a pack's views; indices into the pack's views.

    Attributes:
        train: Trained on.
        held_out_objects: All views of objects that are never trained on.
        held_out_views: The first view of some training objects: the same one however many views
            an object a run uses.
    """

    train: NDArray[np.int64]
    held_out_objects: NDArray[np.int64]
    held_out_views: NDArray[np.int64]


def split_views(
    pack: Pack, share: float, seed: int, held_before: Collection[str] = (), most: int = 512
) -> Split:
    """Hold out a share of the objects, and one view of as many training objects.

    Args:
        pack: The data.
        share: Share of the objects, in (0, 1); at least one is held out.
        seed: Random seed of the split.
        held_before: Objects held out when the initial weights were trained. If the data has any,
            exactly these are held out and `share` is ignored: the weights may have been trained on
            the others.
        most: At most so many views validate, spread over all held-out objects.

    Raises:
        InputError: Fewer than two objects.
    """
    # An object is a mesh: rendered twice it has two names, and is known by either.
    number = {mesh: k for k, mesh in enumerate(dict.fromkeys(pack.meshes))}
    mesh_of = np.array([number[mesh] for mesh in pack.meshes])
    total = len(number)
    if total < 2:
        raise InputError(
            f"{total} object: one is needed to train and another to validate",
            where="--views",
            hint="render more meshes",
        )
    rng = np.random.default_rng([seed, 0])
    order = rng.permutation(total)
    before = np.isin(order, mesh_of[np.isin(pack.names, list(held_before))])
    order = np.concatenate([order[before], order[~before]])
    held_out = min(total - 1, int(before.sum()) or max(1, round(share * total)))
    is_held_out = np.isin(mesh_of[pack.object_of_view], order[:held_out])
    validating = np.flatnonzero(is_held_out)
    if len(validating) > most:
        validating = validating[np.linspace(0, len(validating) - 1, most).astype(int)]
    known = np.flatnonzero(~is_held_out)
    objects = pack.object_of_view[known]
    is_first = np.insert(objects[1:] != objects[:-1], 0, True)
    is_only = is_first & np.append(objects[1:] != objects[:-1], True)
    first = known[is_first & ~is_only]
    other_views = np.sort(rng.permutation(first)[: max(1, min(most // 2, round(len(first) * 0.5)))])
    return Split(np.setdiff1d(known, other_views), validating, other_views)


def held_out_names(pack: Pack, split: Split) -> list[str]:
    """Names of the objects of which no view is trained on."""
    taught = np.unique(pack.object_of_view[split.train])
    return sorted(np.delete(np.asarray(pack.names, dtype=object), taught))


def read_batch(
    pack: Pack, views: NDArray[np.int64], queries: int, rng: np.random.Generator
) -> Batch:
    """The views `views` of the pack, each with `queries` labelled points drawn from its object."""
    objects = pack.object_of_view[views]
    first, last = pack.label_start[objects, None], pack.label_start[objects + 1, None]
    picked = rng.integers(first, last, size=(len(views), queries))
    points = pack.points[picked]
    to_network = pack.to_network[views]
    x = points @ to_network[:, :, :3].transpose(0, 2, 1) + to_network[:, None, :, 3]
    sdf = pack.sdf[picked] * pack.scale[views][:, None]
    cloud, camera = _tensor(pack.clouds[views]), _tensor(pack.cameras[views])
    neighbours = torch.from_numpy(pack.neighbours[views].astype(np.int64))
    around = Surroundings(*(_tensor(getattr(pack, name)[views]) for name in SURROUNDINGS))
    return Batch(cloud, camera, neighbours, _tensor(x), _tensor(sdf), around)


def _tensor(array: NDArray[np.floating]) -> Tensor:
    return torch.from_numpy(array.astype(np.float32))


def augment(batch: Batch, rng: np.random.Generator) -> Batch:
    """Mirror and turn each view about the optical axis, camera and labels with it.

    A turned partial cloud has another bounding box, so it is centred and scaled anew. Of some views
    the evidence about the space around the object is left out: a bare cloud has none.
    """
    count = len(batch.cloud)
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    mirror = rng.choice([-1.0, 1.0], count)
    turn = np.zeros((count, 3, 3), np.float32)
    turn[:, 0, 0], turn[:, 0, 1] = np.cos(angle) * mirror, -np.sin(angle)
    turn[:, 1, 0], turn[:, 1, 1] = np.sin(angle) * mirror, np.cos(angle)
    turn[:, 2, 2] = 1.0
    rotation = torch.from_numpy(turn).transpose(1, 2)
    cloud = torch.bmm(batch.cloud, rotation)
    low, high = cloud.amin(1, keepdim=True), cloud.amax(1, keepdim=True)
    centre = (low + high) / 2.0
    scale = 1.0 / (MARGIN * (high - low).amax(-1, keepdim=True))
    # Free rays are clipped at one depth for every scale. Rotations about the optical axis keep
    # depths, the centre's to within rounding.
    around = transformed(batch.around, torch.from_numpy(turn), centre[:, 0], scale[:, 0, 0])
    lost = torch.from_numpy(rng.random(count))
    around = without_evidence(around, lost > FORGET_IMAGE, lost > FORGET_ALL)
    raised = np.where(rng.random(count) < RAISED, rng.uniform(0.0, HIGHEST, count), 0.0)
    around = lower_plane(around, torch.from_numpy(raised))
    return batch._replace(
        around=around,
        cloud=(cloud - centre) * scale,
        camera=((torch.bmm(batch.camera.unsqueeze(1), rotation) - centre) * scale).squeeze(1),
        x=(torch.bmm(batch.x, rotation) - centre) * scale,
        sdf=batch.sdf * scale.squeeze(-1),
    )


def training_views(
    views: NDArray[np.int64], batch_size: int, step: int, seed: int
) -> NDArray[np.int64]:
    """The views of one step: every epoch goes through them in its own order, none twice; what does
    not fill a last batch is left out of that epoch."""
    per_epoch = max(1, len(views) // batch_size)
    epoch, place = divmod(step, per_epoch)
    order = _epoch_order(len(views), epoch, seed)
    return np.sort(views[order[place * batch_size : (place + 1) * batch_size]])


@lru_cache(maxsize=1)
def _epoch_order(count: int, epoch: int, seed: int) -> NDArray[np.int64]:
    return np.random.default_rng([seed, 1, epoch]).permutation(count)


def predict(model: ShapeModel, batch: Batch) -> Tensor:
    """Signed distances [B, Q] of a batch, with the packed neighbours where the model takes them."""
    if model.packed_neighbours is None:
        return model(batch.cloud, batch.camera, batch.x)
    centres, count = model.packed_neighbours
    neighbours = batch.neighbours[:, :centres, :count]
    encoding = model.encode(batch.cloud, batch.camera, neighbours, batch.around)
    return model.decode(encoding, batch.x)
