"""PointConv against its formula written out point by point."""

from __future__ import annotations

import pytest
import torch

from pointsdf_cli.models.neighbours import gather, inverse_density, nearest_neighbours
from pointsdf_cli.models.pointconv import PointConv


@pytest.mark.parametrize("channels", [0, 5])
@pytest.mark.parametrize("density", [True, False])
def test_the_layer_is_the_formula(channels: int, density: bool) -> None:
    torch.manual_seed(0)
    layer = PointConv(channels, (6, 7, 8), weight_channels=4, density=density, radius=0.5).eval()
    points = torch.randn(2, 40, 3)
    features = torch.randn(2, 40, channels) if channels else None
    centres = points[:, :9]
    index = nearest_neighbours(centres, points, 12)
    inverse = inverse_density(points, 0.2)
    got = layer(points, features, centres, index, inverse)

    # The mlp applied to the concatenated (p_k − c, f_k) *after* the gather, one centre at a time.
    offsets = (gather(points, index) - centres.unsqueeze(2)) / 0.5
    first = offsets @ layer.from_offset.weight.T
    if features is not None:
        assert layer.from_features is not None
        first = first + layer.from_features(gather(features, index))
    else:
        first = first + layer.bias
    hidden = layer.mlp(torch.relu(layer.first_norm(first)))
    weights = layer.weight_net(offsets)
    if density:
        assert layer.density_net is not None
        hidden = hidden * layer.density_net(gather(inverse.unsqueeze(-1), index))
    product = torch.einsum("bmkw,bmkc->bmwc", weights, hidden)
    expected = torch.relu(layer.out_norm(layer.out(product.flatten(-2))))
    torch.testing.assert_close(got, expected, rtol=1e-4, atol=1e-5)


def test_moving_the_whole_cloud_changes_nothing() -> None:
    torch.manual_seed(0)
    layer = PointConv(0, (6, 8), weight_channels=4, density=False).eval()
    points = torch.randn(1, 30, 3)
    index = nearest_neighbours(points[:, :5], points, 8)
    moved = points + torch.tensor([0.3, -0.2, 0.7])
    torch.testing.assert_close(
        layer(points, None, points[:, :5], index),
        layer(moved, None, moved[:, :5], index),
        rtol=1e-4,
        atol=1e-5,
    )


def test_the_order_of_the_neighbours_does_not_matter() -> None:
    torch.manual_seed(0)
    layer = PointConv(0, (6, 8), weight_channels=4, density=False).eval()
    points = torch.randn(1, 30, 3)
    index = nearest_neighbours(points[:, :5], points, 8)
    torch.testing.assert_close(
        layer(points, None, points[:, :5], index),
        layer(points, None, points[:, :5], index.flip(-1)),
    )
