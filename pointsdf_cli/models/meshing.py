"""A reconstruction's surface as a mesh in metres: the field, extracted in the network's own frame.

In that frame every object has the same size, so one grid and one set of tolerances serve all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.isosurface import IsosurfaceConfig, extract_isosurface
from pointsdf_cli.geometry.mise import SearchRules
from pointsdf_cli.models.reconstruction import Reconstruction


@dataclass(frozen=True)
class ReconstructedMesh:
    """A closed surface in the frame of the cloud that it was made from.

    Attributes:
        vertices: [V, 3] f8, m.
        faces: [F, 3] i4, counter-clockwise seen from outside.
        queries: Points that the network was asked for.
        parts_dropped: Parts too small to keep.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    queries: int
    parts_dropped: int


def mesh_reconstruction(
    reconstruction: Reconstruction, resolution: int = 128, smallest_part: float = 0.05
) -> ReconstructedMesh:
    """The zero level of a reconstruction.

    Args:
        reconstruction: Of one cloud.
        resolution: Cells along the box: 32 times a power of two, up to 512.
        smallest_part: Parts smaller than this share of the largest one's volume are dropped.

    Raises:
        EmptySurfaceError: The network sees no inside.
        InputError: A resolution that there is no grid of.
    """
    model = reconstruction.model
    config = IsosurfaceConfig(
        resolution,
        half_width=model.half_width,
        # Interpolated logits say on which side a point lies, but not how far from the surface.
        rules=SearchRules() if model.is_distance else SearchRules(slope=np.inf),
        smallest_part=smallest_part,
    )
    surface = extract_isosurface(reconstruction.sdf_network, config)
    return ReconstructedMesh(
        vertices=reconstruction.frame.to_metres(surface.vertices),
        faces=surface.faces,
        queries=surface.queries,
        parts_dropped=surface.parts_dropped,
    )
