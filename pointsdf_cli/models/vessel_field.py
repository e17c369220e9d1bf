"""The field of a vessel: its fitted wall of revolution, united with the network's other parts.

The wall comes from `geometry/vessel.py`. Handles, lids and spoons come from the network: its object
outside the vessel, near the points that were measured there.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.vessel import Vessel, fit_vessel
from pointsdf_cli.geometry.vessel_outline import NoVesselError

Values = NDArray[np.floating]
Network = Callable[[Array], Values]
"""The network's signed distances [N] m at points [N, 3] m."""
NetworkGradient = Callable[[Array], tuple[Values, Values]]

REACH = 0.012
"""Distance [m] from the seen points of a handle up to which the network's object counts."""
FILLED = 0.2
"""Largest share of the cavity that the network may believe to be solid: closed bodies whose end is
hollow are not vessels (docs/notebook.md)."""


def vessel_in(points: Array, support_plane: Array | None, network: Network) -> VesselField | None:
    """The field of a vessel; None if the points do not show one, or if the network fills it.

    Args:
        points: [N, 3], camera frame, m.
        support_plane: [4] as in `ViewEvidence`; None if not known.
        network: Its distances in the camera frame.
    """
    try:
        vessel = fit_vessel(points, support_plane)
    except NoVesselError:
        return None
    cavity = vessel.cavity()
    if len(cavity) and float((network(cavity) < 0).mean()) > FILLED:
        return None
    return VesselField(vessel)


class VesselField:
    """The union of a vessel's wall and the network's object near its other parts.

    Args:
        vessel: In the frame of the points that are asked.
    """

    def __init__(self, vessel: Vessel) -> None:
        self.vessel = vessel

    def moved(self, rotation: Array, translation: Array) -> VesselField:
        """The field in another frame: rotation [3, 3], then translation [3]."""
        return VesselField(self.vessel.moved(rotation, translation))

    def sdf(self, points: Array, network: Network) -> Array:
        """Signed distances [N] m at points [N, 3] m; the network is asked where it can matter."""
        values = self.vessel.wall.sdf(points)
        if self._others is None:
            return values
        bound = self._bound(points)[0]
        asked = bound < values
        if asked.any():
            part = np.maximum(network(points[asked]), bound[asked])
            values[asked] = np.minimum(values[asked], part)
        return values

    def sdf_and_gradient(self, points: Array, network: NetworkGradient) -> tuple[Array, Array]:
        """Signed distances [N] m and gradients [N, 3]."""
        values, gradients = self.vessel.wall.sdf_and_gradient(points)
        if self._others is None:
            return values, gradients
        bound, slope = self._bound(points)
        asked = np.flatnonzero(bound < values)
        if len(asked):
            part, way = network(points[asked])
            bounded = part < bound[asked]
            part = np.where(bounded, bound[asked], part)
            way = np.where(bounded[:, None], slope[asked], way)
            lower = part < values[asked]
            values[asked[lower]], gradients[asked[lower]] = part[lower], way[lower]
        return values, gradients

    def other_parts(self, points: Array, network: Network) -> Array:
        """Signed distances [N] of the other parts, reaching into the wall by half its thickness."""
        if self._others is None:
            return np.ones(len(points))
        near = self._others.query(points)[0] - REACH
        outside = -self.vessel.filled.sdf(points) - self.vessel.thickness / 2
        values = np.maximum(near, outside)
        asked = values < REACH
        if asked.any():
            values[asked] = np.maximum(values[asked], network(points[asked]))
        return values

    @cached_property
    def _others(self) -> cKDTree | None:
        return cKDTree(self.vessel.others) if len(self.vessel.others) else None

    def _bound(self, points: Array) -> tuple[Array, Array]:
        """Least distance [N] of the other parts, which lie outside the vessel near their seen
        points, and its gradient [N, 3]."""
        assert self._others is not None
        distance, nearest = self._others.query(points)
        filled, inwards = self.vessel.filled.sdf_and_gradient(points)
        way = (points - self.vessel.others[nearest]) / np.maximum(distance, 1e-9)[:, None]
        near = distance - REACH > -filled
        return (np.where(near, distance - REACH, -filled), np.where(near[:, None], way, -inwards))
