"""Meshes of reconstructions: a network that is a ball by definition gives that ball in metres."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from torch import Tensor, nn

from pointsdf_cli.geometry.frames import random_rotation
from pointsdf_cli.models.meshing import mesh_reconstruction, network_field
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.registry import build_model
from pointsdf_cli.models.shape_model import Encoding, ShapeModel

RADIUS = 0.4
AT = torch.tensor([0.1, -0.05, 0.2])
RNG = np.random.default_rng(0)


class Ball(ShapeModel):
    """A ball of radius 0.4 at (0.1, −0.05, 0.2) of the network's frame, whatever was seen."""

    def __init__(self) -> None:
        super().__init__()
        self.radius = nn.Parameter(torch.tensor(RADIUS))

    def config(self) -> dict[str, Any]:
        return {}

    def encode(self, cloud: Tensor, camera: Tensor) -> Encoding:
        return Encoding(torch.zeros(len(cloud), self.embedding_size), {})

    def decode(self, encoding: Encoding, x: Tensor) -> Tensor:
        return (x - AT).norm(dim=-1) - self.radius


def reconstruct(model: ShapeModel) -> tuple[Reconstruction, np.ndarray, float]:
    """A reconstruction in a turned world, the ball's centre there, and metres a network unit."""
    rotation, position = random_rotation(RNG), np.array([0.3, -1.0, 0.8])
    in_camera = RNG.uniform([-0.05, -0.08, 0.9], [0.07, 0.04, 1.0], (400, 3))
    low, high = in_camera.min(axis=0), in_camera.max(axis=0)
    unit = 1.03 * (high - low).max()
    centre = rotation @ ((low + high) / 2 + unit * AT.numpy().astype(float)) + position
    points = in_camera @ rotation.T + position
    return Reconstruction.from_cloud(model, points, position, rotation), centre, unit


def test_the_ball_lies_where_the_cloud_does_and_has_its_size() -> None:
    reconstruction, centre, unit = reconstruct(Ball())
    mesh = mesh_reconstruction(reconstruction, 64, smoothing=0)
    radii = np.linalg.norm(mesh.vertices - centre, axis=1)
    # A vertex keeps a thousandth of a cell from its edge's ends.
    assert radii == pytest.approx(RADIUS * unit, abs=2e-3 * unit * 1.6 / 64)
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(4 / 3 * np.pi * (RADIUS * unit) ** 3, rel=2e-3)


def test_the_field_of_the_network_frame_is_the_networks_own() -> None:
    reconstruction, _, _ = reconstruct(Ball())
    x = RNG.uniform(-0.8, 0.8, (50, 3)).astype(np.float32)
    expected = np.linalg.norm(x - AT.numpy(), axis=1) - RADIUS
    assert network_field(reconstruction)(x) == pytest.approx(expected, abs=2e-6)


def test_voxels_are_meshed_in_their_own_box() -> None:
    """An untrained VoxelCNN, whose grid is narrower than the box of the distance fields."""
    torch.manual_seed(0)
    model = build_model("voxelcnn").eval()
    with torch.no_grad():
        model.decoder[-1].bias += 10.0  # inside everywhere
    reconstruction, _, unit = reconstruct(model)
    mesh = mesh_reconstruction(reconstruction, 32, smoothing=0)
    network = (mesh.vertices - reconstruction.centre) @ reconstruction.R_frame_camera / unit
    assert np.abs(network).max() == pytest.approx(model.box * (1 - 1 / 32), abs=1e-6)
    assert trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).is_watertight
