"""Mesh of a reconstruction in metres, extracted in the network's frame.

In that frame every object has the same size, so one grid and one set of tolerances serve all.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.field import FieldFunction
from pointsdf_cli.geometry.isosurface import (
    MAX_RESOLUTION,
    EmptySurfaceError,
    IsosurfaceConfig,
    extract_isosurface,
)
from pointsdf_cli.geometry.mise import SMOOTH_FROM, SearchRules
from pointsdf_cli.geometry.sampled_grid import NetworkField
from pointsdf_cli.geometry.smoothing import taubin_smooth
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.vessel_field import VesselField
from pointsdf_cli.models.vessel_surface import vessel_surface

SMOOTHING = 25
"""Default number of smoothing passes, chosen on held-out training objects: it raises normal
consistency by 0.07 and improves the other two metrics of Table I by less than their noise
(docs/notebook.md)."""

FINEST_EVALUATED = 128
"""Cells along the box of the finest grid on which a network is evaluated; finer ones are
interpolated. Evaluation at 512³ takes five times as long and scores no better
(docs/notebook.md)."""
LARGEST_BEND = 0.8
"""Bend of the field, in sides of a cell, below which cells of 64³ are halved by interpolation: it
saves a third of the queries and costs at most 0.0005 of IoU on 17 test views (docs/notebook.md)."""


@dataclass(frozen=True)
class ReconstructedMesh:
    """A closed surface in the frame of its cloud.

    Attributes:
        vertices: [V, 3] f8, m.
        faces: [F, 3] i4, counter-clockwise seen from outside.
        queries: Number of points at which the network was evaluated.
        parts_dropped: Number of parts dropped as too small.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    queries: int
    parts_dropped: int


def mesh_reconstruction(
    reconstruction: Reconstruction,
    resolution: int = 128,
    smallest_part: float = 0.05,
    smoothing: int = SMOOTHING,
    field: FieldFunction | None = None,
    exact: bool = False,
) -> ReconstructedMesh:
    """Mesh the zero level of a reconstruction.

    Without smoothing, a Newton step moves the vertices to the zero level, unless values beyond 128³
    are interpolated. With smoothing it is omitted: a network's field has small jumps, so an exact
    zero follows their ripples, and an interpolated one averages them (docs/notebook.md).

    Args:
        reconstruction: Reconstruction of one cloud.
        resolution: Cells along the box: 32 times a power of two, up to 512.
        smallest_part: Parts smaller than this share of the largest one's volume are dropped.
        smoothing: Number of smoothing passes (see `SMOOTHING`).
        field: Distances [N] m at points [N, 3] m of the cloud's frame to mesh instead of the
            reconstruction's own, within its box: the field of several views.
        exact: Evaluate every corner that decides the surface; otherwise some are interpolated (see
            `FINEST_EVALUATED` and `LARGEST_BEND`).

    Raises:
        EmptySurfaceError: The field has no inside.
        InputError: The resolution is not supported.
    """
    vessel = reconstruction.vessel
    if vessel is not None and field is None:
        return _vessel_mesh(reconstruction, vessel, resolution, smallest_part, smoothing)
    model = reconstruction.model
    rules = SearchRules() if model.gives_distances else SearchRules(slope=np.inf)
    interpolated = model.gives_distances and not exact and resolution > SMOOTH_FROM
    if interpolated:
        # An exact SDF's slope. A network is steeper in places, which hides a thousandth of the
        # crossed cells.
        rules = replace(rules, slope=1.0, smooth=LARGEST_BEND)
    config = IsosurfaceConfig(
        resolution,
        half_width=model.box,
        asked=FINEST_EVALUATED if interpolated else MAX_RESOLUTION,
        rules=rules,
        newton=smoothing == 0,
        smallest_part=smallest_part,
    )
    surface = extract_isosurface(network_field(reconstruction, field), config)
    smooth = taubin_smooth(surface.vertices, surface.faces, smoothing)
    vertices = _in_cloud_frame(reconstruction, smooth)
    return ReconstructedMesh(vertices, surface.faces, surface.queries, surface.parts_dropped)


def _vessel_mesh(
    reconstruction: Reconstruction,
    vessel: VesselField,
    resolution: int,
    smallest_part: float,
    smoothing: int,
) -> ReconstructedMesh:
    """The wall, however thin, and the network's mesh of the other parts, united."""
    queries, others = 0, None
    try:
        field = partial(vessel.other_parts, network=reconstruction.network_sdf)
        others = mesh_reconstruction(reconstruction, resolution, smallest_part, smoothing, field)
        queries = others.queries
    except EmptySurfaceError:
        pass  # a vessel without handles
    parts = None if others is None else (others.vertices, others.faces)
    vertices, faces, dropped = vessel_surface(vessel.vessel, parts, smallest_part)
    return ReconstructedMesh(vertices, faces, queries, dropped)


def network_field(
    reconstruction: Reconstruction, field: FieldFunction | None = None
) -> NetworkField:
    """The signed distance, or another field in the cloud's frame, as a function of points [N, 3] in
    the network's frame and units."""
    asked: FieldFunction = reconstruction.sdf if field is None else field

    def sdf(x: NDArray[np.float32]) -> NDArray[np.floating]:
        metres = asked(_in_cloud_frame(reconstruction, x))
        return metres * np.float32(reconstruction.scale)

    return sdf


def _in_cloud_frame(reconstruction: Reconstruction, x: NDArray[np.floating]) -> NDArray[np.float64]:
    # In float64: a metre away, float32 would move the points by a ten-thousandth of a fine cell.
    turned = x.astype(np.float64) @ reconstruction.R_frame_camera.T
    return turned / reconstruction.scale + reconstruction.centre
