"""An object for planning: a field that may not be touched, and a score of its grasps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from pointsdf_cli.camera.view import View
from pointsdf_cli.errors import EmptyResultError, InputError
from pointsdf_cli.geometry.arrays import Array, Surface
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.geometry.smoothing import taubin_smooth
from pointsdf_cli.models.meshing import SMOOTHING, mesh_reconstruction
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.shape_model import ShapeModel
from pointsdf_cli.planning.fields import (
    MeanField,
    MeshField,
    NearField,
    ReconstructionField,
    RedistancedField,
    SeenField,
    UnionField,
)
from pointsdf_cli.planning.grid import GridConfig, GridField, grid_surface, surface_box
from pointsdf_cli.planning.objective import GraspScore
from pointsdf_cli.planning.partial_view import partial_mesh
from pointsdf_cli.planning.seeds import GraspSampler

BOX_MARGIN = 0.01
"""Margin of the box around a reconstruction's surface [m]; outside it, distances are bounded by the
distance to the box."""

KEPT_GRID = GridConfig(step=0.01, levels=3, band=0.0)
"""Grid of an object's field."""

FINEST = 0.004
"""Smallest cells [m] of the grid of a thin object."""

CELLS_ACROSS = 5
"""Number of cells across the thinnest side of an object: a fork lies between the nodes of a grid
that is fine enough for a box."""


MOST_CELLS = 400_000
"""Largest number of the grid's finest cells: larger objects get larger cells."""

MISSED, MOST_MISSED = 0.008, 0.2
"""Distance [m] to the nearest vertex of the surface above which a seen point counts as missed, and
the share of missed points above which a plan carries a warning."""

COARSE_RESOLUTION = 64
"""Cells along the box of a vessel's handle."""

GIVEN_REACH = 0.25
"""Distance [m] from the seen points within which a given field's surface is searched."""


class EmptyFieldError(EmptyResultError):
    """The field has no inside: there is nothing to grasp."""


class NoField:
    """Field without an object: large distances everywhere."""

    def __call__(self, points: Array) -> Array:
        return np.ones(len(points))

    def with_gradient(self, points: Array) -> tuple[Array, Array]:
        return np.ones(len(points)), np.zeros((len(points), 3))


@dataclass(frozen=True)
class ObjectField:
    """The space an object occupies, as far as known.

    Attributes:
        field: Its signed distance field, world frame.
        low, high: [3], a box [m] around its surface.
        kept: The field on a grid, for frequent evaluations that need not be exact.
        surface: Its surface: vertices [V, 3] m in the world and faces [F, 3]; None where it is not
            made yet.
    """

    field: Field
    low: Array
    high: Array
    kept: GridField
    surface: Surface | None = None

    @classmethod
    def of(
        cls, field: Field, low: Array, high: Array, grid: GridConfig | None = None
    ) -> ObjectField:
        """Sample `field` on a grid within the box of `low` and `high` [3]."""
        grid = grid or KEPT_GRID
        cells = float(np.prod((np.asarray(high) - low) / grid.step))
        grid = replace(grid, step=grid.step * max(1.0, (cells / MOST_CELLS) ** (1 / 3)))
        return cls(field, low, high, GridField(field, low, high, grid))


@dataclass(frozen=True)
class Target:
    """One object to be grasped.

    Attributes:
        field: Signed distance field that the robot may not enter, world frame.
        low, high: [3], a box [m] around its surface.
        score: Score of its grasps.
        prior: Source of seeds.
        kept: The field on a grid; the planner makes one where it is None.
        surface: As in `ObjectField`.
    """

    field: Field
    low: Array
    high: Array
    score: GraspScore
    prior: GraspSampler
    kept: GridField | None = None
    surface: Surface | None = None

    @classmethod
    def of(cls, shape: ObjectField, score: GraspScore, prior: GraspSampler) -> Target:
        """A target that occupies `shape`."""
        return cls(shape.field, shape.low, shape.high, score, prior, shape.kept, shape.surface)


def grid_for(thickness: float) -> GridConfig:
    """Grid for an object with this thinnest seen side [m]."""
    step = float(np.clip(thickness / CELLS_ACROSS, FINEST, KEPT_GRID.step))
    return replace(KEPT_GRID, step=step)


def completed(network: ShapeModel, view: View, seed: int | Sequence[int]) -> Reconstruction:
    """The object of one view in the world, from points sampled with `seed`."""
    eye, turn = view.T_world_camera[:3, 3], view.T_world_camera[:3, :3]
    return Reconstruction.from_cloud(network, view.in_world, eye, turn, seed, view.evidence)


def reconstructed_object(
    reconstructions: Sequence[Reconstruction],
    grid: GridConfig | None = None,
    seen: Array | None = None,
) -> ObjectField:
    """An object completed by a network from one view or more, in the world's frame.

    Args:
        reconstructions: Reconstructions, one for each view.
        grid: Grid of the field.
        seen: Points [N, 3] m that the box must enclose besides the surface.

    Raises:
        EmptyFieldError: The network sees nothing solid.
    """
    # The network was trained in a box of ±0.6 (`sdf_sampling.py`), its meshes reach to ±0.8.
    low = np.min([r.centre - 0.75 / r.scale for r in reconstructions], axis=0)
    high = np.max([r.centre + 0.75 / r.scale for r in reconstructions], axis=0)
    step = 0.15 / max(r.scale for r in reconstructions)
    quick = _mean_field([each.in_fast_precision for each in reconstructions])
    low, high = _surface_box(quick, low, high, step)
    if seen is not None:
        low, high = np.minimum(low, seen.min(axis=0)), np.maximum(high, seen.max(axis=0))
    low, high = low - BOX_MARGIN, high + BOX_MARGIN
    return _near(ObjectField.of(_mean_field(reconstructions), low, high, grid))


def enclosing(
    shape: ObjectField,
    reconstructions: Sequence[Reconstruction],
    seen: Array,
    grid: GridConfig | None = None,
) -> ObjectField:
    """A reconstructed object, in a box that encloses further points.

    Args:
        shape: Made by `reconstructed_object` of these.
        reconstructions, grid: As there.
        seen: [M, 3], world, m.
    """
    low = np.minimum(shape.low, seen.min(axis=0) - BOX_MARGIN)
    high = np.maximum(shape.high, seen.max(axis=0) + BOX_MARGIN)
    if (low == shape.low).all() and (high == shape.high).all():
        return shape
    return _near(ObjectField.of(_mean_field(reconstructions), low, high, grid))


def _near(shape: ObjectField) -> ObjectField:
    """The object with its field asked near its box only."""
    return replace(shape, field=NearField(shape.field, shape.low, shape.high))


def _mean_field(reconstructions: Sequence[Reconstruction]) -> Field:
    # The mean of two walls thinner than their distance has no inside.
    walls = [reconstruction for reconstruction in reconstructions if reconstruction.vessel]
    fields = [ReconstructionField(each) for each in walls[:1] or reconstructions]
    return fields[0] if len(fields) == 1 else MeanField(fields)


def with_seen_points(shape: ObjectField, seen: Array) -> ObjectField:
    """Add the seen points to an object: a network's surface may miss a thin part that the camera
    saw.

    Args:
        shape: An object with a box that encloses the points.
        seen: [N, 3], world, m.
    """
    points = SeenField(seen)
    field = UnionField(shape.field, points)
    return replace(shape, field=field, kept=shape.kept.minimum_with(points))


def with_surface(
    shape: ObjectField, reconstructions: Sequence[Reconstruction], seen: Array
) -> ObjectField:
    """Add the surface to a reconstructed object, and correct its field far from it.

    Args:
        shape: An object with its seen points.
        reconstructions: Its reconstructions, one for each view.
        seen: The seen points [N, 3], world, m.
    """
    if not any(each.vessel for each in reconstructions):
        return redistanced(shape, seen)
    # The grid is too coarse for the wall of a vessel; fields of several views have no single wall.
    if len(reconstructions) > 1:
        return shape
    wall = mesh_reconstruction(reconstructions[0], COARSE_RESOLUTION)
    return replace(shape, surface=(wall.vertices, wall.faces))


def redistanced(shape: ObjectField, seen: Array) -> ObjectField:
    """Correct a field where it is far from its own surface (`RedistancedField`).

    Args:
        shape: An object with its seen points.
        seen: These points [N, 3], world, m.
    """
    surface = grid_surface(shape.kept, shape.field)
    if surface is None:
        return shape
    field = RedistancedField(shape.field, np.concatenate([surface[0], seen]), shape.kept)
    kept = shape.kept.raised(field.least, RedistancedField.ENOUGH + RedistancedField.MARGIN)
    smooth = taubin_smooth(*surface, SMOOTHING), surface[1]
    return replace(shape, field=field, kept=kept, surface=smooth)


def seen_object(points: Array, grid: GridConfig | None = None) -> ObjectField:
    """The seen points [N, 3] (world, m) alone, meshed at 32³: partial-view grasping."""
    vertices, faces = partial_mesh(points)
    low, high = vertices.min(axis=0) - BOX_MARGIN, vertices.max(axis=0) + BOX_MARGIN
    return ObjectField.of(MeshField(vertices, faces), low, high, grid)


def given_object(field: Field, points: Array, grid: GridConfig | None = None) -> ObjectField:
    """Any field of an object that was seen at points [N, 3] of the world.

    Raises:
        EmptyFieldError: The field has no inside near the points.
    """
    low, high = points.min(axis=0) - GIVEN_REACH, points.max(axis=0) + GIVEN_REACH
    low, high = _surface_box(field, low, high, 0.02)
    return ObjectField.of(field, low - BOX_MARGIN, high + BOX_MARGIN, grid)


def absent_object(points: Array) -> ObjectField:
    """An object field without an object at points [N, 3]: planning without the constraint."""
    return ObjectField.of(NoField(), points.min(axis=0), points.max(axis=0) + BOX_MARGIN)


def surface_of(target: Target) -> Surface | None:
    """Surface of the target's field: vertices [V, 3] m in the world and faces [F, 3], or None
    without one."""
    if target.surface is not None:
        return target.surface
    grid = target.kept or GridField(target.field, target.low, target.high, KEPT_GRID)
    surface = grid_surface(grid, target.field)
    return surface and (taubin_smooth(*surface, SMOOTHING), surface[1])


def missed_points(surface: Surface | None, seen: Array) -> list[str]:
    """A sentence if a surface lacks many of the seen points [N, 3]; world frame, m."""
    missed = 1.0
    if surface is not None and len(surface[0]):
        missed = float((scipy.spatial.KDTree(surface[0]).query(seen)[0] > MISSED).mean())
    if missed <= MOST_MISSED:
        return []
    return [
        f"the reconstruction misses {missed:.0%} of the seen points, which is common for thin walls"
    ]


def _surface_box(field: Field, low: Array, high: Array, step: float) -> tuple[Array, Array]:
    try:
        return surface_box(field, low, high, step)
    except InputError as error:
        raise EmptyFieldError("the network sees nothing solid in this cloud") from error
