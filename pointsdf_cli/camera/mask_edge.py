"""Masks that end before the object does: the edge of a mask moved outwards to the depth's edge.

A mask drawn in the colour image, or by a network, is often a few pixels too small, and the network
would take the object's rim for free space. A pixel beside the mask is the object's too if its depth
continues that of the mask.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.arrays import Mask

SENSOR_FOCAL = 570.0
"""Focal length [px] of a depth camera. Images of a longer one were enlarged, and so are the errors
of masks in them."""

STEEPEST = 3.0
"""Tangent of the steepest angle, 72°: larger depth steps from pixel to pixel end a surface."""

NOISE = 0.001
"""Depth step [m] of a camera's noise, in addition."""

FARTHEST = 8
"""Largest growth [px], whatever the focal length."""


def grown_mask(
    mask: Mask, depth: NDArray[np.floating], focal: float, allowed: Mask | None = None
) -> Mask:
    """Extend a mask over neighbouring pixels that continue its surface, by one pixel of the sensor.

    Args:
        mask: [height, width].
        depth: [height, width], m along z; 0 where nothing returned.
        focal: Focal length [px], above 0.
        allowed: [height, width], pixels that may be the object's, such as those above the table;
            all if None.

    Returns:
        [height, width]; it contains `mask`.
    """
    grown = np.array(mask, dtype=bool)
    free = depth > 0 if allowed is None else allowed & (depth > 0)
    for _ in range(int(np.clip(round(focal / SENSOR_FOCAL), 1, FARTHEST))):
        known = np.pad(np.where(grown, depth, 0.0), 1)
        new = np.zeros_like(grown)
        for down, right in ((0, 1), (2, 1), (1, 0), (1, 2)):
            beside = known[down : down + depth.shape[0], right : right + depth.shape[1]]
            step = STEEPEST / focal * beside + NOISE
            new |= (beside > 0) & (np.abs(depth - beside) < step)
        grown |= new & free
    return grown
