"""Antipodal pairs of boxes, cans and balls, worked out by hand; grasps on them; their place in the
search."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
from numpy.typing import NDArray
from planning_worlds import AroundObject, BoxField, NearPalm

from pointsdf_cli.geometry.arrays import Surface
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.planning import screen
from pointsdf_cli.planning.antipodal import AntipodalSampler, SuccessAlone, antipodal_pairs
from pointsdf_cli.planning.objective import ALPHA, BETA
from pointsdf_cli.planning.planner import Planner, PlannerConfig
from pointsdf_cli.planning.seeds import SeedConfig
from pointsdf_cli.planning.synthesis import SynthesisConfig
from pointsdf_cli.planning.target import Target
from pointsdf_cli.robot.description import RobotDescription, load_robot
from pointsdf_cli.robot.jaws import Jaws, jaws_of

SIZE = (0.03, 0.06, 0.12)
AT = np.array([0.5, 0.1, 0.06])
WIDEST = 0.074


def surface(mesh: trimesh.Trimesh) -> Surface:
    mesh.apply_translation(AT)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int32)


def box() -> Surface:
    return surface(trimesh.creation.box(SIZE))


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.fixture(scope="module")
def panda() -> RobotDescription:
    return load_robot("panda")


@pytest.fixture(scope="module")
def jaws(panda: RobotDescription) -> Jaws:
    found = jaws_of(panda)
    assert found is not None
    return found


def test_a_box_is_held_across_the_sides_that_fit() -> None:
    pairs = antipodal_pairs(box(), WIDEST, rng())
    across = np.abs(pairs.axis).argmax(axis=1)
    assert set(across) == {0, 1}  # 12 cm do not fit
    np.testing.assert_allclose(np.abs(pairs.axis).max(axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(pairs.width, np.array(SIZE)[across], atol=1e-5)
    off = pairs.middle - AT
    np.testing.assert_allclose(off[np.arange(len(off)), across], 0, atol=1e-5)
    assert (np.abs(off) <= np.array(SIZE) / 2 + 1e-6).all()


def test_a_can_is_held_across_its_axis() -> None:
    pairs = antipodal_pairs(
        surface(trimesh.creation.cylinder(0.03, 0.12, sections=128)), WIDEST, rng()
    )
    assert len(pairs.width) > 1000
    assert np.abs(pairs.axis[:, 2]).max() < 1e-3
    # Facets of 3 degrees: a line along a facet's normal passes the axis within its half width.
    assert np.linalg.norm((pairs.middle - AT)[:, :2], axis=1).max() < 0.03 * np.pi / 128 + 1e-4
    # The second point is up to 3 mm aside, and thus (3 mm)² / (2 · 3 cm) nearer, and a facet.
    np.testing.assert_allclose(pairs.width, 0.06, atol=3e-4)


def test_surfaces_that_do_not_face_each_other_are_no_pair() -> None:
    # Adjacent sides of a cone of 60 degrees: no line lies in both friction cones.
    cone = trimesh.creation.cone(0.05, 0.05 * np.sqrt(3), sections=64)
    pairs = antipodal_pairs(surface(cone), 0.2, rng())
    assert len(pairs.width) == 0


def test_jaws_close_on_the_pair_and_do_not_come_from_below(jaws: Jaws) -> None:
    hand = np.array([[0.05, 0.0, 0.04], [0.05, 0.0, -0.04], [-0.1, 0.03, 0.1], [-0.1, 0.0, -0.1]])
    pairs = antipodal_pairs(box(), WIDEST, rng())
    sampler = AntipodalSampler(pairs, jaws, 0.01, hand, 0.002)
    for kind in ("side", "top"):
        preshape, palms = sampler.sample(kind, 200, rng())
        assert len(palms) == 200
        np.testing.assert_array_equal(preshape, np.full((200, 2), 0.04))
        turn = palms[:, :3, :3]
        np.testing.assert_allclose(
            turn @ turn.transpose(0, 2, 1), np.tile(np.eye(3), (200, 1, 1)), atol=1e-9
        )
        np.testing.assert_allclose(np.linalg.det(turn), 1)
        assert ((turn[:, 2, 0] < -0.7) == (kind == "top")).all()
        assert turn[:, 2, 0].max() <= 0.2
        assert (turn[:, :, 2] @ jaws.home_z >= 0).all()
        # Contacts in the palm's frame: opposite each other along z, in front of the palm by a place
        # on the pads. A pair's middle is on a plane of symmetry of the box.
        middle = _middles(sampler, palms)
        local = np.einsum("nji,nj->ni", turn, middle - palms[:, :3, 3])
        np.testing.assert_allclose(local[:, 1:], np.tile([0, 0.01], (200, 1)), atol=1e-9)
        assert (apply_transform(palms, hand)[..., 2] >= 0.002).all()
        assert jaws.pads[0] <= local[:, 0].min() < local[:, 0].max() <= jaws.pads[1]


def _middles(sampler: AntipodalSampler, palms: NDArray[np.float64]) -> NDArray[np.float64]:
    """The middle of the pair that each palm [N, 4, 4] closes on: it is on its approach."""
    gap = sampler.pairs.middle[None] - palms[:, None, :3, 3]
    local = np.einsum("nji,nmj->nmi", palms[:, :3, :3], gap)
    return sampler.pairs.middle[np.linalg.norm(local[..., 1:] - [0, 0.01], axis=2).argmin(axis=1)]


def test_what_is_too_wide_has_no_grasps(jaws: Jaws) -> None:
    wide = surface(trimesh.creation.box((0.1, 0.1, 0.1)))
    sampler = AntipodalSampler(
        antipodal_pairs(wide, WIDEST, rng()), jaws, 0.0, np.zeros((1, 3)), 0.0
    )
    preshape, palms = sampler.sample("top", 10, rng())
    assert preshape.shape == (0, 2)
    assert palms.shape == (0, 4, 4)


def test_without_the_prior_a_good_grasp_costs_nothing() -> None:
    class Half:
        def log_success(self, preshape: torch.Tensor, palm: torch.Tensor) -> torch.Tensor:
            return torch.log(preshape[:, 0])

        def log_prior(self, preshape: torch.Tensor, palm: torch.Tensor) -> torch.Tensor:
            return torch.full((len(palm),), -100.0)

    score = SuccessAlone(Half(), 0.6)
    hand, palm = torch.tensor([[0.59], [0.6], [0.7]]), torch.eye(4).repeat(3, 1, 1)
    s = -score.log_success(hand, palm) - ALPHA * score.log_prior(hand, palm)
    cost = (s - BETA).clamp(min=0)
    assert cost[0] == pytest.approx(np.log(0.6 / 0.59), abs=1e-5)
    assert cost[1:].abs().max() < 1e-6


def test_jaws_meet_the_sides_squarely_where_neither_prior_nor_score_asks_for_it(
    panda: RobotDescription, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The score likes palms above the box, however turned; the prior knows side grasps."""
    at, size = (0.5, 0.0, 0.06), (0.03, 0.1, 0.12)
    above = NearPalm((at[0], at[1], 0.14), (0.0, 0.0, -1.0), np.full(2, 0.04), width=0.08)
    target = Target(
        BoxField(size, at),
        np.array(at) - 0.12,
        np.array(at) + 0.12,
        above,
        AroundObject(at, 0.2, np.full(2, 0.04)),
    )
    few = SynthesisConfig(rounds=1, seeds=SeedConfig(drawn=64, palms=32, seeds=8), kinds=("top",))

    def across_the_narrow_side() -> int:
        planner = Planner(panda, PlannerConfig(synthesis=few))
        found = planner.search(target, seed=1).found.accepted
        assert found
        assert min(one.worst_slack for one in found) >= 0
        palms = planner.inverse.chain.palm(np.stack([one.q for one in found]))
        return int((np.abs(palms[:, 0, 2]) > np.cos(np.radians(3))).sum())

    assert across_the_narrow_side() > 0
    found = Planner(panda, PlannerConfig(synthesis=few)).search(target, seed=1).found
    assert {one.has_prior for one in [*found.accepted, *found.rejected]} == {True, False}
    # Attempts that success networks learn from are proposed among the same grasps.
    planner = Planner(panda, PlannerConfig(synthesis=few))
    proposed = planner.solutions(target, np.random.default_rng(1), few).accepted
    palms = planner.inverse.chain.palm(np.stack([one.q for one in proposed]))
    aligned = np.abs(palms[:, 0, 2]) > np.cos(np.radians(3))
    assert 0 < aligned.sum() < len(proposed)
    monkeypatch.setattr(screen, "jaws_of", lambda robot: None)
    assert across_the_narrow_side() == 0
