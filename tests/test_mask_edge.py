"""A mask that is too small grows to the depth's edge, by one pixel of the sensor and no farther."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_erosion

from pointsdf_cli.camera.mask_edge import grown_mask

SHAPE = (40, 50)


def plate(depth: float = 1.0, behind: float = 1.5) -> tuple[np.ndarray, np.ndarray]:
    """Mask and depth of a plate, 20 × 24 pixels, before a wall."""
    mask = np.zeros(SHAPE, dtype=bool)
    mask[10:30, 12:36] = True
    return mask, np.where(mask, depth, behind)


def test_a_rim_of_one_sensor_pixel_comes_back_and_the_wall_does_not() -> None:
    mask, depth = plate()
    for focal, lost in ((365.0, 1), (570.0, 1), (1067.0, 2)):
        small = binary_erosion(mask, iterations=lost)
        grown = grown_mask(small, depth, focal)
        # Growth goes along rows and columns: the plate's corners come back for one pixel less.
        assert grown[10:30, 14:34].all()
        assert grown[12:28, 12:36].all()
        assert not (grown & ~mask).any()
    assert np.array_equal(grown_mask(mask, depth, 570.0), mask)


def test_a_rim_of_three_pixels_comes_back_in_part_only() -> None:
    mask, depth = plate()
    small = binary_erosion(mask, iterations=3)
    grown = grown_mask(small, depth, 570.0)
    assert np.array_equal(grown, binary_erosion(mask, iterations=2) & grown)
    assert grown.sum() > small.sum()


def test_a_surface_seen_at_70_degrees_continues_and_one_at_75_does_not() -> None:
    focal, rows = 570.0, np.arange(SHAPE[0])
    for degrees, goes_on in ((70, True), (76, False)):
        # From pixel to pixel the depth changes by tan(angle) times the pixel's size, z / f.
        step = np.tan(np.radians(degrees)) / focal
        depth = np.repeat((1.0 * (1 + step) ** rows)[:, None], SHAPE[1], axis=1)
        mask = np.zeros(SHAPE, dtype=bool)
        mask[20, :] = True
        grown = grown_mask(mask, depth, focal)
        assert grown[21, 25] == goes_on, degrees


def test_only_allowed_pixels_with_a_depth_are_taken() -> None:
    mask, depth = plate()
    small = binary_erosion(mask)
    depth[10, 12:24] = 0.0
    allowed = np.ones(SHAPE, dtype=bool)
    allowed[29] = False
    grown = grown_mask(small, depth, 570.0, allowed)
    assert not grown[10, 12:24].any()
    assert grown[10, 24:35].all()
    assert not grown[29].any()


def test_nothing_wraps_around_the_image() -> None:
    mask = np.zeros(SHAPE, dtype=bool)
    mask[:, 0] = True
    grown = grown_mask(mask, np.ones(SHAPE), 570.0)
    assert grown[:, 1].all()
    assert not grown[:, -1].any()
