"""Features of geometry: exact on fields in closed form, and blind to what must not matter."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from grasp_worlds import side_palm, top_palm

from pointsdf_cli.geometry.frames import apply_transform, transform
from pointsdf_cli.models.grasp_features import (
    BODY_SIZE,
    LENGTH,
    GraspFeatures,
    ObjectBody,
    _touching,
    object_body,
)
from pointsdf_cli.models.hand_sweep import HandSweep
from pointsdf_cli.models.tensor_grid import TensorGrid
from pointsdf_cli.robot.description import load_robot

ROBOT = load_robot()
FEATURES = GraspFeatures(HandSweep(ROBOT), ROBOT.preshape_ranges)
CENTRE, RADIUS = np.array([0.6, 0.05, 0.05]), 0.05


def ball(points: np.ndarray, centre: np.ndarray = CENTRE) -> np.ndarray:
    return np.linalg.norm(points - centre, axis=-1) - RADIUS


def ball_torch(centre: np.ndarray = CENTRE):  # type: ignore[no-untyped-def]
    place = torch.tensor(centre, dtype=torch.float32)
    return lambda points: (points - place).norm(dim=-1) - RADIUS


def surface(seed: int = 0) -> np.ndarray:
    directions = np.random.default_rng(seed).normal(size=(500, 3))
    return CENTRE + RADIUS * directions / np.linalg.norm(directions, axis=1, keepdims=True)


def grasps(count: int = 4) -> tuple[torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(1)
    palms = [
        (side_palm, top_palm)[k % 2](CENTRE, rng.uniform(0, 0.04), RADIUS, rng.uniform(0, 3))
        for k in range(count)
    ]
    return torch.tensor(rng.uniform(*ROBOT.preshape_ranges.T, (count, 8))), torch.tensor(
        np.array(palms)
    )


def test_a_grid_gives_linear_fields_and_their_slopes_exactly() -> None:
    slope = np.array([0.3, -0.7, 0.2])
    grid = TensorGrid(lambda x: x @ slope + 0.1, np.zeros(3), np.array([0.2, 0.3, 0.1]), 0.03)
    x = torch.rand(50, 3, dtype=torch.float32, requires_grad=True)
    inside = x * torch.tensor([0.2, 0.3, 0.1])
    values = grid(inside)
    expected = inside.detach().numpy() @ slope + 0.1
    assert np.allclose(values.detach().numpy(), expected, atol=1e-6)
    (gradient,) = torch.autograd.grad(values.sum(), inside)
    assert np.allclose(gradient.numpy(), slope, atol=1e-4)


def test_products_of_coordinates_are_exact_within_a_cell() -> None:
    grid = TensorGrid(lambda x: x[:, 0] * x[:, 1] - 2 * x.prod(1), np.zeros(3), np.ones(3), 1.0)
    x = torch.rand(20, 3, generator=torch.manual_seed(0), requires_grad=True)
    a, b, c = x.detach().unbind(1)
    assert torch.allclose(grid(x), a * b - 2 * a * b * c, atol=1e-6)
    (gradient,) = torch.autograd.grad(grid(x).sum(), x)
    expected = torch.stack([b - 2 * b * c, a - 2 * a * c, -2 * a * b], dim=1)
    assert torch.allclose(gradient, expected, atol=1e-5)


def test_outside_of_the_box_stands_what_its_nearest_point_has() -> None:
    grid = TensorGrid(lambda x: x.sum(1), np.zeros(3), np.ones(3), 0.25)
    x = torch.tensor([[1.5, 0.3, 0.4], [-2.0, 0.5, 9.0], [np.nan, 0.5, 0.5]], requires_grad=True)
    values = grid(x)
    assert torch.allclose(values[:2], torch.tensor([1.7, 1.5]))
    assert torch.isnan(values[2])
    (gradient,) = torch.autograd.grad(values[:2].sum(), x)
    assert torch.allclose(gradient[:2], torch.tensor([[0.0, 1, 1], [0, 1, 0]]), atol=1e-5)


def test_a_large_box_gets_larger_cells_not_more_of_them() -> None:
    asked = []

    def field(points: np.ndarray) -> np.ndarray:
        asked.append(len(points))
        return points[:, 0]

    TensorGrid(field, np.zeros(3), np.ones(3), 0.001, cells=1000)
    assert asked[0] < 2000


def test_the_body_of_a_ball_has_its_volume_and_centre() -> None:
    body = object_body(surface(), ball)
    volume = 4 / 3 * np.pi * RADIUS**3
    assert abs(float(body.numbers[1]) * LENGTH**3 / volume - 1) < 0.15
    assert np.allclose(body.mass_centre.numpy(), CENTRE, atol=0.004)
    assert np.allclose(body.centre.numpy(), CENTRE, atol=0.004)
    assert abs(float(body.numbers[2]) * LENGTH - 0.1) < 0.002  # its height above the table


def test_the_size_is_what_comes_out() -> None:
    found = FEATURES(*grasps(), object_body(surface(), ball), ball_torch())
    assert found.shape == (4, FEATURES.size)
    assert torch.isfinite(found).all()


def test_turning_and_shifting_the_whole_scene_on_the_table_changes_nothing() -> None:
    preshape, palm = grasps()
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1.0]])
    motion = transform(turn, [-0.2, 0.3, 0.0])
    centre = apply_transform(motion, CENTRE[None])[0]
    here = FEATURES(preshape, palm, object_body(surface(), ball), ball_torch())
    there = FEATURES(
        preshape,
        torch.tensor(motion @ palm.numpy()),
        object_body(apply_transform(motion, surface()), lambda x: ball(x, centre)),
        ball_torch(centre),
    )
    # The box in which the body is measured turns with the world's axes, not with the scene.
    assert torch.allclose(here[:, :-BODY_SIZE], there[:, :-BODY_SIZE], atol=0.08)
    on_links = FEATURES.size - BODY_SIZE - 20
    assert torch.allclose(here[:, :on_links], there[:, :on_links], atol=1e-4)


@pytest.mark.parametrize(
    ("name", "axis", "number", "joints"),
    [("panda", 1, 0, [0, 1]), ("panda", 2, 1, [1, 0]), ("lbr4_barrett", 1, 0, [1, 0, 2])],
)
def test_the_image_of_a_grasp_in_a_mirror_has_the_images_features(
    name: str, axis: int, number: int, joints: list[int]
) -> None:
    robot = load_robot(name)
    features = GraspFeatures(HandSweep(robot), robot.preshape_ranges)
    palm = top_palm(CENTRE + np.array([0.012, -0.017, 0.0]), 0.02, RADIUS, 0.4)
    # The mirror is upright, so that gravity has its own direction there, too.
    normal = palm[:3, axis]
    image = CENTRE - 2 * normal * (normal @ (CENTRE - palm[:3, 3]))
    preshape = torch.tensor(robot.preshape_ranges @ [[0.7], [0.3]]).T
    preshape[:, 0] += 0.2 * float(np.ptp(robot.preshape_ranges[0]))

    def at(centre: np.ndarray, preshape: torch.Tensor) -> torch.Tensor:
        place = torch.tensor(centre, dtype=torch.float32)
        body = ObjectBody(place, place, torch.arange(float(BODY_SIZE)))
        return features(preshape, torch.tensor(palm)[None], body, ball_torch(centre))[0]

    here, there = at(CENTRE, preshape), at(image, preshape[:, joints])
    index, sign = features.mirrored()[number]
    wrong = (here[index] * sign - there).abs()
    # Surface samples are symmetric within 2 mm, those of the palm within 15 mm.
    assert wrong.median() < 0.002
    assert wrong.quantile(0.9) < 0.05
    assert wrong.max() < 0.4
    assert (here - there).abs().quantile(0.9) > 0.1
    assert torch.equal(here[index][index], here)


def test_a_hand_with_a_thumb_is_no_mirror_image_of_itself() -> None:
    assert FEATURES.mirrored() == []


def test_a_pad_that_passes_through_the_object_touches_and_the_sooner_the_closer_it_starts() -> None:
    metres = torch.tensor([0.06, 0.04, 0.02, 0.0, -0.01, -0.01, -0.01, -0.01])
    far = torch.full((8,), 0.06)
    late = torch.cat([torch.full((4,), 0.06), metres[:4]])
    share, time = _touching(torch.stack([metres, far, late], dim=1)[:, :, None])
    assert share[0, 0] > 0.99
    assert share[1, 0] < 1e-3
    # Three of eight moments are certainly free, at the fourth it is 4 mm within: about a quarter.
    assert 3 / 8 < time[0, 0] < 4 / 8
    assert time[0, 0] < time[2, 0] < time[1, 0]
    assert time[1, 0] > 0.99


def test_raising_the_scene_above_the_table_changes_what_the_table_does() -> None:
    preshape, palm = grasps()
    lifted = palm.clone()
    lifted[:, 2, 3] += 0.1
    body = object_body(surface(), ball)
    here = FEATURES(preshape, palm, body, ball_torch())
    there = FEATURES(preshape, lifted, body, ball_torch(CENTRE + [0, 0, 0.1]))
    still, moving = FEATURES._sweep.sizes
    sampled = (4 + 2) * moving + still + 64  # four moments, and who touches when
    assert torch.allclose(here[:, :sampled], there[:, :sampled], atol=1e-4)
    assert torch.allclose(there[:, sampled + 4], here[:, sampled + 4] + 0.1 / LENGTH, atol=1e-5)


def test_a_body_reaches_down_to_the_table_where_only_its_top_is_seen() -> None:
    centre, radius = np.array([0.6, 0.0, 0.05]), 0.05
    ways = np.random.default_rng(0).normal(size=(4000, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    top = centre + radius * ways[ways[:, 2] > 0]
    body = object_body(top, lambda x: np.linalg.norm(x - centre, axis=1) - radius)
    assert float(body.mass_centre[2]) == pytest.approx(0.05, abs=0.005)
    litres = float(body.numbers[1])
    assert litres == pytest.approx(4 / 3 * np.pi * 0.05**3 * 1e3, rel=0.15)
