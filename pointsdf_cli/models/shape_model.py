"""Interface of every reconstruction network.

    encoding = model.encode(cloud, camera)      once a cloud
    s = model.decode(encoding, x)               for as many query points as needed

All of it in the network's frame (`normalise.py`); `reconstruction.py` is the door in metres.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from pointsdf_cli.models.surroundings import Surroundings

PACKED_CENTRES, PACKED_NEIGHBOURS = 256, 24
"""Packed training data for an encoder's first layer: centres, and neighbours of each."""


def has_batch_norm(model: nn.Module) -> bool:
    """Whether training compares the clouds of a batch, of which there must then be two."""
    kinds = (nn.BatchNorm1d, nn.BatchNorm2d, nn.BatchNorm3d)
    return any(isinstance(module, kinds) for module in model.modules())


class Encoding(NamedTuple):
    """One batch of clouds as the decoder needs them.

    Attributes:
        embedding: [B, 256], the shape embedding (what the grasp network reads).
        evidence: Further inputs of this architecture's decoder; tensors whose first axis is B.
    """

    embedding: Tensor
    evidence: dict[str, Tensor]


class ShapeModel(nn.Module, ABC):
    """A network f(o, x) = s: partial cloud o, query x, signed distance s, negative inside."""

    architecture: str = ""
    box: float = 0.8
    """Half the side of the box about the origin that the surface is looked for in."""
    gives_distances: bool = True
    """Whether the values bound how far the surface is, or are right in their sign only."""
    embedding_size: int = 256
    cloud_size: int = 1000
    packed_neighbours: tuple[int, int] | None = None
    """(M, K) if `encode` takes a third argument: the first layer's neighbours, int64 [B, M, K]."""

    encoder_parts: tuple[str, ...] = ("layers", "to_embedding")
    """The submodules that the embedding depends on."""

    def embed(self, cloud: Tensor, camera: Tensor, neighbours: Tensor | None = None) -> Tensor:
        """Embedding [B, 256] alone, for the inputs of `encode`."""
        return self.encode(cloud, camera, neighbours).embedding

    def begin_with(self, other: ShapeModel) -> None:
        """Take the weights of another model of this architecture, trained before.

        Raises:
            RuntimeError: Its weights have other shapes.
        """
        self.load_state_dict(other.state_dict())

    @abstractmethod
    def config(self) -> dict[str, Any]:
        """The arguments that rebuild this architecture (plain types)."""

    @abstractmethod
    def encode(
        self,
        cloud: Tensor,
        camera: Tensor,
        neighbours: Tensor | None = None,
        surroundings: Surroundings | None = None,
    ) -> Encoding:
        """Read a batch of clouds.

        Args:
            cloud: [B, P, 3], network frame.
            camera: [B, 3], the camera's centre in the network's frame.
            neighbours: See `packed_neighbours`; searched for where None.
            surroundings: Observed space around the objects, for architectures that read it; ignored
                if None.
        """

    def in_precision(self, encoding: Encoding, dtype: torch.dtype) -> Encoding:
        """The encoding with its product tables in `dtype`, as autocast would convert them anyway;
        geometry stays as it is."""
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
        """`decode(encode(cloud, camera), x)`."""
        return self.decode(self.encode(cloud, camera), x)
