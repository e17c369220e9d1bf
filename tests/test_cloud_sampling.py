"""Systematic samples of a cloud."""

import numpy as np
from scipy.spatial import cKDTree

from pointsdf_cli.geometry.cloud_sampling import systematic_sample


def square(side: int) -> np.ndarray:
    """[side², 2] pixels over the unit square, in random order."""
    u, v = np.meshgrid(np.arange(side), np.arange(side))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1) / (side - 1)
    return np.random.default_rng(0).permutation(pixels)


def test_a_sample_is_spread_evenly() -> None:
    pixels = square(128)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        chosen = systematic_sample(pixels, 1024, rng)
        assert len(np.unique(chosen)) == 1024
        # 256 squares of 8 × 8 pixels hold four points each: independent draws scatter by 1.9.
        counts, *_ = np.histogram2d(*pixels[chosen].T, bins=16)
        assert counts.std() < 0.5
        drawn = rng.choice(len(pixels), 1024, replace=False)
        assert np.histogram2d(*pixels[drawn].T, bins=16)[0].std() > 1.5


def test_two_samples_lie_close_to_each_other() -> None:
    pixels = square(200)
    one, other = (
        pixels[systematic_sample(pixels, 1000, np.random.default_rng(seed))] for seed in (0, 1)
    )
    away, _ = cKDTree(one).query(other)
    assert away.max() < 2 * 0.032


def test_a_dense_side_keeps_its_share() -> None:
    rng = np.random.default_rng(0)
    left = rng.uniform((0, 0), (0.5, 1), (9000, 2))
    right = rng.uniform((0.5, 0), (1, 1), (3000, 2))
    chosen = systematic_sample(np.concatenate([left, right]), 400, rng)
    assert abs((chosen < 9000).sum() - 300) <= 8


def test_a_small_cloud_is_kept_whole() -> None:
    rng = np.random.default_rng(0)
    chosen = systematic_sample(rng.random((30, 2)), 1000, rng)
    assert len(chosen) == 1000
    assert set(chosen) == set(range(30))
    assert set(systematic_sample(np.zeros((1, 2)), 5, rng)) == {0}
    assert len(np.unique(systematic_sample(np.ones((50, 2)), 20, rng))) == 20
