"""The prior: rotations' volume, exact density, sampling, fitting that never degenerates."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from grasp_worlds import camera_pose, seen_ball, side_palm, top_palm
from scipy.integrate import quad
from scipy.spatial.transform import Rotation
from scipy.stats import multivariate_normal
from sklearn.mixture import GaussianMixture

from pointsdf_cli.errors import InputError
from pointsdf_cli.models.grasp_prior import LENGTH, GraspPrior, ObjectPlace
from pointsdf_cli.models.rotations import log_volume, rotation_of, rotation_vector
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.training.gs_data import GraspData
from pointsdf_cli.training.gs_prior import FEWEST, FLOORS, fit_prior, mean_rotation
from pointsdf_cli.training.gs_variants import prior_of

ROBOT = load_robot()
RANGES = ROBOT.preshape_ranges


def random_vectors(count: int, longest: float, seed: int = 0) -> torch.Tensor:
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return torch.tensor(directions * rng.uniform(0, longest, (count, 1)))


def test_rotation_vectors_agree_with_scipy_up_to_half_a_turn() -> None:
    vectors = random_vectors(200, np.pi - 1e-4)
    vectors[0] = 0.0
    rotations = rotation_of(vectors)
    assert np.allclose(rotations, Rotation.from_rotvec(vectors.numpy()).as_matrix(), atol=1e-12)
    assert torch.allclose(rotation_vector(rotations), vectors, atol=1e-7)


def test_rotation_vectors_can_be_differentiated_everywhere_below_half_a_turn() -> None:
    vectors = random_vectors(6, 3.0).requires_grad_(True)
    with torch.no_grad():
        vectors[0] = 0.0
    assert torch.autograd.gradcheck(lambda v: rotation_vector(rotation_of(v)), vectors[1:].detach()
                                    .requires_grad_(True))  # fmt: skip
    (gradient,) = torch.autograd.grad(rotation_vector(rotation_of(vectors)).sum(), vectors)
    assert torch.isfinite(gradient).all()


def test_all_rotations_together_have_the_volume_of_their_group() -> None:
    def shell(angle: float) -> float:
        density = log_volume(torch.tensor([angle, 0.0, 0.0], dtype=torch.float64)).exp()
        return float(density) * 4 * np.pi * angle**2

    whole, _ = quad(shell, 0, np.pi)
    assert abs(whole - 8 * np.pi**2) < 1e-6


def place(size: float = 0.1, azimuth: float = 0.3) -> ObjectPlace:
    centre = np.array([0.6 * np.cos(azimuth), 0.6 * np.sin(azimuth), size / 2])
    return ObjectPlace(torch.tensor(centre), torch.tensor(np.full(3, size)), azimuth)


def random_prior(seed: int = 0) -> GraspPrior:
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(2, 14, 14)) * 0.05
    factors = np.linalg.cholesky(roots @ roots.transpose(0, 2, 1) + 0.02 * np.eye(14))
    rotations = Rotation.random(2, random_state=seed).as_matrix()
    means = rng.normal(size=(2, 14)) * 0.1
    return GraspPrior(*map(torch.tensor, (np.array([0.3, 0.7]), rotations, means, factors, RANGES)))


def test_the_density_is_scipys_in_coordinates_worked_out_by_hand() -> None:
    prior, here = random_prior(), place()
    rng = np.random.default_rng(3)
    rotation = Rotation.random(6, random_state=4).as_matrix()
    position = here.centre.numpy() + rng.normal(size=(6, 3)) * 0.1
    preshape = rng.uniform(*RANGES.T, (6, 8))
    palm = np.tile(np.eye(4), (6, 1, 1))
    palm[:, :3, :3], palm[:, :3, 3] = rotation, position
    total = np.zeros(6)
    heading = Rotation.from_euler("z", here.azimuth).as_matrix()
    for k in range(2):
        offset = np.einsum("nji,nj->ni", rotation, here.centre.numpy() - position)
        # Half the extent of a cube of 0.1 m along the palm's x.
        offset[:, 0] -= 0.05 * np.abs(rotation[:, :, 0]).sum(1)
        turn = Rotation.from_matrix((heading @ prior.rotations[k].numpy()).T @ rotation).as_rotvec()
        joints = (preshape - RANGES.mean(1)) / np.ptp(RANGES, axis=1)
        y = np.hstack([offset / LENGTH, turn, joints])
        covariance = (prior.choleskys[k] @ prior.choleskys[k].T).numpy()
        angle = np.linalg.norm(turn, axis=1)
        volume = (2 - 2 * np.cos(angle)) / angle**2
        normal = multivariate_normal(prior.means[k].numpy(), covariance).pdf(y)
        total += float(prior.weights[k]) * normal / volume
    found = prior.log_density(torch.tensor(preshape), torch.tensor(palm), here)
    assert np.allclose(found, np.log(total), rtol=1e-9)


def test_the_density_is_differentiable() -> None:
    prior, here = random_prior(), place()
    preshape, palm = map(torch.tensor, prior.sample("side", 3, here, np.random.default_rng(0)))
    vectors = torch.zeros(3, 6, dtype=torch.float64, requires_grad=True)

    def density(joints: torch.Tensor, moved: torch.Tensor) -> torch.Tensor:
        pose = palm.clone()
        pose[:, :3, :3] = palm[:, :3, :3] @ rotation_of(moved[:, :3])
        pose[:, :3, 3] = palm[:, :3, 3] + moved[:, 3:]
        return prior.log_density(joints, pose, here)

    assert torch.autograd.gradcheck(density, (preshape.requires_grad_(True), vectors))


def test_samples_have_the_components_mean_and_spread() -> None:
    prior, here = random_prior(2), place()
    preshape, palm = prior.sample("top", 4000, here, np.random.default_rng(0))
    y = prior.coordinates(1, torch.tensor(preshape), torch.tensor(palm), here).numpy()
    covariance = (prior.choleskys[1] @ prior.choleskys[1].T).numpy()
    # Joints are clipped to their ranges, so only the pose is compared.
    assert np.allclose(y[:, :6].mean(0), prior.means[1, :6], atol=0.02)
    assert np.allclose(np.cov(y[:, :6].T), covariance[:6, :6], atol=0.01)
    assert (preshape >= RANGES[:, 0]).all()
    assert (preshape <= RANGES[:, 1]).all()
    with pytest.raises(InputError, match="no kind"):
        prior.sample("front", 1, here, np.random.default_rng(0))


def data(count: int, seed: int = 0, spread: float = 1.0):  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(seed)
    palms, places, preshape = [], [], []
    for k in range(count):
        here = place(float(rng.uniform(0.05, 0.15)), float(rng.uniform(-0.5, 0.5)))
        make = (side_palm, top_palm)[k % 2]
        towards = here.azimuth + spread * rng.normal() * 0.4
        palms.append(make(here.centre.numpy(), 0.02 + 0.01 * spread * rng.random(), 0.05, towards))
        places.append(here)
        preshape.append(
            RANGES.mean(1) + spread * rng.uniform(-0.4, 0.4, 8) * np.ptp(RANGES, axis=1)
        )
    return np.array(preshape), np.array(palms), np.arange(count) % 2, places


def test_a_fitted_component_is_scikit_learns_mixture() -> None:
    preshape, palm, kind, places = data(200)
    prior = fit_prior(preshape, palm, kind, places, RANGES)
    floors = np.repeat(FLOORS, (3, 3, 8))
    for k in range(2):
        rows = np.flatnonzero(kind == k)
        y = np.concatenate(
            [
                prior.coordinates(
                    k, torch.tensor(preshape[i : i + 1]), torch.tensor(palm[i : i + 1]), places[i]
                )
                for i in rows
            ]
        )
        mixture = GaussianMixture(1, reg_covar=1.0).fit(y / floors)
        expected = mixture.score_samples(y / floors) - np.log(floors).sum()
        own = multivariate_normal(
            prior.means[k].numpy(), (prior.choleskys[k] @ prior.choleskys[k].T).numpy()
        ).logpdf(y)
        assert np.allclose(own, expected)
    assert np.allclose(prior.weights, 0.5)


def test_grasps_that_are_all_alike_do_not_make_it_degenerate() -> None:
    preshape, palm, kind, places = data(40, spread=0.0)
    prior = fit_prior(preshape, palm, kind, places, RANGES)
    for factor in prior.choleskys:
        assert torch.linalg.eigvalsh(factor @ factor.T).min() >= 0.99 * min(FLOORS) ** 2
    found = prior.log_density(torch.tensor(preshape[:1]), torch.tensor(palm[:1]), places[0])
    assert torch.isfinite(found).all()


def test_a_kind_that_was_not_seen_has_no_weight() -> None:
    preshape, palm, kind, places = data(40)
    side = np.flatnonzero(kind == 0)
    prior = fit_prior(preshape[side], palm[side], kind[side], [places[i] for i in side], RANGES)
    assert prior.weights.tolist() == [1.0, 0.0]
    joints, palms = prior.sample("top", 5, places[0], np.random.default_rng(0))
    assert joints.shape == (0, preshape.shape[1])
    assert palms.shape == (0, 4, 4)
    with pytest.raises(InputError, match="too few"):
        fit_prior(preshape[:4], palm[:4], kind[:4], places[:4], RANGES)


def test_a_kind_that_rarely_holds_is_drawn_rarely_but_drawn(tmp_path: Path) -> None:
    preshape, palm, kind, _ = data(80)
    centre = np.array([0.6, 0.0, 0.04])
    pose = camera_pose(centre)
    cloud = seen_ball(centre, 0.04, pose, np.random.default_rng(0))[:100]
    held = (kind == 0) | (np.arange(80) < 5)  # top: two or three of forty
    grasps = GraspData(
        names=["ball"],
        files=[tmp_path],
        meshes=["ball"],
        held_out=np.array([False]),
        object_of=np.zeros(80, int),
        planned=np.zeros(80, bool),
        scene_of=np.zeros(80, int),
        preshape=preshape,
        T_world_palm=palm,
        T_world_camera=np.tile(pose, (80, 1, 1)),
        cloud=np.tile(cloud, (80, 1, 1)).astype(np.float32),
        kind=kind.astype(np.int8),
        label=held.astype(np.float32),
    )
    prior = prior_of(grasps, ROBOT)
    top = int((held & (kind == 1)).sum())
    assert 0 < top < FEWEST
    assert np.allclose(prior.weights, [40 / (40 + top), top / (40 + top)])
    # Its shape is that of all forty, not of two.
    alone = prior_of(replace(grasps, label=np.zeros(80, np.float32)), ROBOT)
    assert torch.allclose(prior.means[1], alone.means[1])
    assert np.allclose(alone.weights, 0.5)


def test_the_mean_of_turns_to_both_sides_is_between_them() -> None:
    turns = Rotation.from_euler("z", [[-0.5], [0.5], [0.1], [-0.1]]).as_matrix()
    assert np.allclose(mean_rotation(torch.tensor(turns)), np.eye(3), atol=1e-12)


def test_where_the_camera_stands_does_not_matter_and_the_robot_does() -> None:
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (100, 3)) + [0.0, 0.5, 0.05]
    here = ObjectPlace.of(points, np.zeros(3))
    assert abs(here.azimuth - np.pi / 2) < 0.05
    assert abs(float(here.extent.max()) - 0.1) < 0.005
