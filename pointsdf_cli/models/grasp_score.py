"""Scores of grasps of one object by a trained success network and its prior.

    grasps = load_grasp_model().on(points, T_world_camera)
    grasps.log_success(preshape, T_world_palm)      [B], differentiable
    grasps.log_prior(preshape, T_world_palm)        [B], differentiable
    grasps.sample("side", 32, rng)                  preshapes and palms

`ObjectGrasps` satisfies `planning.objective.GraspScore` and `planning.seeds.GraspSampler`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.geometry.frames import apply_transform, is_rigid
from pointsdf_cli.models.best_sampling import SAMPLINGS
from pointsdf_cli.models.checkpoint_kinds import grasps_learned_from
from pointsdf_cli.models.grasp_checkpoint import GraspParts, read_grasp_checkpoint
from pointsdf_cli.models.grasp_features import FAR, GraspFeatures, ObjectBody, object_body
from pointsdf_cli.models.grasp_prior import ObjectPlace
from pointsdf_cli.models.grasp_success import EmbeddingNet, grasp_numbers
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.tensor_grid import TensorGrid
from pointsdf_cli.robot.description import RobotDescription

GRID_STEP = 0.008
"""Step of the grid on which the geometry's field is kept [m]."""

OWN_CELLS = 8_000
"""Approximate limit on that grid's cells if the network itself is evaluated."""


@dataclass(frozen=True)
class GraspModel(GraspParts):
    """A loaded checkpoint of `train-gs`."""

    @property
    def learned_from(self) -> int | None:
        """Number of executed training grasps; None if the checkpoint does not say."""
        return grasps_learned_from(self.config)

    def on(
        self,
        points: ArrayLike,
        T_world_camera: ArrayLike,
        field: Field | None = None,
        seed: int = 0,
    ) -> ObjectGrasps:
        """The scores of one object.

        Args:
            points: [N, 3], the segmented object as seen, camera frame, m.
            T_world_camera: [4, 4]; z is up in the world and the table top at 0.
            field: The object's signed distances in the world, for the features of geometry; if None
                the reconstruction by `encoder`. Unused by networks on embeddings.
            seed: Random seed of the cloud's resampling.

        Raises:
            InputError: The points are not a cloud, or the pose is not rigid.
        """
        pose = np.asarray(T_world_camera, dtype=np.float64)
        if not is_rigid(pose):
            raise InputError("is not a rigid transform", where="T_world_camera")
        points = np.asarray(points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise InputError(f"a cloud of shape {points.shape}", allowed="finite [N, 3]")
        world = apply_transform(pose, points)
        place = ObjectPlace.of(world, self.robot.T_world_base[:3, 3])
        by_embedding = isinstance(self.network, EmbeddingNet)
        if by_embedding or field is None:
            tries = 1 if by_embedding else SAMPLINGS  # embeddings were learned from one sampling
            shape = Reconstruction.from_cloud(
                self.encoder, world, pose[:3, 3], pose[:3, :3], seed=seed, tries=tries
            )
        if by_embedding:
            return EmbeddingGrasps(self, place, shape)
        values = shape.sdf if field is None else (lambda x: field.with_gradient(x)[0])
        return GeometryGrasps(self, place, world, values, own=field is None)


class ObjectGrasps(ABC):
    """The scores of grasps of one object, world frame."""

    def __init__(self, model: GraspModel, place: ObjectPlace) -> None:
        self._model, self._place = model, place

    @abstractmethod
    def logit(self, preshape: Tensor, T_world_palm: Tensor) -> Tensor:
        """Calibrated logits of success [B]."""

    def log_success(self, preshape: Tensor, T_world_palm: Tensor) -> Tensor:
        """log h [B] of preshapes [B, K] and palms [B, 4, 4]; differentiable in both."""
        return torch.nn.functional.logsigmoid(self.logit(preshape, T_world_palm))

    def log_prior(self, preshape: Tensor, T_world_palm: Tensor) -> Tensor:
        """log g [B] of preshapes [B, K] and palms [B, 4, 4], in the units of `grasp_prior.py`."""
        return self._model.prior.log_density(preshape, T_world_palm, self._place)

    def sample(self, kind: str, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Sample preshapes [N, K] within the robot's ranges, and palms [N, 4, 4], of the prior's
        "side" or "top" component."""
        preshape, palm = self._model.prior.sample(kind, count, self._place, rng)
        # In the prior's precision: its own ranges change nothing.
        low, high = self._model.robot.preshape_ranges.T.astype(np.float32)
        return np.clip(preshape, low, high), palm


class EmbeddingGrasps(ObjectGrasps):
    """Scores by the embedding of the cloud, as published."""

    def __init__(self, model: GraspModel, place: ObjectPlace, shape: Reconstruction) -> None:
        super().__init__(model, place)
        self._embedding = shape.encoding.embedding.float().cpu()  # as the rest of the score is
        self._size = torch.tensor(shape.size, dtype=torch.float32)[None]
        self._axes = torch.tensor(shape.R_frame_camera.T.copy(), dtype=torch.float32)
        self._centre, self._scale = torch.tensor(shape.centre), shape.scale

    def logit(self, preshape: Tensor, T_world_palm: Tensor) -> Tensor:
        palm = T_world_palm.double()
        # World coordinates are large beside the differences that matter: subtract before rounding.
        position = ((palm[:, :3, 3] - self._centre) * self._scale).float()
        top = torch.cat([palm[:, :3, :3].float(), position[:, :, None]], dim=2)
        numbers = grasp_numbers(preshape.float(), self._axes @ top)
        network = self._model.network
        return network.calibration(network(numbers, self._embedding, self._size))


class GeometryGrasps(ObjectGrasps):
    """Scores from features of the reconstruction at the grasp itself."""

    def __init__(
        self, model: GraspModel, place: ObjectPlace, points: Array, field: object, own: bool
    ) -> None:
        super().__init__(model, place)
        self.body: ObjectBody = object_body(points, field)  # type: ignore[arg-type]
        low, high = points.min(axis=0), points.max(axis=0)
        # The unseen part may be as deep as the seen one is wide.
        spare = 0.5 * float((high - low).max()) + FAR
        low, high = low - spare, high + spare
        low[2] = max(low[2], -FAR)
        cells = OWN_CELLS if own else 4 * OWN_CELLS
        self._field = TensorGrid(field, low, high, GRID_STEP, cells)  # type: ignore[arg-type]
        # Scaled as in training, whatever ranges the robot has now.
        self._features = GraspFeatures(model.sweep, model.prior.ranges.numpy())

    def logit(self, preshape: Tensor, T_world_palm: Tensor) -> Tensor:
        features = self._features(preshape, T_world_palm, self.body, self._field)
        network = self._model.network
        return network.calibration(network(features))


def load_grasp_model(
    path: Path | str | None = None,
    sdf_checkpoint: Path | str | None = None,
    device: str = "cpu",
    robot: RobotDescription | None = None,
) -> GraspModel:
    """Load a checkpoint of `train-gs`.

    Args:
        path: The checkpoint; where None, the bundled one of the robot.
        sdf_checkpoint: The frozen shape network, if it is not where it was when it was trained.
        device: Device of the shape network; the success network is too small to gain by it.
        robot: The robot; the bundled one if None.

    Raises:
        InputError: As `read_grasp_checkpoint`.
    """
    parts = read_grasp_checkpoint(path, sdf_checkpoint, robot)
    return GraspModel(**vars(parts) | {"encoder": parts.encoder.to(device)})
