"""The closing hand: where its points are before, while and after it closes; any hand will do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import apply_transform, invert_transform, transform
from pointsdf_cli.models.hand_sweep import HandSweep, SweepConfig
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.robot.surface import robot_surface

ROBOT = load_robot()
SWEEP = HandSweep(ROBOT)
GRIPPER = Path(__file__).parent / "robots" / "gripper.yaml"


def preshapes(count: int, seed: int = 0) -> torch.Tensor:
    low, high = ROBOT.preshape_ranges.T
    return torch.tensor(np.random.default_rng(seed).uniform(low, high, (count, len(low)))).float()


def test_before_closing_points_lie_within_the_links_of_the_whole_robot() -> None:
    preshape = preshapes(1)
    q = torch.tensor(ROBOT.configuration(ROBOT.home[ROBOT.arm], preshape[0].double().numpy()))
    kinematics = Kinematics(ROBOT)
    surface = robot_surface(ROBOT)
    links = [(link, torch.tensor(surface[link])) for link in ROBOT.hand_links if link in surface]
    hand = apply_transform(
        invert_transform(kinematics.palm(q).numpy()),
        torch.cat(kinematics.points(q, links)).numpy(),
    )
    still, moving = SWEEP(preshape)
    for point in torch.cat([still[0], moving[0, 0]]).numpy():
        # A link is at most 12 cm wide, so a point on its middle has surface within 6 cm.
        assert np.linalg.norm(hand - point, axis=1).min() < 0.035
    assert (moving[0, 0].numpy().max(0) <= hand.max(0)).all()
    assert (moving[0, 0].numpy().min(0) >= hand.min(0)).all()


def test_closing_brings_the_fingers_over_the_palm() -> None:
    _, moving = SWEEP(preshapes(5))
    # The palm's z runs along the fingers: open, they reach out; closed, they have turned back.
    farthest = moving[..., 2].amax(-1)
    assert (farthest[:, 0] > 0.12).all()
    assert (farthest[:, -1] < farthest[:, 0] - 0.03).all()


def test_two_jaws_slide_as_fast_as_their_description_says_until_they_stop() -> None:
    gripper = load_robot(GRIPPER)
    sweep = HandSweep(gripper, SweepConfig(stages=10, share=1.0))
    _, moving = sweep(torch.tensor([[0.0], [0.02]]))
    left, right = moving[..., 0, 1], moving[..., 5, 1]  # the middles of their pads
    # The inner sides of both jaws start 4.5 cm from the middle, and slide 4.5 cm at 5 cm/s; the
    # left may start closer.
    # The grid of times ends when a left jaw that starts at 1 cm arrives (35 mm) or the right (45).
    steps = torch.linspace(0.0, 0.045, 10)
    assert torch.allclose(right, (-0.045 + steps).expand(2, -1), atol=1e-6)
    assert torch.allclose(left[0], 0.045 - steps, atol=1e-6)
    assert torch.allclose(left[1], 0.045 - (0.02 + steps).clamp(max=0.045), atol=1e-6)


def test_gradients_are_those_of_finite_differences() -> None:
    # Away from the joints' limits, where closing stops and the slope jumps.
    middle = torch.tensor(ROBOT.preshape_ranges.mean(1)).float()
    preshape = (0.8 * preshapes(3) + 0.2 * middle).requires_grad_(True)
    weights = torch.randn(3, 8, SWEEP.sizes[1], 3, generator=torch.manual_seed(0))
    (gradient,) = torch.autograd.grad((SWEEP(preshape)[1] * weights).sum(), preshape)
    for joint in range(preshape.shape[1]):
        step = torch.zeros(8)
        step[joint] = 0.002
        with torch.no_grad():
            ahead, behind = SWEEP(preshape + step)[1], SWEEP(preshape - step)[1]
        slope = ((ahead - behind) * weights).sum((1, 2, 3)) / 0.004
        assert torch.allclose(slope, gradient[:, joint], atol=2e-3, rtol=1e-3)


def test_points_move_with_the_palm_and_ask_it_for_a_force_and_a_moment() -> None:
    preshape = preshapes(2)
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1.0]])
    palm = torch.tensor(transform(turn, [0.3, -0.2, 0.5]), dtype=torch.float32).repeat(2, 1, 1)
    palm.requires_grad_(True)
    still, moving = SWEEP(preshape)
    in_palm = torch.cat([moving.flatten(1, 2), still, SWEEP.region.expand(2, -1, -1)], dim=1)
    points = SWEEP.in_world(preshape, palm)
    expected = apply_transform(transform(turn, [0.3, -0.2, 0.5]), in_palm.numpy())
    assert np.allclose(points.detach().numpy(), expected, atol=1e-6)
    weights = torch.randn(points.shape, generator=torch.manual_seed(1))
    (slope,) = torch.autograd.grad((points * weights).sum(), palm)
    assert torch.allclose(slope[:, :3, 3], weights.sum(1), atol=1e-4)
    assert torch.allclose(slope[:, :3, :3], weights.transpose(1, 2) @ in_palm, atol=1e-4)
    assert (slope[:, 3] == 0).all()


def test_a_sliding_jaw_follows_its_joint_until_closing_has_driven_it_to_its_limit() -> None:
    gripper = load_robot(GRIPPER)
    sweep = HandSweep(gripper, SweepConfig(stages=10, share=1.0))
    preshape = torch.tensor([[0.02]], requires_grad=True)
    for stage, expected in ((0, -1.0), (2, -1.0), (9, 0.0)):
        y = sweep(preshape)[1][0, stage, 0, 1]
        (slope,) = torch.autograd.grad(y, preshape)
        assert abs(float(slope) - expected) < 1e-6


def test_a_pad_is_the_middle_of_the_side_that_touches_first_and_four_points_around() -> None:
    _, moving = HandSweep(load_robot(GRIPPER))(torch.tensor([[0.0]]))
    left = moving[0, 0, :5]  # its jaw is 6 cm long (x), 1 cm thick and 2 cm wide (z)
    assert torch.allclose(left[:, 1], torch.tensor(0.045), atol=1e-6)
    offsets = left[1:] - left[0]
    assert torch.allclose(offsets[:2], -offsets[2:], atol=1e-6)
    along, across = offsets[0].abs(), offsets[1].abs()
    assert 0.015 < along[0] < 0.03
    assert along[1:].max() < 1e-6
    assert 0.005 < across[2] < 0.01
    assert across[:2].max() < 1e-6
    # One point each is what older checkpoints learned from.
    _, middles = HandSweep(load_robot(GRIPPER), SweepConfig(points_per_pad=1))(torch.zeros(1, 1))
    assert torch.allclose(middles[0, :, 0], moving[0, :, 0], atol=1e-7)


def test_the_closing_region_is_in_front_of_the_palm() -> None:
    assert len(SWEEP.region) == 64
    assert (SWEEP.region[:, 0] > 0).all()


@pytest.mark.parametrize("robot", [GRIPPER, "panda"])
def test_the_closing_region_of_flat_jaws_is_wider_than_their_pads(robot: Path | str) -> None:
    # The outer cells' middles are three quarters of the region's width apart.
    region = HandSweep(load_robot(robot)).region
    assert (region.amax(0) - region.amin(0)).min() > 0.0449
    narrow = HandSweep(load_robot(robot), SweepConfig(narrowest=0.0)).region
    assert torch.allclose(narrow.mean(0), region.mean(0), atol=1e-6)
    assert (narrow.amax(0) - narrow.amin(0)).min() < 0.02


def test_a_hand_that_cannot_close_is_refused() -> None:
    with pytest.raises(InputError):
        SweepConfig(stages=1)
    with pytest.raises(InputError):
        SweepConfig(points_per_pad=3)
    with pytest.raises(InputError):
        SweepConfig(narrowest=-0.01)
