"""`pointsdf-ray`: PointSDF whose decoder also reads the evidence of the view around each query.

The paper squeezes the cloud through one 256-number embedding and asks a fully connected network
for everything. Here the embedding is kept (the grasp network reads it), and each query also gets

1. the ray evidence (`ray_evidence.py`): where it lies relative to the seen surface and silhouette;
2. local PointConv features of the centres around it, in space and in the image;
3. attention over the coarse centres, for what the rest of the object says about this place;
4. the same evidence at its symmetric point (`revolution.py`): the query turned about the cloud's
   axis of revolution, if it has one, to an observed azimuth;
5. what the view knows of the space around the object (`surroundings.py`).

Everything is normalised per sample (LayerNorm), so a value never depends on the batch.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import torch
from torch import Tensor, nn

from pointsdf_cli.models.box_frame import BOX_SIZE, BoxFrame, box_evidence, box_frame
from pointsdf_cli.models.decoder_parts import CentreAttention, LocalFeatures, ResidualBlock
from pointsdf_cli.models.linear import Linear, dense
from pointsdf_cli.models.neighbours import farthest_point_order, gather, nearest_neighbours
from pointsdf_cli.models.pointconv import PointConv
from pointsdf_cli.models.ray_evidence import EVIDENCE_SIZE, image_coordinates, ray_evidence
from pointsdf_cli.models.revolution import (
    TRUST_SIZE,
    Axis,
    places,
    revolution_axis,
    surface_normals,
    symmetric_points,
)
from pointsdf_cli.models.shape_model import Encoding, ShapeModel
from pointsdf_cli.models.surroundings import (
    SURROUNDINGS_SIZE,
    VISIBILITY_SIZE,
    Surroundings,
    no_surroundings,
    plane_evidence,
    visibility_evidence,
)

RADII = (0.1, 0.2, 0.35, 0.5)
"""Typical neighbourhood size of each PointConv layer, network units."""
OCTAVES = 4
"""Frequencies of the sines and cosines of a query's coordinates."""


class PointSDFRay(ShapeModel):
    """See the module's docstring.

    Args:
        centres: Centres of the four PointConv layers.
        neighbours: Neighbours in each.
        hidden: Width of each layer's mlp before the weight product.
        channels: Output width of each layer.
        width: Width of the decoder.
        blocks: Residual blocks of the decoder.
        local: Width of each local feature.
        heads: Heads of the attention over the third layer's centres.
        revolution: Whether the decoder reads the evidence at a query's symmetric point too.
        sideways: Preference of its axis, see `revolution_axis`.
        box: Whether the decoder also reads where a query lies in the box around the cloud (with
            `revolution` only).
        surroundings: Whether the decoder also reads what the view knows of the space around the
            object (`surroundings.py`), at the query and, with `revolution`, at its symmetric point.
        most_points: Most points that a reconstruction reads of a view: with few, two random samples
            of one view give different shapes.
    """

    architecture = "pointsdf-ray"
    completes_vessels = True
    frequencies: Tensor

    def __init__(
        self,
        centres: Sequence[int] = (256, 96, 32, 12),
        neighbours: Sequence[int] = (24, 16, 16, 16),
        hidden: Sequence[int] = (32, 64, 96, 128),
        channels: Sequence[int] = (64, 128, 192, 256),
        width: int = 256,
        blocks: int = 4,
        local: int = 64,
        heads: int = 4,
        revolution: bool = False,
        sideways: float = 0.0,
        box: bool = False,
        surroundings: bool = False,
        most_points: int = 1000,
    ) -> None:
        super().__init__()
        self.keep_arguments(locals())
        self.centres, self.neighbours = tuple(centres), tuple(neighbours)
        self.blocks, self.local = blocks, local
        self.revolution, self.sideways = revolution, sideways
        self.has_box, self.reads_surroundings = box, surroundings
        self.most_points = most_points
        self.packed_neighbours = (centres[0], neighbours[0])
        self._check()
        layer = partial(
            PointConv, weight_channels=8, weight_hidden=(16,), density=False, norm="layer"
        )
        sizes = zip((0, *channels[:-1]), hidden, channels, RADII, strict=True)
        self.layers = nn.ModuleList(
            layer(inputs, (mid, out), radius=radius) for inputs, mid, out, radius in sizes
        )
        embedded = [centres[-1] * channels[-1], self.embedding_size]
        self.to_embedding = dense(embedded, nn.LayerNorm, linear=Linear)
        self.local_fine = LocalFeatures(channels[0], local, radius=0.1)
        self.local_coarse = LocalFeatures(channels[1], local, radius=0.2)
        self.local_image = LocalFeatures(channels[1], local, radius=0.2)
        self.enter = Linear(self._input_size(), width)
        self.embed_first = Linear(self.embedding_size, width)
        self.embed_middle = Linear(self.embedding_size, width)
        self.attention = CentreAttention(width, channels[2], heads)
        self.trunk = nn.ModuleList(ResidualBlock(width) for _ in range(blocks))
        self.leave_norm = nn.LayerNorm(width)
        self.leave = Linear(width, 1)
        frequencies = 2.0 ** torch.arange(OCTAVES) * torch.pi
        self.register_buffer("frequencies", frequencies, persistent=False)

    def _check(self) -> None:
        for found, k in zip((self.cloud_size, *self.centres), self.neighbours, strict=False):
            if not 1 <= k <= found:
                raise ValueError(f"{k} neighbours of {found} points")
        if self.has_box and not self.revolution:
            raise ValueError("the box is read with the axis of revolution only")

    def _input_size(self) -> int:
        """Numbers that the decoder reads about a query."""
        size = 3 + 6 * OCTAVES + EVIDENCE_SIZE + 3 * self.local
        size += (TRUST_SIZE + EVIDENCE_SIZE + self.local) if self.revolution else 0
        size += BOX_SIZE if self.has_box else 0
        if self.reads_surroundings:
            size += SURROUNDINGS_SIZE + (VISIBILITY_SIZE if self.revolution else 0)
        return size

    def encode(
        self,
        cloud: Tensor,
        camera: Tensor,
        neighbours: Tensor | None = None,
        surroundings: Surroundings | None = None,
    ) -> Encoding:
        """Read the clouds.

        Args:
            cloud: [B, P, 3].
            camera: [B, 3].
            neighbours: int64 [B, M, K] of the first layer, where they are known already; the
                cloud's first M points must then be its farthest points, in order.
            surroundings: See `ShapeModel.encode`.
        """
        if neighbours is None:
            order = farthest_point_order(cloud, self.centres[0])
            points = gather(cloud, order)
            neighbours = nearest_neighbours(points, cloud, self.neighbours[0])
        else:
            points = cloud[:, : self.centres[0]]
        features = self.layers[0](cloud, None, points, neighbours)
        levels = [(points, features)]
        coarser = zip(list(self.layers)[1:], self.centres[1:], self.neighbours[1:], strict=True)
        for layer, count, k in coarser:
            # Farthest point orders are nested, so a coarser level is a prefix of the finer one.
            coarse = points[:, :count]
            features = layer(points, features, coarse, nearest_neighbours(coarse, points, k))
            points = coarse
            levels.append((points, features))
        (fine_at, fine), (coarse_at, coarse_features), (token_at, tokens), _ = levels
        cloud_image = image_coordinates(cloud, camera)
        evidence = {
            "cloud": cloud,
            "camera": camera,
            "cloud_image": cloud_image,
            # Separate tensors, because search trees are cached by tensor.
            "cloud_plane": cloud_image[..., :2].clone(),
            "fine_at": fine_at,
            "coarse_at": coarse_at,
            "coarse_plane": image_coordinates(coarse_at, camera)[..., :2].clone(),
            "fine": self.local_fine.table(fine, fine_at),
            "coarse": self.local_coarse.table(coarse_features, coarse_at),
            "image": self.local_image.table(coarse_features, coarse_at),
        }
        evidence |= self.attention.keys_and_values(tokens, token_at)
        if self.reads_surroundings:
            around = surroundings or no_surroundings(len(cloud), cloud.device)
            evidence |= {f"around_{name}": value for name, value in around._asdict().items()}
        if self.revolution:
            evidence |= self._symmetry(cloud, camera, fine_at, neighbours)
        return Encoding(self.to_embedding(features.flatten(1)), evidence)

    def _symmetry(
        self, cloud: Tensor, camera: Tensor, centres: Tensor, neighbours: Tensor
    ) -> dict[str, Tensor]:
        """Axis of revolution of each cloud, and the box about it."""
        with torch.autocast(cloud.device.type, enabled=False):
            normals = surface_normals(centres, neighbours, cloud, camera)
            axis = revolution_axis(centres, normals, camera, self.sideways)
            known = {f"axis_{name}": value for name, value in axis._asdict().items()}
            known["places"] = places(cloud, axis)
            if self.has_box:
                box = box_frame(normals, cloud, camera, axis)
                known |= {f"box_{name}": value for name, value in box._asdict().items()}
        return known

    def in_precision(self, encoding: Encoding, dtype: torch.dtype) -> Encoding:
        known = encoding.evidence
        tables = "fine", "coarse", "image", "keys", "values"
        return encoding._replace(evidence=known | {name: known[name].to(dtype) for name in tables})

    def decode(self, encoding: Encoding, x: Tensor) -> Tensor:
        known, count = encoding.evidence, x.shape[1]
        camera = known["camera"]
        with torch.autocast(x.device.type, enabled=False):
            angles = (x.unsqueeze(-1) * self.frequencies).flatten(-2)
            both = x
            if self.revolution:
                axis = _axis(known)
                symmetric, trust = symmetric_points(x, axis, known["cloud"], known["places"])
                # In one pass: operations on small tensors take a time of their own.
                both = torch.cat([x, symmetric], dim=1)
            both_image = image_coordinates(both, camera)
            seen = ray_evidence(
                both, both_image, known["cloud"], known["cloud_image"], known["cloud_plane"], camera
            )
        near = nearest_neighbours(both, known["fine_at"], 8)
        local = self.local_fine(both, known["fine"], near).to(x.dtype)
        near_coarse = nearest_neighbours(x, known["coarse_at"], 4)
        x_image = both_image[:, :count]
        near_image = nearest_neighbours(x_image[..., :2], known["coarse_plane"], 4)
        inputs = [
            x,
            torch.sin(angles),
            torch.cos(angles),
            seen[:, :count],
            local[:, :count],
            self.local_coarse(x, known["coarse"], near_coarse).to(x.dtype),
            self.local_image(x, known["image"], near_image).to(x.dtype),
        ]
        if self.revolution:
            inputs += [trust, seen[:, count:], local[:, count:]]
        with torch.autocast(x.device.type, enabled=False):
            if self.has_box:
                box = BoxFrame(*(known[f"box_{name}"] for name in BoxFrame._fields))
                inputs.append(box_evidence(x, box, _axis(known)))
            if self.reads_surroundings:
                around = Surroundings(*(known[f"around_{name}"] for name in Surroundings._fields))
                visible = visibility_evidence(both_image, camera, around)
                inputs += [visible[:, :count], plane_evidence(x, known["cloud"], around)]
                if self.revolution:
                    inputs.append(visible[:, count:])
        h = self.enter(torch.cat(inputs, dim=-1))
        h = h + self.embed_first(encoding.embedding).unsqueeze(1)
        for step, block in enumerate(self.trunk):
            if step == self.blocks // 2:
                h = h + self.embed_middle(encoding.embedding).unsqueeze(1)
                h = h + self.attention(h, known["keys"], known["values"])
            h = block(h)
        return self.leave(torch.nn.functional.gelu(self.leave_norm(h))).squeeze(-1).to(x.dtype)


def _axis(known: dict[str, Tensor]) -> Axis:
    return Axis(*(known[f"axis_{name}"] for name in Axis._fields))
