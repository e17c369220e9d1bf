"""Facts that hold for every reconstruction network, whatever its weights."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import torch

from pointsdf_cli.errors import InputError
from pointsdf_cli.models.ray_evidence import image_coordinates, ray_evidence
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.registry import build_model
from pointsdf_cli.models.shape_model import ShapeModel
from pointsdf_cli.models.voxelcnn import VOXEL, occupancy
from pointsdf_cli.training.presets import SMALL_POINTSDF

MODELS = {
    "ray": ("pointsdf-ray", {}),
    "ray-revolution": ("pointsdf-ray", {"revolution": True}),
    "pointsdf": ("pointsdf", SMALL_POINTSDF),
    "voxelcnn": ("voxelcnn", {}),
}


@pytest.fixture(scope="module", params=MODELS)
def model(request: pytest.FixtureRequest) -> ShapeModel:
    architecture, arguments = MODELS[request.param]
    network = build_model(architecture, arguments, seed=1)
    # A little training mode first, so that batch norms have statistics of their own.
    network.train()(*_inputs(2, 4))
    return network.eval()


def _inputs(seed: int, batch: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    cloud = torch.rand(batch, 1000, 3, generator=generator) - 0.5
    camera = torch.tensor([[0.1, -0.2, -11.0]]).repeat(batch, 1)
    x = torch.rand(batch, 17, 3, generator=generator) - 0.5
    return cloud, camera, x


@torch.no_grad()
def test_a_value_depends_on_its_own_cloud_and_query_alone(model: ShapeModel) -> None:
    cloud, camera, x = _inputs(0, 3)
    together = model(cloud, camera, x)
    alone = model(cloud[1:2], camera[1:2], x[1:2, 4:5])
    torch.testing.assert_close(together[1, 4], alone[0, 0], rtol=1e-4, atol=1e-5)


def test_the_gradient_agrees_with_finite_differences(model: ShapeModel) -> None:
    model = copy.deepcopy(model).double()
    cloud, camera, x = (t.double() for t in _inputs(1, 1))
    with torch.no_grad():
        encoding = model.encode(cloud, camera)
    x.requires_grad_(True)
    (gradient,) = torch.autograd.grad(model.decode(encoding, x).sum(), x)
    direction = torch.nn.functional.normalize(torch.ones(3).double(), dim=0)
    step = 1e-6
    with torch.no_grad():
        ahead = model.decode(encoding, x + step * direction)
        behind = model.decode(encoding, x - step * direction)
    numeric = (ahead - behind) / (2 * step)
    agrees = torch.isclose((gradient @ direction)[0], numeric[0], rtol=1e-3, atol=1e-5)
    # A query that stands on the border between two neighbourhoods may cross it within the step.
    assert agrees.double().mean() > 0.85


def test_the_embedding_has_256_numbers(model: ShapeModel) -> None:
    cloud, camera, _ = _inputs(0, 2)
    assert model.encode(cloud, camera).embedding.shape == (2, 256)


def test_the_architecture_is_rebuilt_from_its_config(model: ShapeModel) -> None:
    again = build_model(model.architecture, model.config())
    again.load_state_dict(model.state_dict())
    cloud, camera, x = _inputs(5, 1)
    with torch.no_grad():
        assert torch.equal(again.eval()(cloud, camera, x), model(cloud, camera, x))


def test_a_reconstruction_turns_and_moves_with_its_cloud(model: ShapeModel) -> None:
    rng = np.random.default_rng(0)
    cloud = rng.uniform(-0.05, 0.05, (1000, 3)) + [0.0, 0.0, 1.5]
    x = rng.uniform(-0.05, 0.05, (20, 3)) + [0.0, 0.0, 1.5]
    here = Reconstruction.from_cloud(model, cloud, np.zeros(3))
    turn = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    shift = np.array([0.4, -1.0, 0.2])
    there = Reconstruction.from_cloud(model, cloud @ turn.T + shift, shift, turn)
    np.testing.assert_allclose(there.sdf(x @ turn.T + shift), here.sdf(x), atol=2e-5)
    np.testing.assert_allclose(there.centre, turn @ here.centre + shift, atol=1e-9)
    _, gradient = here.sdf_and_gradient(x)
    _, turned = there.sdf_and_gradient(x @ turn.T + shift)
    close = np.abs(turned - gradient @ turn.T).max(axis=1) < 1e-2
    assert close.mean() >= 0.9


def test_distances_are_in_metres_whatever_the_size(model: ShapeModel) -> None:
    rng = np.random.default_rng(0)
    cloud = rng.uniform(-0.05, 0.05, (1000, 3)) + [0.0, 0.0, 1.5]
    x = rng.uniform(-0.05, 0.05, (20, 3)) + [0.0, 0.0, 1.5]
    one = Reconstruction.from_cloud(model, cloud, np.zeros(3)).sdf(x)
    twice = Reconstruction.from_cloud(model, cloud * 2, np.zeros(3)).sdf(x * 2)
    np.testing.assert_allclose(twice, 2 * one, atol=2e-5)


def test_chunks_and_gradients_give_the_same_values(model: ShapeModel) -> None:
    rng = np.random.default_rng(3)
    cloud = rng.uniform(-0.05, 0.05, (300, 3)) + [0.0, 0.0, 1.5]
    shape = Reconstruction.from_cloud(model, cloud, np.zeros(3))
    x = rng.uniform(-0.05, 0.05, (7, 5, 3)) + [0.0, 0.0, 1.5]
    values = shape.sdf(x)
    assert values.shape == (7, 5)
    np.testing.assert_allclose(shape.sdf(x, chunk=4), values, atol=1e-6)
    np.testing.assert_allclose(shape.sdf_and_gradient(x)[0], values, atol=1e-6)
    assert shape.sdf(np.zeros((0, 3))).shape == (0,)


def test_two_samplings_agree_where_every_point_is_read() -> None:
    rng = np.random.default_rng(6)
    views = {count: rng.uniform(-0.05, 0.05, (count, 3)) + [0, 0, 1.0] for count in (2500, 5000)}

    def apart(most_points: int, count: int) -> float:
        """Largest difference of the fields of two samplings."""
        network = build_model("pointsdf-ray", {"most_points": most_points}, seed=1)
        x = views[count][:50] + 0.01
        shapes = [
            Reconstruction.from_cloud(network, views[count], np.zeros(3), seed=s) for s in (0, 1)
        ]
        return float(np.abs(shapes[0].sdf(x) - shapes[1].sdf(x)).max())

    assert apart(3000, 2500) == 0.0
    assert apart(3000, 5000) > 0.0  # a sample again
    assert apart(1000, 2500) > 0.0


def test_bad_clouds_are_refused() -> None:
    network = build_model("voxelcnn")
    for cloud in (np.zeros((0, 3)), np.full((60, 3), np.inf), np.ones((60, 3))):
        with pytest.raises(InputError):
            Reconstruction.from_cloud(network, cloud, np.zeros(3))
    with pytest.raises(InputError, match="rotation"):
        Reconstruction.from_cloud(network, np.eye(3), np.zeros(3), -np.eye(3))


def test_unknown_architectures_and_arguments_are_refused() -> None:
    with pytest.raises(InputError, match="no architecture"):
        build_model("resnet")
    with pytest.raises(InputError, match="cannot be built"):
        build_model("pointsdf-ray", {"search": "exact"})
    with pytest.raises(InputError, match="cannot be built"):
        build_model("voxelcnn", {"depth": 3})


@pytest.mark.parametrize("arguments", [{"centres": []}, {"neighbours": [2000, 16, 16, 16]}])
def test_arguments_that_no_cloud_fits_are_refused(arguments: dict[str, list[int]]) -> None:
    with pytest.raises(InputError, match="cannot be built"):
        build_model("pointsdf-ray", arguments)


def test_the_paper_preset_has_the_published_sizes() -> None:
    network = build_model("pointsdf")
    config = network.config()
    assert config["centres"] == [512, 256, 64, 36]
    assert [mlp[-1] for mlp in config["mlps"]] == [64, 64, 256, 512]
    assert network.to_embedding[0].in_features == 36 * 512
    assert [layer.out_features for layer in network.head if hasattr(layer, "out_features")] == [
        512,
        512,
        256,
    ]


def test_neighbours_in_the_image_are_looked_for_where_the_image_is() -> None:
    """The planes that are searched are kept beside the coordinates that are read."""
    cloud, camera, _ = _inputs(5, 1)
    known = build_model("pointsdf-ray", seed=1).eval().encode(cloud, camera).evidence
    assert torch.equal(known["cloud_plane"], image_coordinates(cloud, camera)[..., :2])
    assert torch.equal(known["cloud_plane"], known["cloud_image"][..., :2])
    assert torch.equal(
        known["coarse_plane"], image_coordinates(known["coarse_at"], camera)[..., :2]
    )


def test_evidence_knows_behind_from_in_front_and_inside_from_outside_the_silhouette() -> None:
    # A plane z = 0 of 0.8 × 0.8 seen from 20 in front of it.
    grid = torch.linspace(-0.4, 0.4, 40)
    plane = torch.stack([*torch.meshgrid(grid, grid, indexing="ij"), torch.zeros(40, 40)], -1)
    cloud, camera = plane.view(1, -1, 3), torch.tensor([[0.0, 0.0, -20.0]])
    x = torch.tensor([[[0.0, 0.0, 0.2], [0.0, 0.0, -0.2], [0.6, 0.0, 0.0]]])
    image = image_coordinates(cloud, camera)
    seen = ray_evidence(x, image_coordinates(x, camera), cloud, image, image[..., :2], camera)[0]
    distance, lateral, behind = seen[:, 0], seen[:, 2], seen[:, 4]
    torch.testing.assert_close(distance, torch.tensor([0.2, 0.2, 0.2]), atol=0.01, rtol=0.0)
    torch.testing.assert_close(behind, torch.tensor([0.2, -0.2, 0.0]), atol=1e-3, rtol=0.0)
    torch.testing.assert_close(lateral, torch.tensor([0.0, 0.0, 0.2]), atol=0.02, rtol=0.0)


def test_points_on_one_ray_have_one_image_place() -> None:
    camera = torch.tensor([[0.1, 0.2, -10.0]])
    ray = torch.tensor([0.03, -0.02, 1.0])
    points = camera + torch.tensor([[8.0], [10.0], [12.0]]) * ray
    place = image_coordinates(points[None], camera)[0]
    torch.testing.assert_close(place[:, :2], place[:1, :2].expand(3, 2))
    torch.testing.assert_close(place[:, 2], torch.tensor([8.0, 10.0, 12.0]))


def test_a_point_fills_the_voxel_it_lies_in() -> None:
    cloud = torch.tensor([[[0.0, 0.0, 0.0], [VOXEL * 1.5, -VOXEL * 0.5, VOXEL * 12.9]]])
    grid = occupancy(cloud)[0]
    assert grid.sum() == 2
    assert grid[16, 16, 16] == 1
    assert grid[17, 15, 28] == 1
