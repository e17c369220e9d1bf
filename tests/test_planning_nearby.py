"""Grasps beside those that held best: their spread, their kinds, and their place in the search."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from planning_worlds import REST, can_target

from pointsdf_cli.geometry.frames import rotation_vector
from pointsdf_cli.planning.acceptance import Candidate
from pointsdf_cli.planning.nearby_grasps import SHIFT, SPREAD, TURN, NearbySampler
from pointsdf_cli.planning.planner import Planner, PlannerConfig
from pointsdf_cli.planning.seeds import SeedConfig
from pointsdf_cli.planning.synthesis import SynthesisConfig
from pointsdf_cli.robot.description import load_robot

TWO_ROUNDS = SynthesisConfig(rounds=2, seeds=SeedConfig(drawn=64, palms=16, seeds=4))


@pytest.fixture(scope="module")
def planner() -> Planner:
    return Planner(load_robot(), PlannerConfig(synthesis=TWO_ROUNDS))


@pytest.fixture(scope="module")
def held(planner: Planner) -> Candidate:
    best = planner.search(can_target()).best
    assert best is not None
    return best


def test_samples_spread_about_the_best_as_far_as_stated(planner: Planner, held: Candidate) -> None:
    chain = planner.inverse.chain
    sampler = NearbySampler(lambda: [held], chain)
    preshape, palms = sampler.sample("side", 4000, np.random.default_rng(0))
    middle = chain.palm(held.q)
    shift = palms[:, :3, 3] - middle[:3, 3]
    np.testing.assert_allclose(shift.std(axis=0), SHIFT, rtol=0.05)
    np.testing.assert_allclose(shift.mean(axis=0), 0, atol=SHIFT / 20)
    turn = np.stack([rotation_vector(R @ middle[:3, :3].T) for R in palms[:, :3, :3]])
    np.testing.assert_allclose(turn.std(axis=0), TURN, rtol=0.05)
    low, high = planner.robot.preshape_ranges.T
    assert ((preshape >= low) & (preshape <= high)).all()
    here = held.q[planner.robot.preshape_columns]
    inside = (here - low > 3 * SPREAD * (high - low)) & (high - here > 3 * SPREAD * (high - low))
    assert inside.any()
    spread = (preshape - here).std(axis=0) / (high - low)
    np.testing.assert_allclose(spread[inside], SPREAD, rtol=0.05)


def test_samples_are_of_the_kind_that_is_asked_for(planner: Planner, held: Candidate) -> None:
    assert held.kind == "side"
    chain, rng = planner.inverse.chain, np.random.default_rng(0)
    from_top = NearbySampler(lambda: [held], chain).sample("top", 5, rng)
    without_any = NearbySampler(list, chain).sample("side", 5, rng)
    for preshape, palms in (from_top, without_any):
        assert preshape.shape == (0, len(REST))
        assert palms.shape == (0, 4, 4)


def test_the_second_round_has_grasps_beside_the_best(planner: Planner, held: Candidate) -> None:
    chain = planner.inverse.chain

    def rounds(near: Callable[[], list[Candidate]] | None) -> list[list[Candidate]]:
        found: list[list[Candidate]] = []

        def go_on(new: list[Candidate]) -> bool:
            found.append(new)
            return False

        planner.search(can_target(), stop=go_on, near=near)
        return found

    alone, beside = rounds(None), rounds(lambda: [held])
    before = {one.x.tobytes() for each in alone for one in each}
    added = [one for each in beside for one in each if one.x.tobytes() not in before]
    assert added
    away = [np.linalg.norm(chain.palm(one.q)[:3, 3] - chain.palm(held.q)[:3, 3]) for one in added]
    assert max(away) < 6 * SHIFT
    assert min(one.worst_slack for one in added) >= 0
    # Nothing is drawn before anything was tried.
    tried: list[Candidate] = []
    later = rounds(lambda: tried)
    assert [len(each) for each in later] == [len(each) for each in alone]
