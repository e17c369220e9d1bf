"""Grasps beside those that held best: their spread, their kinds, and their place in the search."""

from __future__ import annotations

import numpy as np
import pytest
from planning_worlds import REST, can_target

from pointsdf_cli.geometry.frames import rotation_vector
from pointsdf_cli.planning import synthesis
from pointsdf_cli.planning.acceptance import Candidate
from pointsdf_cli.planning.likeliest import NEARBY
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
    sampler = NearbySampler([held], chain)
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
    from_top = NearbySampler([held], chain).sample("top", 5, rng)
    without_any = NearbySampler([], chain).sample("side", 5, rng)
    for preshape, palms in (from_top, without_any):
        assert preshape.shape == (0, len(REST))
        assert palms.shape == (0, 4, 4)


def test_the_second_round_has_grasps_beside_the_best(
    planner: Planner, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[list[Candidate]] = []
    drawn = NearbySampler.sample

    def kept(
        self: NearbySampler, kind: str, count: int, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        asked.append(self._best)
        return drawn(self, kind, count, rng)

    monkeypatch.setattr(NearbySampler, "sample", kept)
    monkeypatch.setattr(synthesis, "ENOUGH", 1.1)
    found = planner.search(can_target()).found
    (second,) = asked  # in the first round there is nothing to be beside
    assert 0 < len(second) <= NEARBY
    chain = planner.inverse.chain
    places = np.stack([chain.palm(one.q)[:3, 3] for one in second])
    beside = [
        one
        for one in found.accepted
        if np.linalg.norm(places - chain.palm(one.q)[:3, 3], axis=1).min() < 6 * SHIFT
        and all(one is not each for each in second)
    ]
    assert beside
    assert min(one.worst_slack for one in beside) >= 0
