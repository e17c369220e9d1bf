"""Completed views of an object, and what must hold its unseen side up."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from pointsdf_cli.camera.view import View
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.shape_model import ShapeModel
from pointsdf_cli.planning.grid import GridConfig
from pointsdf_cli.planning.support import hidden_below, stands
from pointsdf_cli.planning.target import ObjectField, absent_object, given_object


def completed(
    network: ShapeModel, views: Sequence[View], seed: int | Sequence[int]
) -> list[Reconstruction]:
    """Reconstructions, one a view, each from the points that `seed` draws of it."""
    return [
        Reconstruction.from_cloud(
            network,
            view.in_world,
            view.T_world_camera[:3, 3],
            view.T_world_camera[:3, :3],
            seed,
            view.evidence,
        )
        for view in views
    ]


def unseen_support(shape: ObjectField, views: Sequence[View]) -> Array:
    """Places [M, 3] where something unseen must hold a shape up; none where it stands by itself."""
    solid = shape.kept.inside()
    if not len(solid) or stands(shape.field, solid, shape.low, shape.high):
        return np.zeros((0, 3))
    return hidden_below(solid, [(view.T_world_camera[:3, 3], view.in_world) for view in views])


def given_constraint(
    field: Field | Literal["none"], points: Array, grid: GridConfig
) -> ObjectField:
    """A given field, or none, in place of that of the object seen at points [N, 3]."""
    if isinstance(field, str):
        return absent_object(points)
    return given_object(field, points, grid)
