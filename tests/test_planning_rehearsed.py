"""Which grasps are rehearsed, in which order, and which one is chosen."""

from __future__ import annotations

import numpy as np

from pointsdf_cli.errors import InputError
from pointsdf_cli.planning.acceptance import Candidate
from pointsdf_cli.planning.rehearsed import RehearsedChoice
from pointsdf_cli.simulation.rehearsal import Rehearsed

SURFACE = np.zeros((3, 3)), np.zeros((1, 3), int)
HELD, LOST = Rehearsed(8, 8, 0.15), Rehearsed(1, 0, 0.0)


def grasp(success: float, slack: float = 0.02) -> Candidate:
    """A candidate whose configuration is its success probability."""
    return Candidate(np.zeros(0), np.array([success]), success, 0.0, 0.0, slack, 1.0, 1.0, 1.0, "")


class Rehearsals:
    """Rehearsals that end as they are told; keeps what was asked."""

    def __init__(self, **ends: Rehearsed) -> None:
        self.asked: list[float] = []
        self._lost = ends.get("all", HELD)

    def __call__(self, q: np.ndarray, success: np.ndarray, right: np.ndarray) -> list[Rehearsed]:
        assert np.array_equal(q[:, 0], success)
        self.asked += list(success)
        return [self._lost] * len(q)


def choice(rehearse: object, *contradicted: float, count: int = 12) -> RehearsedChoice:
    return RehearsedChoice(
        rehearse,  # type: ignore[arg-type]
        SURFACE,
        count,
        0.005,
        lambda new: [one.success in contradicted for one in new],
        0.0,
    )


def test_the_most_likely_are_rehearsed_first() -> None:
    rehearse = Rehearsals()
    chosen = choice(rehearse, 0.9, count=3)
    tight = grasp(0.81, slack=0.001)
    assert chosen.stop([grasp(0.3), grasp(0.9), tight, grasp(0.8), grasp(0.75)])
    assert rehearse.asked == [0.8, 0.81, 0.75]  # 0.9 is contradicted
    chosen.stop([grasp(0.1 * k) for k in range(1, 9)])
    assert len(rehearse.asked) == 3 + 6  # later rounds have twice as many


def test_the_search_goes_on_without_a_likely_grasp() -> None:
    assert not choice(Rehearsals(all=LOST)).stop([grasp(0.6)])
    assert choice(Rehearsals(all=LOST)).stop([grasp(0.97)])  # the network is sure
    assert not choice(Rehearsals()).stop([grasp(0.2)])
    assert not choice(Rehearsals(), 0.8).stop([grasp(0.8)])  # contradicted
    assert not choice(Rehearsals(all=Rehearsed(0, 0, 0.0))).stop([grasp(0.97)])


def test_network_and_rehearsals_choose_together() -> None:
    likely, unlikely = grasp(0.8), grasp(0.3)

    def held_if_unlikely(q: np.ndarray, success: np.ndarray, _: np.ndarray) -> list[Rehearsed]:
        return [HELD if each < 0.7 else Rehearsed(3, 1, 0.05) for each in success]

    chosen = choice(held_if_unlikely)
    chosen.stop([unlikely, likely, grasp(0.65)])
    ranked = [one.success for one in chosen.ranked([])]
    assert ranked == [0.65, 0.8, 0.3]  # 8 of 8 at 0.3 are less than 1 of 3 at 0.8
    assert chosen.of(likely) == (3, 1, 0.05)
    assert [one.success for one in chosen.best()] == ranked


def test_where_nothing_is_solid_the_order_stays() -> None:
    def flat(*_: np.ndarray) -> list[Rehearsed]:
        raise InputError("the surface is flat")

    chosen = choice(flat)
    assert not chosen.stop([grasp(0.3), grasp(0.8)])
    assert [one.success for one in chosen.ranked([])] == [0.8, 0.3]
