"""Completed views of an object, and unseen space that must hold its support."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pointsdf_cli.camera.view import View
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.shape_model import ShapeModel
from pointsdf_cli.planning.support import hidden_below, stands
from pointsdf_cli.planning.target import ObjectField


def completed(network: ShapeModel, view: View, seed: int | Sequence[int]) -> Reconstruction:
    """The object of one view in the world, from points sampled with `seed`."""
    return Reconstruction.from_cloud(
        network,
        view.in_world,
        view.T_world_camera[:3, 3],
        view.T_world_camera[:3, :3],
        seed,
        view.evidence,
    )


def unseen_support(shape: ObjectField, views: Sequence[View]) -> Array:
    """Points [M, 3] in unseen space below a shape that could not stand; none if it could."""
    solid = shape.kept.inside()
    if not len(solid) or stands(shape.field, shape.kept, solid, shape.low, shape.high):
        return np.zeros((0, 3))
    return hidden_below(solid, [(view.T_world_camera[:3, 3], view.in_world) for view in views])
