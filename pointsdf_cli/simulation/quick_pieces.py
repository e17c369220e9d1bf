"""Fine convex decomposition, in about a second.

CoACD searches for the best cuts and takes seconds. Here a solid is cut greedily: the part with the
largest excess of its hull is cut by the best of a few planes along its own axes, until the hulls
are close enough. manifold3d makes the cuts and keeps every part closed.
"""

from __future__ import annotations

import numpy as np
import trimesh
from manifold3d import Error, Manifold, Mesh
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.simulation.decomposition import Pieces, hull_of, with_few_corners, with_few_faces

MOST_PIECES = 64
"""Number of pieces that ends the cutting. With the sixteen of the collection a biplane's wings are
one block; with these, nine tenths of the hulls' surface are less than 2 mm outside the mesh."""
CLOSE_ENOUGH = 0.03
"""Excess of the hulls over the solid, as a share of its volume, that ends it."""
WORTH = 0.005
"""Least excess of a part's hull, as a share of the whole volume, that is cut. Shapes that are
convex apart from scanner noise stay one piece: cut in twenty, a can slid out of every grasp, since
each seam adds two contacts for a solver of few iterations."""
PLACES = (0.5, 0.25, 0.75, 0.125, 0.875)
"""Places of the cuts, as shares of a part's extent along each axis; the first of equally good cuts
is taken."""
MOST_CORNERS = 64
"""Largest number of corners of a piece."""
MOST_FACES = 3000
"""Number of faces to which the solid is simplified first."""
SLIVER = 1e-9
"""Smallest volume of a piece [m³]."""


def quick_pieces(vertices: Array, faces: NDArray[np.integer]) -> Pieces:
    """Decompose a closed mesh into convex pieces: for each, corners [V, 3] and faces [F, 3].

    A mesh that is not closed, or encloses nothing, is replaced by its convex hull.

    Raises:
        InputError: Its points lie in a plane.
    """
    solid = _solid(vertices, faces)
    if solid is None:
        hull = hull_of(vertices, SLIVER)
        if hull is None:
            raise InputError("the points span no volume")
        return [with_few_corners(hull, MOST_CORNERS)]
    parts = [_Part(solid)]
    whole = solid.volume()
    while len(parts) < MOST_PIECES:
        if sum(part.excess for part in parts) <= CLOSE_ENOUGH * whole:
            break
        worst = max(range(len(parts)), key=lambda k: parts[k].excess)
        cut = _best_cut(parts[worst])
        if cut is None or parts[worst].excess < WORTH * whole:
            parts[worst].excess = 0.0  # no plane helps: leave it as it is
            continue
        parts[worst : worst + 1] = cut
    hulls = [hull_of(_corners(part.hull), SLIVER) for part in parts]
    return [with_few_corners(hull, MOST_CORNERS) for hull in hulls if hull is not None]


class _Part:
    """A solid, its hull, and the excess volume of the hull [m³]."""

    def __init__(self, solid: Manifold) -> None:
        self.solid = solid
        self.hull = solid.hull()
        self.excess = float(self.hull.volume() - solid.volume())


def _best_cut(part: _Part) -> list[_Part] | None:
    """Parts with the least excess, among cuts along the part's principal axes."""
    corners = _corners(part.solid)
    _, axes = np.linalg.eigh(np.cov(corners.T))
    best: list[_Part] | None = None
    # A cut may gain nothing: halves of a ring have as much excess as the ring, quarters less.
    least = 1.001 * part.excess
    for axis in axes.T[::-1]:  # the longest first
        along = corners @ axis
        for place in PLACES:
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


def _solid(vertices: Array, faces: NDArray[np.integer]) -> Manifold | None:
    """The mesh as a closed solid of few faces; None if it is not closed."""
    mesh = with_few_faces(trimesh.Trimesh(vertices, faces, process=False), MOST_FACES)
    if not mesh.is_watertight:
        mesh = trimesh.Trimesh(vertices, faces, process=False)
    solid = Manifold(Mesh(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32)))
    if solid.status() != Error.NoError or solid.volume() <= 0:
        return None
    return solid


def _corners(solid: Manifold) -> Array:
    return np.asarray(solid.to_mesh().vert_properties)[:, :3].astype(float)
