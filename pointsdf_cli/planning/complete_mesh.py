"""Complete one object in a view to a mesh: the computation of `rgrasp mesh`."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import torch

from pointsdf_cli.geometry.isosurface import EmptySurfaceError
from pointsdf_cli.models.meshing import ReconstructedMesh, mesh_reconstruction
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.shape_model import ShapeModel
from pointsdf_cli.planning.mesh_choices import MeshChoices
from pointsdf_cli.planning.object_view import ObjectView
from pointsdf_cli.planning.target import missed_points
from pointsdf_cli.training.precision import autocast_dtype

MOST_FACES = 200_000
"""Largest number of faces whose distances from the seen points are compared."""


@dataclass(frozen=True)
class CompletedMesh:
    """A mesh and its reconstruction.

    Attributes:
        mesh: The mesh, camera frame, m.
        reconstruction: Reconstruction with the mesh's field.
        seconds: Duration of the computation [s].
        warnings: Sentences about a mesh that lacks many of the seen points.
    """

    mesh: ReconstructedMesh
    reconstruction: Reconstruction
    seconds: float
    warnings: tuple[str, ...] = ()


def complete_mesh(
    model: ShapeModel, view: ObjectView, choices: MeshChoices, name: str
) -> CompletedMesh:
    """The object's whole surface in the camera's frame.

    Args:
        model: The loaded network.
        view: The object.
        choices: Meshing options.
        name: Name of the cloud, for messages.

    Raises:
        EmptySurfaceError: The network sees nothing solid.
        InputError: The resolution or the precision is not supported.
    """
    device = next(model.parameters()).device
    low_precision = autocast_dtype(choices.precision, torch.device(device))
    started = time.perf_counter()
    reconstruction = Reconstruction.from_cloud(
        model, view.points, np.zeros(3), seed=choices.seed, evidence=view.evidence
    ).in_precision(low_precision)
    try:
        least, smooth, exact = 0.0 if choices.all_parts else 0.05, choices.smooth, choices.exact
        made = mesh_reconstruction(reconstruction, choices.resolution, least, smooth, exact=exact)
    except EmptySurfaceError as error:
        nothing = "the network sees nothing solid in this cloud, so there is no mesh"
        hint = "check that the cloud shows one object, in metres, in the camera's frame"
        raise EmptySurfaceError(nothing, where=name, hint=hint) from error
    return CompletedMesh(made, reconstruction, time.perf_counter() - started, _missed(made, view))


def _missed(made: ReconstructedMesh, view: ObjectView) -> tuple[str, ...]:
    """A warning if the mesh lacks many of the seen points."""
    # Vertices of coarse meshes lie far apart; of fine ones, some of the faces are enough.
    faces = made.faces[:: 1 + len(made.faces) // MOST_FACES]
    centres = made.vertices[faces].mean(axis=1)
    return tuple(
        f"{sentence}, and for clouds whose frame is not the camera's"
        for sentence in missed_points((centres, faces), view.points)
    )
