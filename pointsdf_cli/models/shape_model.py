"""Interface of every reconstruction network.

    encoding = model.encode(cloud, camera)      once a cloud
    s = model.decode(encoding, x)               for as many query points as needed

All in the network's frame (`normalise.py`); `reconstruction.py` is the interface in metres.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import torch
from torch import Tensor, nn

from pointsdf_cli.models.rebuildable import Rebuildable
from pointsdf_cli.models.surroundings import Surroundings

PACKED_CENTRES, PACKED_NEIGHBOURS = 256, 24
"""Packed training data for an encoder's first layer: centres, and neighbours of each."""


def has_batch_norm(model: nn.Module) -> bool:
    """Whether the model has batch normalisation: training batches then need two clouds or more."""
    kinds = (nn.BatchNorm1d, nn.BatchNorm2d, nn.BatchNorm3d)
    return any(isinstance(module, kinds) for module in model.modules())


class Encoding(NamedTuple):
    """Encoding of a batch of clouds for the decoder.

    Attributes:
        embedding: [B, 256], the shape embedding, also input of the grasp network.
        evidence: Further inputs of this architecture's decoder; tensors with first axis B.
    """

    embedding: Tensor
    evidence: dict[str, Tensor]


class ShapeModel(Rebuildable, ABC):
    """A network f(o, x) = s: partial cloud o, query x, signed distance s, negative inside."""

    architecture: str = ""
    box: float = 0.8
    """Half the side of the box about the origin that holds the surface."""
    gives_distances: bool = True
    """Whether the values are distances; otherwise only their sign is right."""
    completes_vessels: bool = False
    """Whether reconstructions complete vessels by their axis; the published networks' do not."""
    embedding_size: int = 256
    cloud_size: int = 1000
    """Points of a cloud in training; smaller clouds are filled up with repeats."""
    most_points: int = 1000
    """Most points that a reconstruction reads of a view."""
    packed_neighbours: tuple[int, int] | None = None
    """(M, K) if `encode` uses `neighbours`, those of the first layer: int64 [B, M, K]."""

    encoder_parts: tuple[str, ...] = ("layers", "to_embedding")
    """Submodules that compute the embedding."""

    def embed(self, cloud: Tensor, camera: Tensor, neighbours: Tensor | None = None) -> Tensor:
        """Embedding [B, 256] alone, for the inputs of `encode`."""
        return self.encode(cloud, camera, neighbours).embedding

    def begin_with(self, other: ShapeModel) -> None:
        """Copy the weights of a trained model of this architecture.

        Raises:
            RuntimeError: Its weights have other shapes.
        """
        self.load_state_dict(other.state_dict())

    @abstractmethod
    def encode(
        self,
        cloud: Tensor,
        camera: Tensor,
        neighbours: Tensor | None = None,
        surroundings: Surroundings | None = None,
    ) -> Encoding:
        """Encode a batch of clouds.

        Args:
            cloud: [B, P, 3], network frame.
            camera: [B, 3], the camera's centre in the network's frame.
            neighbours: See `packed_neighbours`; searched if None.
            surroundings: Observed space around the objects, for architectures that read it; ignored
                if None.
        """

    def in_precision(self, encoding: Encoding, dtype: torch.dtype) -> Encoding:
        """The encoding with its product tables in `dtype`, as autocast would convert them; geometry
        is unchanged."""
        return encoding

    @abstractmethod
    def decode(self, encoding: Encoding, x: Tensor) -> Tensor:
        """Signed distances, differentiable in x.

        Args:
            encoding: Encoding of B clouds.
            x: [B, Q, 3], network frame.

        Returns:
            [B, Q] in network units, negative inside.
        """

    def forward(self, cloud: Tensor, camera: Tensor, x: Tensor) -> Tensor:
        """Evaluate `decode(encode(cloud, camera), x)`."""
        return self.decode(self.encode(cloud, camera), x)
