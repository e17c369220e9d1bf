"""The network's frame, worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from pointsdf_cli.errors import InputError
from pointsdf_cli.models.normalise import network_frame


def test_a_box_of_two_by_one_centimetres() -> None:
    cloud = np.array([[0.10, 0.20, 1.50], [0.12, 0.21, 1.51]])
    frame = network_frame(cloud)
    np.testing.assert_allclose(frame.centre, [0.11, 0.205, 1.505])
    assert frame.scale == pytest.approx(1.0 / (1.03 * 0.02))
    np.testing.assert_allclose(
        frame.to_network(cloud)[1], [0.5 / 1.03, 0.25 / 1.03, 0.25 / 1.03], rtol=1e-9
    )


def test_the_partial_cloud_fits_the_unit_box_and_comes_back() -> None:
    cloud = np.random.default_rng(0).normal(size=(200, 3))
    frame = network_frame(cloud)
    inside = frame.to_network(cloud)
    assert np.ptp(inside, axis=0).max() == pytest.approx(1.0 / 1.03)
    np.testing.assert_allclose(inside / frame.scale + frame.centre, cloud, atol=1e-12)


@pytest.mark.parametrize(
    "cloud", [np.zeros((0, 3)), np.ones((50, 3)), np.full((5, 3), np.nan), np.zeros((4, 2))]
)
def test_clouds_without_a_size_are_refused(cloud: np.ndarray) -> None:
    with pytest.raises(InputError):
        network_frame(cloud)
