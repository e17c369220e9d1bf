"""The network's frame (paper section III-A): the camera's axes, the partial cloud's box.

Origin: the centre of the partial cloud's axis-aligned bounding box. Scale: the partial cloud's
largest extent becomes 1/1.03. Orientation: the camera's, never a principal axis. The full object
may stick out of the unit box; signed distances scale by the same factor.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointsdf_cli.errors import InputError

MARGIN = 1.03
"""Ratio of a network unit to the cloud's largest extent."""


class NetworkFrame(NamedTuple):
    """Frame of the network: `x_network = (x_camera − centre) · scale`.

    Attributes:
        centre: [3] f8, in the cloud's frame, m.
        scale: Network units per metre.
    """

    centre: np.ndarray
    scale: float

    def to_network(self, points: np.ndarray) -> np.ndarray:
        """Transform points [..., 3] in metres to the network's frame."""
        return (points - self.centre) * self.scale


def network_frame(cloud: np.ndarray) -> NetworkFrame:
    """Compute the network's frame of one partial cloud.

    Args:
        cloud: [N, 3], m, along the camera's axes.

    Raises:
        InputError: The cloud is empty, not finite, or a single point.
    """
    cloud = np.asarray(cloud, dtype=np.float64)
    if cloud.ndim != 2 or cloud.shape[1] != 3 or len(cloud) == 0:
        raise InputError(
            f"a cloud of shape {cloud.shape} cannot be normalised", allowed="[N, 3] with N ≥ 1"
        )
    if not np.isfinite(cloud).all():
        raise InputError("the cloud holds values that are not finite", allowed="finite coordinates")
    low, high = cloud.min(axis=0), cloud.max(axis=0)
    extent = float((high - low).max())
    if extent <= 0.0:
        raise InputError(
            "all points of the cloud are the same, so it has no size", allowed="a cloud with extent"
        )
    return NetworkFrame(centre=(low + high) / 2.0, scale=1.0 / (MARGIN * extent))
