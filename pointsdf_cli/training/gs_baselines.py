"""Baselines of a success network: constant, prior alone, nearest neighbours."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pointsdf_cli.models.grasp_prior import GraspPrior
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.training.gs_data import GraspData
from pointsdf_cli.training.gs_inputs import pose_numbers
from pointsdf_cli.training.gs_variants import places_of

NEIGHBOURS = 10


def always(data: GraspData, known: NDArray[np.int64]) -> NDArray[np.float64]:
    """Constant score [N]: the share of known grasps that held."""
    return np.full(len(data), float(data.label[known].mean()))


def prior_score(data: GraspData, prior: GraspPrior, robot: RobotDescription) -> NDArray[np.float64]:
    """Log density [N] of every grasp under the prior."""
    found = np.zeros(len(data))
    places = places_of(data, robot)
    preshape, palm = torch.tensor(data.preshape), torch.tensor(data.T_world_palm)
    first = np.unique(data.scene_of, return_index=True)[1]
    for row in first:
        rows = np.flatnonzero(data.scene_of == data.scene_of[row])
        found[rows] = prior.log_density(preshape[rows], palm[rows], places[row]).numpy()
    return found


def nearest_neighbours(data: GraspData, known: NDArray[np.int64]) -> NDArray[np.float64]:
    """Share held of the 10 known grasps nearest to each [N] by configuration and cloud size.

    Distances are between the published network's inputs without the embedding: preshape, palm in
    the object's frame, size of the cloud; each is scaled to unit deviation. A grasp is not its own
    neighbour.
    """
    centre = (data.cloud.min(axis=1) + data.cloud.max(axis=1)) / 2
    extent = np.ptp(data.cloud, axis=1).astype(np.float64)
    numbers, size = pose_numbers(data, centre.astype(np.float64), 1.0 / extent.max(axis=1))
    inputs = torch.cat([numbers, size], dim=1).double().numpy()
    scaled = (inputs - inputs[known].mean(0)) / (inputs[known].std(0) + 1e-9)
    count = min(NEIGHBOURS, len(known) - 1)
    _, near = cKDTree(scaled[known]).query(scaled, k=count + 1)
    neighbours = known[near]
    own = neighbours == np.arange(len(data))[:, None]
    # Drop the grasp itself, which comes first if known, or else the farthest of the eleven.
    own[~own.any(axis=1), -1] = True
    return data.label[neighbours[~own].reshape(len(data), count)].mean(axis=1)
