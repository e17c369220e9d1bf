"""Inputs of the success networks as tensors: one row a grasp, ready for batches.

`FixedInputs` holds the network's inputs: nothing before it is trained. `CloudInputs` holds the
clouds, one a scene, and an encoder that is trained too.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.grasp_evidence import Evidence
from pointsdf_cli.models.grasp_features import GraspFeatures, ObjectBody
from pointsdf_cli.models.grasp_success import EmbeddingNet, GeometryNet, grasp_numbers
from pointsdf_cli.models.normalise import network_frame
from pointsdf_cli.models.shape_model import ShapeModel, has_batch_norm
from pointsdf_cli.training.gs_data import GraspData
from pointsdf_cli.training.sdf_pack import pack_views

Index = NDArray[np.int64]

EVALUATED = 256
"""Number of clouds encoded at once in evaluation."""

SHAKE = 0.3
"""Largest rotation [rad] of clouds and palms about the optical axis, for augmentation."""


class Learner(ABC):
    """A network with the inputs of all grasps.

    Attributes:
        modules: Trained modules: `network`, and the parts of an `encoder` that is trained too.
    """

    modules: nn.ModuleDict

    @abstractmethod
    def training_logits(self, index: Index, rng: np.random.Generator) -> Tensor:
        """Raw logits [M, n] of the M members for grasps `index` [n], with gradients."""

    @abstractmethod
    def logits(self, index: Index) -> NDArray[np.float64]:
        """Raw logits [n] in evaluation mode."""

    def validation_logits(self, index: Index) -> NDArray[np.float64]:
        """Raw logits [n] by members that were not trained on these grasps."""
        return self.logits(index)

    def member_weights(self, index: Index) -> Tensor:
        """Weights [M or 1, n] of the grasps in each member's loss."""
        return torch.ones(1, len(index))

    @abstractmethod
    def pose_and_size(self) -> tuple[Tensor, Tensor]:
        """Inputs of a network on embeddings: grasp numbers [N, K + 9] and cloud sizes [N, 3]."""


class FixedInputs(Learner):
    """Inputs that do not depend on trained parameters.

    Members of a `GeometryNet` can be trained on different objects: fold m is excluded from the
    training of member m and validates it, so that every object serves for both.

    Args:
        network: Network of either kind.
        columns: Arguments of its `forward`, each with N rows.
        folds: [N], the member that each grasp validates; None if all learn from all.
        mirrors: Mirror images of the features, `GraspFeatures.mirrored`; in training, half of the
            grasps are replaced by each, at random.
    """

    def __init__(
        self,
        network: EmbeddingNet | GeometryNet,
        *columns: Tensor,
        folds: NDArray[np.int64] | None = None,
        mirrors: Sequence[tuple[Tensor, Tensor]] = (),
    ) -> None:
        self.network, self.columns, self.folds = network, columns, folds
        self._mirrors = tuple(mirrors)
        self.modules = nn.ModuleDict({"network": network})

    def pose_and_size(self) -> tuple[Tensor, Tensor]:
        return self.columns[0], self.columns[2]

    def training_logits(self, index: Index, rng: np.random.Generator) -> Tensor:
        rows = [column[index] for column in self.columns]
        if not isinstance(self.network, GeometryNet):
            return self.network(*rows)[None]
        (features,) = rows
        for place, sign in self._mirrors:
            image = torch.from_numpy(rng.random(len(index)) < 0.5)[:, None]
            features = torch.where(image, features[:, place] * sign, features)
        return self.network.members(features)

    @torch.no_grad()
    def logits(self, index: Index) -> NDArray[np.float64]:
        self.modules.eval()
        return self.network(*(c[index] for c in self.columns)).double().numpy()

    @torch.no_grad()
    def validation_logits(self, index: Index) -> NDArray[np.float64]:
        if self.folds is None or not isinstance(self.network, GeometryNet):
            return self.logits(index)
        self.modules.eval()
        each = self.network.members(*(c[index] for c in self.columns))
        return each[self.folds[index], torch.arange(len(index))].double().numpy()

    def member_weights(self, index: Index) -> Tensor:
        if self.folds is None or not isinstance(self.network, GeometryNet):
            return super().member_weights(index)
        members = torch.arange(self.network.member_count)
        return (members[:, None] != torch.from_numpy(self.folds[index])).float()


class CloudInputs(Learner):
    """A trained encoder with the clouds of all scenes.

    Args:
        network: Network on the embedding.
        encoder: Encoder; only the modules of the embedding are trained.
        data: The grasps; each scene's cloud is that of its first grasp.
        low_precision: Type for autocast in the encoder; None for float32.
    """

    def __init__(
        self,
        network: EmbeddingNet,
        encoder: ShapeModel,
        data: GraspData,
        low_precision: torch.dtype | None,
    ) -> None:
        self.network, self.encoder, self.low_precision = network, encoder, low_precision
        encoder.requires_grad_(False)
        parts = {part: getattr(encoder, part) for part in encoder.encoder_parts}
        trained = nn.ModuleDict(parts).requires_grad_(True)
        self.modules = nn.ModuleDict({"network": network, "encoder": trained})
        first = np.unique(data.scene_of, return_index=True)[1]
        clouds = data.cloud[first]
        packed = pack_views(clouds, np.tile(np.eye(4), (len(first), 1, 1)))
        self._clouds = torch.from_numpy(packed["clouds"])
        self._cameras = torch.from_numpy(packed["cameras"])
        self._neighbours = packed["neighbours"]
        self._scene = data.scene_of
        frames = [network_frame(cloud) for cloud in clouds]
        centre = np.array([frames[s].centre for s in data.scene_of])
        scale = np.array([frames[s].scale for s in data.scene_of])
        self._numbers, self._size = pose_numbers(data, centre, scale)

    def pose_and_size(self) -> tuple[Tensor, Tensor]:
        return self._numbers, self._size

    def training_logits(self, index: Index, rng: np.random.Generator) -> Tensor:
        scenes, back = np.unique(self._scene[index], return_inverse=True)
        if len(scenes) < 2 and has_batch_norm(self.encoder):
            raise InputError(
                f"{len(index)} grasps of one scene make a batch: {self.encoder.architecture} has "
                "batch norm, which compares clouds",
                where="--batch-size",
                allowed="more grasps than of one scene",
            )
        angle = torch.from_numpy(rng.uniform(-SHAKE, SHAKE, len(scenes)).astype(np.float32))
        turn = _about_z(angle)
        embedding = self._embed(scenes, turn)[back]
        numbers = turn_numbers(self._numbers[index], turn[back])
        return self.network(numbers, embedding, self._size[index])[None]

    @torch.no_grad()
    def logits(self, index: Index) -> NDArray[np.float64]:
        self.modules.eval()
        scenes, back = np.unique(self._scene[index], return_inverse=True)
        parts = [
            self._embed(scenes[start : start + EVALUATED], None)
            for start in range(0, len(scenes), EVALUATED)
        ]
        embedding = torch.cat(parts)[back]
        found = self.network(self._numbers[index], embedding, self._size[index])
        return found.double().numpy()

    def _embed(self, scenes: Index, turn: Tensor | None) -> Tensor:
        cloud, camera = self._clouds[scenes].float(), self._cameras[scenes].float()
        if turn is not None:
            cloud = cloud @ turn.transpose(1, 2)
            camera = (turn @ camera[:, :, None]).squeeze(-1)
        neighbours = None
        if self.encoder.packed_neighbours is not None:
            centres, count = self.encoder.packed_neighbours
            chosen = self._neighbours[scenes, :centres, :count].astype(np.int64)
            neighbours = torch.from_numpy(chosen)
        low = self.low_precision
        with torch.autocast("cpu", low, enabled=low is not None):
            return self.encoder.embed(cloud, camera, neighbours).float()


def geometry_features(data: GraspData, evidence: Evidence, features: GraspFeatures) -> Tensor:
    """Features [N, F] of all grasps from cached distances."""
    preshape, palm = torch.tensor(data.preshape), torch.tensor(data.T_world_palm)
    body = torch.from_numpy(evidence.body)
    parts = []
    for rows in torch.arange(len(data)).split(1024):
        points = features.points(preshape[rows], palm[rows])
        of_rows = ObjectBody(body[rows, :3], body[rows, 3:6], body[rows, 6:])
        distance = torch.from_numpy(evidence.distance)[rows]
        parts.append(features.assemble(preshape[rows], palm[rows], of_rows, points, distance))
    return torch.cat(parts)


def embedding_columns(data: GraspData, evidence: Evidence) -> tuple[Tensor, Tensor, Tensor]:
    """Inputs of `EmbeddingNet`: grasp numbers [N, K + 9], embeddings [N, E], sizes [N, 3]."""
    to_camera = data.T_world_camera[:, :3, :3].transpose(0, 2, 1)
    offset = evidence.centre - data.T_world_camera[:, :3, 3]
    centre = np.einsum("nij,nj->ni", to_camera, offset)
    numbers, _ = pose_numbers(data, centre, evidence.scale)
    return numbers, torch.from_numpy(evidence.embedding), torch.from_numpy(evidence.size)


def pose_numbers(
    data: GraspData, centre: NDArray[np.float64], scale: NDArray[np.float64]
) -> tuple[Tensor, Tensor]:
    """Grasp numbers [N, K + 9] in the network's frame of each cloud, and clouds' sizes [N, 3] m.

    Args:
        data: The grasps.
        centre: [N, 3], the network frame's origin in the camera's frame, m.
        scale: [N], network units per metre.
    """
    to_camera = data.T_world_camera[:, :3, :3].transpose(0, 2, 1)
    pose = np.tile(np.eye(4), (len(data), 1, 1))
    pose[:, :3, :3] = to_camera @ data.T_world_palm[:, :3, :3]
    offset = data.T_world_palm[:, :3, 3] - data.T_world_camera[:, :3, 3]
    pose[:, :3, 3] = (np.einsum("nij,nj->ni", to_camera, offset) - centre) * scale[:, None]
    numbers = grasp_numbers(torch.tensor(data.preshape), torch.tensor(pose)).float()
    return numbers, torch.from_numpy(np.ptp(data.cloud, axis=1).astype(np.float32))


def turn_numbers(numbers: Tensor, turn: Tensor) -> Tensor:
    """Rotate the palms in grasp numbers [n, K + 9] by [n, 3, 3] about the object frame's origin."""
    joints = numbers.shape[1] - 9
    vectors = numbers[:, joints:].unflatten(1, (3, 3))  # place and two columns, as rows
    turned = vectors @ turn.transpose(1, 2)
    return torch.cat([numbers[:, :joints], turned.flatten(1)], dim=1)


def _about_z(angle: Tensor) -> Tensor:
    """Rotations [n, 3, 3] about z."""
    c, s, zero = torch.cos(angle), torch.sin(angle), torch.zeros_like(angle)
    rows = torch.stack([c, -s, zero, s, c, zero, zero, zero, zero + 1], dim=1)
    return rows.unflatten(1, (3, 3))
