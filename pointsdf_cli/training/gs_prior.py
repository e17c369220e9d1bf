"""Fitting the prior over grasps (`models/grasp_prior.py`) to data."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from sklearn.mixture import GaussianMixture
from torch import Tensor

from pointsdf_cli.choices import GRASP_KINDS
from pointsdf_cli.errors import InputError
from pointsdf_cli.models.grasp_prior import GraspPrior, ObjectPlace

FLOORS = (0.1, 0.1, 0.1)
"""Smallest standard deviations, whose squares are added to the fitted variances: of the offset (in
units of 0.1 m), of the rotation [rad], of the preshape (in widths of its ranges)."""

FEWEST = 8
"""Least number of grasps for a component."""


def fit_prior(
    preshape: NDArray[np.float64],
    T_world_palm: NDArray[np.float64],
    kind: NDArray[np.integer],
    places: Sequence[ObjectPlace],
    ranges: NDArray[np.float64],
    shares: NDArray[np.integer] | None = None,
) -> GraspPrior:
    """Fit one Gaussian for each kind, in the chart about that kind's mean rotation.

    Scikit-learn fits each (`GaussianMixture` of one component with `reg_covar`); coordinates are
    scaled so that its single regulariser gives `FLOORS`.

    Args:
        preshape: [N, K], rad.
        T_world_palm: [N, 4, 4].
        kind: [N], indices into `GRASP_KINDS`.
        places: Places of the N grasps' objects.
        ranges: [K, 2], ranges of the preshape joints.
        shares: Relative frequency of each kind; its frequency in the data if None.

    Raises:
        InputError: Fewer than `FEWEST` grasps of every kind.
    """
    joints = preshape.shape[1]
    size = 6 + joints
    floors = np.repeat(FLOORS, (3, 3, joints))
    weights = np.array([(kind == k).sum() for k in range(len(GRASP_KINDS))], dtype=float)
    few = weights < FEWEST
    weights = weights if shares is None else np.asarray(shares, dtype=float)
    weights[few] = 0.0
    if not weights.any():
        raise InputError(
            f"{len(kind)} grasps are too few for a prior",
            allowed=f"{FEWEST} or more executed ones of one kind, of objects that are not held out",
            hint="collect more: rgrasp collect-grasps with a larger --count, into the same folder",
        )
    rotations = torch.eye(3, dtype=torch.float64).repeat(len(GRASP_KINDS), 1, 1)
    means = torch.zeros(len(GRASP_KINDS), size, dtype=torch.float64)
    factors = torch.eye(size, dtype=torch.float64).repeat(len(GRASP_KINDS), 1, 1)
    prior = GraspPrior(
        torch.tensor(weights / weights.sum()), rotations, means, factors, torch.tensor(ranges)
    )
    for k in np.flatnonzero(weights):
        chosen = np.flatnonzero(kind == k)
        theirs = [places[i] for i in chosen.tolist()]
        palm = torch.tensor(T_world_palm[chosen])
        _fit_kind(prior, int(k), torch.tensor(preshape[chosen]), palm, theirs, floors)
    return prior


def _fit_kind(
    prior: GraspPrior,
    k: int,
    preshape: Tensor,
    palm: Tensor,
    places: Sequence[ObjectPlace],
    floors: NDArray[np.float64],
) -> None:
    """Fit the Gaussian of one kind to its grasps: preshape [n, K], palm [n, 4, 4]."""
    headings = torch.stack(
        [place.heading().T @ pose[:3, :3] for place, pose in zip(places, palm, strict=True)]
    )
    prior.rotations[k] = mean_rotation(headings)
    grasps = zip(preshape.split(1), palm.split(1), places, strict=True)
    y = torch.cat([prior.coordinates(k, *grasp) for grasp in grasps]).numpy()
    mixture = GaussianMixture(1, covariance_type="full", reg_covar=1.0).fit(y / floors)
    prior.means[k] = torch.tensor(mixture.means_[0] * floors)
    covariance = mixture.covariances_[0] * np.outer(floors, floors)
    prior.choleskys[k] = torch.linalg.cholesky(torch.tensor(covariance))


def mean_rotation(rotations: Tensor) -> Tensor:
    """The rotation [3, 3] nearest to all of [N, 3, 3] by squared chord length."""
    return torch.tensor(Rotation.from_matrix(rotations.numpy()).mean().as_matrix())
