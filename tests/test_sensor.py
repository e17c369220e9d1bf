"""Depth sensors against geometry computed by hand."""

from __future__ import annotations

import numpy as np
import pytest

from pointsdf_cli.camera.noise import DepthNoise
from pointsdf_cli.camera.pinhole import CAMERAS
from pointsdf_cli.camera.sensor import SENSORS, load_sensor
from pointsdf_cli.errors import InputError

XTION = CAMERAS["xtion"]


def plane(depth: float, side: int = 200) -> np.ndarray:
    return np.full((side, side), depth, np.float32)


def step(near: float = 0.8, far: float = 1.2, side: int = 240) -> np.ndarray:
    """A square of 80 pixels before a wall."""
    image = plane(far, side)
    image[80:160, 80:160] = near
    return image


def test_the_ideal_sensor_is_the_papers_noise_alone() -> None:
    exact = plane(1.5)
    measured = load_sensor("ideal").observe(exact, XTION, np.random.default_rng(3))
    noisy = DepthNoise().apply(exact.ravel(), np.random.default_rng(3))
    assert np.array_equal(measured.ravel(), noisy)
    assert np.std(measured) == pytest.approx(0.001, rel=0.05)


@pytest.mark.parametrize("name", ["structured-light", "stereo"])
def test_a_wall_that_faces_the_camera_is_seen_whole_and_where_it_is(name: str) -> None:
    measured = load_sensor(name).observe(plane(1.0), XTION, np.random.default_rng(0))
    inner = measured[40:160, 40:160]
    assert (inner > 0).mean() > 0.9
    assert abs(np.median(inner[inner > 0]) - 1.0) < 0.006
    assert np.std(inner[inner > 0]) < 0.01


@pytest.mark.parametrize("name", ["structured-light", "stereo"])
def test_returns_are_lost_at_edges_and_not_far_from_them(name: str) -> None:
    images = [
        load_sensor(name).observe(step(), XTION, np.random.default_rng(seed)) for seed in range(8)
    ]
    missing = np.mean([image == 0 for image in images], axis=0)
    rim = np.concatenate([missing[80:160, 78:82].ravel(), missing[80:160, 158:162].ravel()])
    assert rim.mean() > 3 * missing[100:140, 100:140].mean()
    assert rim.mean() > 0.1


def test_the_background_is_shadowed_for_about_the_difference_of_disparities() -> None:
    """b·f·(1/z_near − 1/z_far) pixels beside an object get no light, or are seen by one imager."""
    near, far = 0.6, 1.2
    sensor = load_sensor("stereo")
    expected = sensor.baseline * XTION.fx * (1 / near - 1 / far)
    missing = [
        (sensor.observe(step(near, far), XTION, np.random.default_rng(k)) == 0)[100:140]
        for k in range(6)
    ]
    rate = np.mean(missing, axis=(0, 1))
    left, right = rate[40:80].sum(), rate[160:200].sum()
    widest = max(left, right)
    assert widest == pytest.approx(expected, rel=0.5, abs=6)


def test_the_same_seed_gives_the_same_image() -> None:
    for name in SENSORS:
        first, second = (
            load_sensor(name).observe(step(), XTION, np.random.default_rng(7)) for _ in range(2)
        )
        assert np.array_equal(first, second)


def test_an_unknown_sensor_is_refused_with_the_names() -> None:
    with pytest.raises(InputError, match="lidar") as refused:
        load_sensor("lidar")
    assert "structured-light" in str(refused.value.allowed)
