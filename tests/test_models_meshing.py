"""Meshes of reconstructions: a network that is a ball by definition gives that ball in metres."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import cKDTree
from torch import Tensor, nn

from pointsdf_cli.assets import asset_path
from pointsdf_cli.geometry.frames import random_rotation
from pointsdf_cli.io.clouds import read_cloud
from pointsdf_cli.models import linear
from pointsdf_cli.models.meshing import mesh_reconstruction, network_field
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.registry import build_model, load_model
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

    def encode(self, cloud: Tensor, camera: Tensor, **evidence: Any) -> Encoding:
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
    return Reconstruction.from_cloud(model, points, position, rotation, tries=1), centre, unit


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


@pytest.fixture(scope="module")
def mug() -> Reconstruction:
    """The bundled network alone, of the bundled cloud."""
    points, _ = read_cloud(asset_path("clouds/mug.ply")).in_camera_frame()
    return Reconstruction.from_cloud(load_model(), points, np.zeros(3), vessels=False)


@pytest.mark.parametrize("resolution", [128, 256])
def test_interpolated_values_make_the_surface_that_all_values_make(
    mug: Reconstruction, resolution: int
) -> None:
    """Of a network with its ripples, and of a cup with its thin walls."""
    made, exact = (mesh_reconstruction(mug, resolution, exact=e) for e in (False, True))
    solid, whole = (trimesh.Trimesh(m.vertices, m.faces, process=False) for m in (made, exact))
    assert solid.is_watertight
    unit = 1 / mug.scale
    # Mean offset along the normals, whatever the thickness of the walls.
    offset = abs(solid.volume - whole.volume) / whole.area
    assert offset < 0.05 * 1.6 * unit / resolution
    apart = cKDTree(exact.vertices).query(made.vertices)[0]
    assert np.percentile(apart, 95) < 0.25 * 1.6 * unit / 64  # of a cell that was halved
    assert made.queries < (1.1 if resolution == 128 else 0.5) * exact.queries


def test_up_to_64_every_value_is_asked_for(mug: Reconstruction) -> None:
    made, exact = (mesh_reconstruction(mug, 64, exact=e) for e in (False, True))
    assert np.array_equal(made.vertices, exact.vertices)


def test_smooth_things_are_asked_less() -> None:
    """Half a ball as a camera sees it: most cells of 64³ are interpolated."""
    seen = np.random.default_rng(0).normal(size=(3000, 3))
    seen *= 0.05 / np.linalg.norm(seen, axis=1, keepdims=True)
    seen = seen[seen[:, 2] < 0][:1000] + [0, 0, 1]
    half = Reconstruction.from_cloud(load_model(), seen, np.zeros(3))
    made, exact = (mesh_reconstruction(half, 128, exact=e) for e in (False, True))
    assert made.queries < 0.8 * exact.queries


@pytest.mark.parametrize("count", [700, 4097, 9001])
def test_values_do_not_depend_on_the_number_of_threads(
    mug: Reconstruction, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    x = np.random.default_rng(count).uniform(-0.05, 0.05, (count, 3)) + mug.centre
    before = torch.get_num_threads()
    answers = []
    for threads in (1, 2, 3):
        torch.set_num_threads(threads)
        answers.append((mug.sdf(x), *mug.sdf_and_gradient(x)))
    torch.set_num_threads(before)
    for values, values_too, gradients in answers:
        assert np.array_equal(values, answers[0][0])
        assert np.array_equal(values_too, answers[0][1])
        assert np.abs(values_too - values).max() < 1e-6  # products by another library
        assert np.array_equal(gradients, answers[0][2])
    # By the library that computes gradients.
    monkeypatch.setattr(linear, "onednn_is_faster", lambda: False)
    assert np.abs(answers[0][1] - mug.sdf(x)).max() < 1e-7


def test_no_query_is_answered_by_nothing(mug: Reconstruction) -> None:
    values, gradients = mug.sdf_and_gradient(np.zeros((2, 0, 3)))
    assert mug.sdf(np.zeros((2, 0, 3))).shape == values.shape == (2, 0)
    assert gradients.shape == (2, 0, 3)


def test_reduced_tables_change_what_autocast_computes_by_rounding_only(mug: Reconstruction) -> None:
    x = torch.rand(1, 500, 3, generator=torch.Generator().manual_seed(0)) - 0.5
    reduced = mug.model.in_precision(mug.encoding, torch.bfloat16)
    halved = {k for k, v in reduced.evidence.items() if v.dtype == torch.bfloat16}
    assert halved == {"fine", "coarse", "image", "keys", "values"}
    assert reduced.evidence["cloud"].dtype == torch.float32  # places keep their millimetres
    with torch.no_grad():
        full = mug.model.decode(mug.encoding, x)
        with torch.autocast("cpu", torch.bfloat16):
            auto = mug.model.decode(mug.encoding, x)
            low = mug.model.decode(reduced, x)
    assert (low - full).abs().mean() < 1.5 * (auto - full).abs().mean()
    assert (low - full).abs().mean() < 2e-3
