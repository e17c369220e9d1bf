"""The object is found in clouds with a table, a robot and other things, whatever their order."""

from __future__ import annotations

import numpy as np
import pytest

from pointsdf_cli.camera.segmentation import SegmentationConfig, find_table, segment_object
from pointsdf_cli.errors import InputError


def table(rng: np.random.Generator, count: int = 20_000, noise: float = 0.0) -> np.ndarray:
    points = rng.uniform((-0.3, -0.7, 0), (1.2, 0.7, 0), (count, 3))
    points[:, 2] += noise * rng.standard_normal(count)
    return points


def box(rng: np.random.Generator, centre: tuple[float, float, float], size: float) -> np.ndarray:
    """Points on the upper and the side faces of a cube."""
    points = rng.uniform(-0.5, 0.5, (3000, 3))
    axis = rng.integers(3, size=3000)
    side = np.where(axis == 2, 0.5, rng.choice([-0.5, 0.5], 3000))
    points[np.arange(3000), axis] = side
    return points * size + centre


def test_object_on_a_noisy_table_is_kept_and_nothing_else() -> None:
    rng = np.random.default_rng(0)
    thing = box(rng, (0.6, 0.1, 0.05), 0.1)
    robot = rng.uniform((0.0, -0.1, 0.6), (0.4, 0.1, 0.9), (2000, 3))
    small = box(rng, (0.8, -0.3, 0.02), 0.04)[:400]
    cloud = np.concatenate([table(rng, noise=0.001), thing, robot, small])
    found = segment_object(cloud)
    true = np.zeros(len(cloud), dtype=bool)
    true[20_000:23_000] = True
    assert not (found.kept & ~true).any()
    # All but what lies within the band above the table.
    assert found.kept[true & (cloud[:, 2] > 0.01)].all()
    assert found.outside[23_000:25_000].all()
    assert found.other[25_000:][small[:, 2] > 0.01].all()
    total = found.kept.astype(int) + found.outside + found.table + found.other
    assert (total == 1).all()
    assert "smaller clusters" in found.report()


def test_order_and_repetition_do_not_matter() -> None:
    rng = np.random.default_rng(1)
    cloud = np.concatenate([table(rng), box(rng, (0.6, 0.1, 0.05), 0.1)])
    order = rng.permutation(len(cloud))
    first, second = segment_object(cloud), segment_object(cloud)
    shuffled = segment_object(cloud[order])
    assert np.array_equal(first.kept, second.kept)
    assert (first.kept[order] == shuffled.kept).mean() > 0.999


def test_tilted_and_raised_table_of_a_pose_calibrated_by_hand() -> None:
    rng = np.random.default_rng(2)
    lean = 0.02
    turn = np.array([[np.cos(lean), 0, np.sin(lean)], [0, 1, 0], [-np.sin(lean), 0, np.cos(lean)]])
    cloud = np.concatenate([table(rng, noise=0.001), box(rng, (0.6, 0.0, 0.05), 0.1)])
    moved = cloud @ turn.T + (0, 0, 0.015)
    found = segment_object(moved)
    assert found.plane is not None
    assert found.plane[:3] == pytest.approx(turn[:, 2], abs=2e-3)
    assert not found.kept[:20_000].any()
    assert found.kept[20_000:].mean() > 0.9


def test_cloud_of_the_object_alone_is_kept_whole() -> None:
    rng = np.random.default_rng(3)
    found = segment_object(box(rng, (0.6, 0.1, 0.05), 0.1))
    assert found.plane is None
    assert found.kept.all()


def test_target_chooses_among_several() -> None:
    rng = np.random.default_rng(4)
    big, little = box(rng, (0.5, -0.2, 0.05), 0.1), box(rng, (0.7, 0.2, 0.04), 0.08)[:1000]
    cloud = np.concatenate([table(rng), big, little])
    assert segment_object(cloud).kept[20_000:23_000].any()
    chosen = segment_object(cloud, target=(0.7, 0.2, 0.05))
    assert not chosen.kept[20_000:23_000].any()
    assert chosen.kept[23_000:].any()


def test_flat_top_of_a_low_object_is_not_taken_for_the_table() -> None:
    rng = np.random.default_rng(5)
    book = rng.uniform((0.5, -0.05, 0.03), (0.65, 0.05, 0.03), (5000, 3))
    assert find_table(book) is None


@pytest.mark.parametrize(
    "cloud",
    [
        np.zeros((0, 3)),
        np.full((100, 3), np.nan),
        np.random.default_rng(0).uniform((5, 5, 5), (6, 6, 6), (100, 3)),
        np.random.default_rng(0).uniform((-0.3, -0.7, -1e-3), (1.2, 0.7, 1e-3), (9000, 3)),
        np.zeros((10, 2)),
    ],
    ids=["empty", "nan", "elsewhere", "table alone", "two columns"],
)
def test_no_object_is_said_so(cloud: np.ndarray) -> None:
    with pytest.raises(InputError):
        segment_object(cloud)


def test_rows_that_are_not_finite_are_dropped() -> None:
    rng = np.random.default_rng(6)
    cloud = np.concatenate([box(rng, (0.6, 0.1, 0.05), 0.1), np.full((50, 3), np.nan)])
    found = segment_object(cloud)
    assert found.kept[:3000].all()
    assert found.outside[3000:].all()


def test_impossible_workspace_is_refused() -> None:
    with pytest.raises(InputError):
        SegmentationConfig(low=(1.0, 0.0, 0.0), high=(0.5, 1.0, 1.0))
    with pytest.raises(InputError):
        SegmentationConfig(low=(0.2, 0.9, 0.0), high=(1.0, -0.9, 0.5))
