"""Convex decomposition of a reconstruction in a fraction of a second, for rehearsals.

CoACD searches for the best cuts and takes seconds. Here a solid is cut greedily: the part with the
largest excess of its hull is cut by the best of a few planes along its own axes, until the hulls
are close enough. manifold3d makes the cuts and keeps every part closed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from manifold3d import Error, Manifold, Mesh
from numpy.typing import NDArray
from scipy.spatial import QhullError

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.simulation.decomposition import Pieces, with_few_corners, with_few_faces

SLIVER = 1e-9
"""Smallest volume of a piece [m³]."""


@dataclass(frozen=True)
class QuickCutConfig:
    """Settings of the decomposition.

    Attributes:
        most_pieces: Number of pieces that ends the cutting.
        close_enough: Excess of the hulls over the solid, as a share of its volume, that ends it.
        worth: Least excess of a part's hull, as a share of the whole volume, that is cut.
        places: Places of the cuts, as shares of a part's extent along each axis; the first of
            equally good cuts is taken.
        most_corners: Largest number of corners of a piece.
        most_faces: Number of faces to which the solid is simplified first.
    """

    most_pieces: int = 8
    close_enough: float = 0.08
    worth: float = 0.02
    places: tuple[float, ...] = (0.5, 0.25, 0.75)
    most_corners: int = 40
    most_faces: int = 500

    def __post_init__(self) -> None:
        if self.most_pieces < 1 or not all(0 < place < 1 for place in self.places):
            raise InputError(f"{self}", allowed="one piece or more, places between 0 and 1")


def quick_pieces(
    vertices: Array, faces: NDArray[np.integer], config: QuickCutConfig | None = None
) -> Pieces:
    """Decompose a closed mesh into convex pieces: for each, corners [V, 3] and faces [F, 3].

    A mesh that is not closed, or encloses nothing, is replaced by its convex hull.

    Raises:
        InputError: Its points lie in a plane.
    """
    config = config or QuickCutConfig()
    solid = _solid(vertices, faces, config.most_faces)
    if solid is None:
        return [with_few_corners(_hull(vertices), config.most_corners)]
    parts = [_Part(solid)]
    whole = solid.volume()
    while len(parts) < config.most_pieces:
        if sum(part.excess for part in parts) <= config.close_enough * whole:
            break
        worst = max(range(len(parts)), key=lambda k: parts[k].excess)
        cut = _best_cut(parts[worst], config.places)
        if cut is None or parts[worst].excess < config.worth * whole:
            parts[worst].excess = 0.0  # no plane helps: leave it as it is
            continue
        parts[worst : worst + 1] = cut
    pieces = []
    for part in parts:
        try:
            hull = _hull(np.asarray(part.hull.to_mesh().vert_properties)[:, :3])
        except InputError:
            continue  # a sliver: nothing to collide with
        pieces.append(with_few_corners(hull, config.most_corners))
    return pieces


class _Part:
    """A solid, its hull, and the excess volume of the hull [m³]."""

    def __init__(self, solid: Manifold) -> None:
        self.solid = solid
        self.hull = solid.hull()
        self.excess = float(self.hull.volume() - solid.volume())


def _best_cut(part: _Part, places: tuple[float, ...]) -> list[_Part] | None:
    """Parts with the least excess, among cuts along the part's principal axes."""
    corners = np.asarray(part.solid.to_mesh().vert_properties)[:, :3].astype(float)
    _, axes = np.linalg.eigh(np.cov(corners.T))
    best: list[_Part] | None = None
    # A cut may gain nothing: halves of a ring have as much excess as the ring, quarters less.
    least = 1.001 * part.excess
    for axis in axes.T[::-1]:  # the longest first
        along = corners @ axis
        for place in places:
            offset = float(along.min() + place * np.ptp(along))
            halves = part.solid.split_by_plane(tuple(axis.tolist()), offset)
            if any(half.is_empty() for half in halves):
                continue
            # The feet of an arch are two parts, not one with a hull across the opening.
            parts = [_Part(piece) for half in halves for piece in half.decompose()]
            excess = sum(one.excess for one in parts)
            if excess < least - 1e-4 * part.excess:
                best, least = parts, excess
    return best


def _solid(vertices: Array, faces: NDArray[np.integer], most_faces: int) -> Manifold | None:
    """The mesh as a closed solid of few faces; None if it is not closed."""
    mesh = with_few_faces(trimesh.Trimesh(vertices, faces, process=False), most_faces)
    if not mesh.is_watertight:
        mesh = trimesh.Trimesh(vertices, faces, process=False)
    solid = Manifold(Mesh(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32)))
    if solid.status() != Error.NoError or solid.volume() <= 0:
        return None
    return solid


def _hull(points: Any) -> trimesh.Trimesh:
    try:
        hull = trimesh.convex.convex_hull(np.asarray(points, dtype=float))
    except (ValueError, QhullError) as error:
        raise InputError("the points span no volume") from error
    if not hull.volume > SLIVER:
        raise InputError("the points span no volume")
    return hull
