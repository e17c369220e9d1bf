"""Objects are found on noisy, tilted and wavy tables, whatever the order of the points."""

from __future__ import annotations

import numpy as np
import pytest

from pointsdf_cli.camera.segmentation import SegmentationConfig, find_table
from pointsdf_cli.camera.table_objects import OUTSIDE, TABLE, nearest_object, segment_table
from pointsdf_cli.camera.table_relief import table_relief
from pointsdf_cli.errors import InputError

CAMERA = np.array([1.5, 0.0, 0.8])


def table(rng: np.random.Generator, count: int = 60_000, noise: float = 0.0) -> np.ndarray:
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
    robot = rng.uniform((0.0, -0.1, 0.6), (0.2, 0.1, 0.9), (2000, 3))
    cloud = np.concatenate([table(rng, noise=0.001), thing, robot])
    kept, plane = nearest_object(cloud, CAMERA, np.array([0.6, 0.1, 0.05]))
    assert plane is not None
    true = np.zeros(len(cloud), dtype=bool)
    true[60_000:63_000] = True
    assert not (kept & ~true).any()
    # All but what lies within the band above the table.
    assert kept[true & (cloud[:, 2] > 0.02)].all()
    assert (segment_table(cloud, CAMERA).label[63_000:] == OUTSIDE).all()


def test_order_does_not_matter() -> None:
    rng = np.random.default_rng(1)
    cloud = np.concatenate([table(rng), box(rng, (0.6, 0.1, 0.05), 0.1)])
    order = rng.permutation(len(cloud))
    first, second = segment_table(cloud, CAMERA), segment_table(cloud[order], CAMERA)
    same = (first.label[order] >= 0) == (second.label >= 0)
    assert same.mean() > 0.999


def test_tilted_and_raised_table_of_a_pose_calibrated_by_hand() -> None:
    rng = np.random.default_rng(2)
    lean = 0.02
    turn = np.array([[np.cos(lean), 0, np.sin(lean)], [0, 1, 0], [-np.sin(lean), 0, np.cos(lean)]])
    cloud = np.concatenate([table(rng, noise=0.001), box(rng, (0.6, 0.0, 0.05), 0.1)])
    found = segment_table(cloud @ turn.T + (0, 0, 0.015), CAMERA)
    assert found.plane is not None
    assert found.plane[:3] == pytest.approx(turn[:, 2], abs=2e-3)
    assert not (found.label[:60_000] >= 0).any()
    assert (found.label[60_000:] >= 0).mean() > 0.85


def test_waves_of_a_measured_table_are_no_objects() -> None:
    rng = np.random.default_rng(7)
    wavy = table(rng, 300_000, noise=0.001)
    # Crests of 11 mm, 12 cm across, as a stereo camera makes them at 1.5 m.
    wavy[:, 2] += 0.011 * np.maximum(0.0, np.sin(wavy[:, 0] * 14) * np.sin(wavy[:, 1] * 14)) ** 2
    low = box(rng, (0.6, 0.0, 0.0), 0.04)
    low = low[low[:, 2] > 0]
    cloud = np.concatenate([wavy, low])
    assert (wavy[:, 2] > 0.008).sum() > 10_000
    found = segment_table(cloud, CAMERA)
    assert found.count == 1
    assert (found.label[:300_000] == TABLE).sum() > 100_000
    assert not (found.label[:300_000] >= 0).any()
    assert (found.label[300_000:] == 0).mean() > 0.5


def test_relief_follows_a_gentle_slope_and_stops_at_a_step() -> None:
    rng = np.random.default_rng(8)
    level = rng.uniform(0, 0.5, (40_000, 2))
    slope = np.clip(0.1 * (level[:, 0] - 0.1), 0, 0.01)
    book = 0.012 * (np.abs(level - (0.4, 0.25)) < 0.05).all(axis=1)
    relief = table_relief(level, slope + book, np.full(len(level), 0.006))
    assert relief[book == 0] == pytest.approx(slope[book == 0], abs=0.0015)
    inside = (np.abs(level - (0.4, 0.25)) < 0.04).all(axis=1)
    assert not relief[inside].any()


def test_cloud_of_the_object_alone_is_kept_whole() -> None:
    rng = np.random.default_rng(3)
    found = segment_table(box(rng, (0.6, 0.1, 0.05), 0.1), CAMERA)
    assert found.plane is None
    assert (found.label == 0).all()


def test_the_object_nearest_to_a_place_is_kept() -> None:
    rng = np.random.default_rng(4)
    big, little = box(rng, (0.5, -0.2, 0.05), 0.1), box(rng, (0.7, 0.2, 0.04), 0.08)[:1000]
    cloud = np.concatenate([table(rng), big, little])
    kept, _ = nearest_object(cloud, CAMERA, np.array([0.5, -0.2, 0.05]))
    assert kept[60_000:63_000].any()
    assert not kept[63_000:].any()
    kept, _ = nearest_object(cloud, CAMERA, np.array([0.7, 0.2, 0.05]))
    assert kept[63_000:].any()
    assert not kept[60_000:63_000].any()


def test_flat_top_of_a_low_object_is_not_taken_for_the_table() -> None:
    rng = np.random.default_rng(5)
    book = rng.uniform((0.5, -0.05, 0.03), (0.65, 0.05, 0.03), (5000, 3))
    assert find_table(book) is None


def test_the_feet_of_objects_are_no_table() -> None:
    """A black table returns nothing: what is seen near z = 0 are rings, far from each other."""
    turn = np.linspace(0, np.pi, 150)
    ring = np.stack([0.04 * np.cos(turn), 0.04 * np.sin(turn), np.zeros(150)], axis=1)
    rise = ring[None] + np.arange(0, 0.08, 0.0025)[:, None, None] * (0.0, 0.0, 1.0)
    places = [(0.5, -0.3), (0.6, 0.0), (0.7, 0.3)]
    feet = np.concatenate([rise.reshape(-1, 3) + (*place, 0.0) for place in places])
    assert find_table(feet) is None
    found = segment_table(feet, np.array([0.6, -1.0, 0.8]))
    assert found.count == 3
    assert found.plane is None


@pytest.mark.parametrize(
    "cloud",
    [
        np.zeros((0, 3)),
        np.random.default_rng(0).uniform((5, 5, 5), (6, 6, 6), (100, 3)),
        np.random.default_rng(0).uniform((-0.3, -0.7, -1e-3), (1.2, 0.7, 1e-3), (9000, 3)),
    ],
    ids=["empty", "elsewhere", "table alone"],
)
def test_no_object_is_said_so(cloud: np.ndarray) -> None:
    with pytest.raises(InputError, match="no object"):
        nearest_object(cloud, CAMERA, np.zeros(3))


def test_impossible_workspace_is_refused() -> None:
    with pytest.raises(InputError):
        SegmentationConfig(low=(1.0, 0.0, 0.0), high=(0.5, 1.0, 1.0))
    with pytest.raises(InputError):
        SegmentationConfig(low=(0.2, 0.9, 0.0), high=(1.0, -0.9, 0.5))


@pytest.mark.parametrize(("border", "cut"), [(0.13, False), (0.08, True)])
def test_an_object_that_the_workspace_cuts_goes_on_outside_of_it(border: float, cut: bool) -> None:
    rng = np.random.default_rng(6)
    things = [box(rng, (0.6, y, 0.05), 0.1) for y in (0.1, 0.16, 0.6)]
    cloud = np.concatenate([table(rng), *things])
    workspace = SegmentationConfig(low=(0.3, -0.5, -0.05), high=(1.0, border, 0.5))
    found = segment_table(cloud, CAMERA, workspace)
    assert found.count == 1
    long = cloud[60_000:66_000]
    near = (long[:, 2] > 0.02) & (long[:, 1] < border + 0.1)
    assert (found.label[60_000:66_000][near] == 0).all()
    assert (found.label[cloud[:, 1] > border + 0.1] == OUTSIDE).all()
    assert not (found.label[:60_000] == 0).any()  # the table stays the table
    assert (found.label[-3000:] == OUTSIDE).all()  # nothing joins this one to it
    assert bool(found.cut) == cut
