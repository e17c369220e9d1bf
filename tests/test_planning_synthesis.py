"""From an object to a configuration: seeds, acceptance, reasons; on objects with exact fields."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from planning_worlds import AroundObject, BoxField, CylinderField, NearPalm

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.planning import synthesis
from pointsdf_cli.planning.acceptance import AcceptanceConfig, Candidate, judge
from pointsdf_cli.planning.environment import Environment, Obstacle
from pointsdf_cli.planning.fields import MeshField, RefinedField
from pointsdf_cli.planning.grasp_problem import Clearances, GraspProblem
from pointsdf_cli.planning.grid import GridConfig, GridField
from pointsdf_cli.planning.objective import GraspScore
from pointsdf_cli.planning.reasons import SeedStatistics, explain, is_hemmed_in, why_none
from pointsdf_cli.planning.robot_geometry import RobotGeometry
from pointsdf_cli.planning.seeds import LOWEST_PALM, SeedConfig, Seeds, draw_seeds
from pointsdf_cli.planning.sqp import Sqp
from pointsdf_cli.planning.synthesis import (
    Problems,
    Synthesis,
    SynthesisConfig,
    _outcome,
    synthesise,
)
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.inverse_kinematics import IkConfig, InverseKinematics
from pointsdf_cli.robot.kinematics import Kinematics

ROBOT = load_robot()
KINEMATICS = Kinematics(ROBOT)
GEOMETRY = RobotGeometry(KINEMATICS)
IK = InverseKinematics(ROBOT, IkConfig(pool=4000))
REST = np.array([0.0] * 6 + [1.3, 0.5])
RADIUS = 0.035


def problems(
    field: Field,
    score: GraspScore,
    environment: Environment,
    at: tuple[float, float, float],
    around: float = 0.2,
) -> Problems:
    low, high = np.array(at) - around, np.array(at) + around
    grid = GridField(field, low, high, GridConfig(step=0.005))
    asked, inside = Clearances(), Clearances(0.0015, 0.0025, 0.0015)
    refined = RefinedField(grid, field, beyond=0.01)

    def problem(which: Field, clearances: Clearances) -> GraspProblem:
        return GraspProblem(GEOMETRY, score, which, environment, clearances)

    return Problems(problem(grid, inside), problem(field, asked), problem(refined, inside))


def plan(
    field: Field,
    at: tuple[float, float, float],
    distance: float,
    environment: Environment | None = None,
    best: float | None = None,
    rounds: int = 1,
    width: float = 0.08,
) -> Synthesis:
    best = distance if best is None else best
    place = (at[0] - best, at[1], at[2])
    score = NearPalm(place, (1.0, 0.0, 0.0), REST, width=width)
    return synthesise(
        problems(field, score, environment or Environment(), at),
        AroundObject(at, distance, REST),
        IK,
        Sqp(),
        np.random.default_rng(0),
        SynthesisConfig(rounds=rounds, seeds=SeedConfig(palms=16, seeds=4)),
    )


CAN = (0.6, 0.0, 0.12)


@pytest.fixture(scope="module")
def can_plan() -> Synthesis:
    return plan(CylinderField(RADIUS, 0.24, CAN), CAN, 0.09)


def test_a_can_in_reach_is_planned_and_touches_nothing(can_plan: Synthesis) -> None:
    result = can_plan
    assert result.best is not None
    assert result.reason == ""
    assert result.best.success > 0.6
    assert result.best.objective < 5
    assert result.best.worst_slack >= 0
    assert (result.best.q >= ROBOT.lower - 1e-9).all()
    assert (result.best.q <= ROBOT.upper + 1e-9).all()
    # The same from a mesh of the can, at surface points of the robot.
    can = trimesh.creation.cylinder(RADIUS, 0.24, sections=96)
    can.apply_translation(CAN)
    check = GraspProblem(
        GEOMETRY,
        NearPalm(CAN, (1.0, 0, 0), REST),
        MeshField(np.array(can.vertices), np.array(can.faces)),
    )
    assert np.min(check.residuals(result.best.x[None])) > -1e-4


def test_the_same_seed_gives_the_same_plan(can_plan: Synthesis) -> None:
    one, two = can_plan.best, plan(CylinderField(RADIUS, 0.24, CAN), CAN, 0.09).best
    assert one is not None
    assert two is not None
    np.testing.assert_array_equal(one.x, two.x)


def test_the_margin_to_the_object_yields_from_round_to_round(can_plan: Synthesis) -> None:
    field = CylinderField(RADIUS, 0.24, CAN)
    score = NearPalm((CAN[0] - 0.09, *CAN[1:]), (1.0, 0.0, 0.0), REST)
    exact = GraspProblem(GEOMETRY, score, field)
    wanted = exact.with_clearance(0.0055)
    rounds = [Problems(wanted, exact, wanted).in_round(k, 0.0015) for k in range(4)]
    assert can_plan.best is not None
    x = can_plan.best.x[None]
    slacks = [float(one.quick.residuals(x).object[0]) for one in rounds]
    # What is kept beyond 1.5 mm: 4 mm, 2 mm, nothing; the room is larger by what is asked less.
    np.testing.assert_allclose(np.diff(slacks), [0.002, 0.002, 0.0], atol=1e-12)
    assert all(one.exact is exact and one.polish is one.quick for one in rounds)
    assert exact.clearances.object == Clearances().object


def test_what_is_free_in_a_narrow_place_is_no_fallback() -> None:
    shelf = SeedStatistics(drawn=100, above_table=100, reached=100, free=3, table=30, obstacle=67)
    flat = SeedStatistics(drawn=100, above_table=100, reached=100, free=3, table=67, obstacle=30)
    roomy = SeedStatistics(drawn=100, above_table=100, reached=100, free=30, obstacle=70)
    assert [is_hemmed_in(statistics) for statistics in (shelf, flat, roomy)] == [True, False, False]


def test_out_of_reach_is_said_to_be_so() -> None:
    at = (1.6, 0.0, 0.12)
    result = plan(CylinderField(RADIUS, 0.24, at), at, 0.09)
    assert result.best is None
    assert result.reason == "inverse_kinematics"
    assert "nearer" in result.sentence


def test_in_a_narrow_bin_there_is_no_plan() -> None:
    # The can stands in a bin whose walls leave no room for a hand.
    walls = []
    for k, (x, y) in enumerate(((0.06, 0), (-0.06, 0), (0, 0.06), (0, -0.06))):
        pose = np.eye(4)
        pose[:3, 3] = (CAN[0] + x, CAN[1] + y, 0.2)
        size = (0.02, 0.14, 0.4) if x else (0.14, 0.02, 0.4)
        walls.append(Obstacle(f"wall_{k}", "box", size, pose))
    # Good grasps have the palm within the walls; from outside they are unlikely to hold.
    field, bin_ = CylinderField(RADIUS, 0.24, CAN), Environment(tuple(walls))
    result = plan(field, CAN, 0.05, bin_, width=0.02)
    assert result.best is None
    assert result.reason in ("table_collision", "object_collision", "low_success_probability")
    assert all(c.worst_slack < 0 or c.success <= 0.6 for c in result.rejected)
    assert result.rejected


def test_a_grasp_that_must_be_inside_of_a_block_is_unlikely_or_in_collision() -> None:
    at = (0.6, 0.0, 0.15)
    result = plan(BoxField((0.3, 0.5, 0.3), at), at, 0.2, best=0.0)
    assert result.best is None
    assert result.reason in ("object_collision", "low_success_probability", "objective")


def test_seeds_are_the_best_of_what_is_reached() -> None:
    field = CylinderField(RADIUS, 0.24, CAN)
    score = NearPalm((CAN[0] - 0.09, 0, CAN[2]), (1.0, 0, 0), REST)
    problem = problems(field, score, Environment(), CAN).quick
    prior = AroundObject(CAN, 0.09, REST)

    def draw(seeds: int) -> Seeds:
        config = SeedConfig(palms=16, seeds=seeds)
        return draw_seeds(problem, prior, IK, "side", np.random.default_rng(1), config)

    few, many = draw(2), draw(16)
    assert len(few.x) == 2
    np.testing.assert_array_equal(few.x, many.x[:2])
    assert few.statistics.reached <= few.statistics.above_table <= few.statistics.drawn
    with pytest.raises(InputError, match="side, top, either"):
        draw_seeds(problem, prior, IK, "below", np.random.default_rng(1))


def test_no_palm_is_drawn_below_the_top_of_a_high_table() -> None:
    score = NearPalm((CAN[0] - 0.09, 0, CAN[2]), (1.0, 0, 0), REST)
    prior, few = AroundObject(CAN, 0.09, REST), SeedConfig(drawn=32, palms=16, seeds=4)
    kept = []
    for height in (0.0, CAN[2] - LOWEST_PALM + 0.005, 1.0):
        field, around = CylinderField(RADIUS, 0.24, CAN), Environment(table_height=height)
        problem = problems(field, score, around, CAN).quick
        drawn = draw_seeds(problem, prior, IK, "side", np.random.default_rng(1), few)
        kept.append(drawn.statistics.above_table)
    assert kept[0] == 32
    assert 0 < kept[1] < 32
    assert kept[2] == 0


class FromTheSideOnly(AroundObject):
    """A prior of a hand that never tried the top."""

    def sample(
        self, kind: str, count: int, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        return super().sample(kind, count if kind == "side" else 0, rng)


def test_a_prior_that_knows_one_kind_is_asked_for_that() -> None:
    score = NearPalm((CAN[0] - 0.09, 0, CAN[2]), (1.0, 0, 0), REST)
    problem = problems(CylinderField(RADIUS, 0.24, CAN), score, Environment(), CAN).quick
    prior, few = FromTheSideOnly(CAN, 0.09, REST), SeedConfig(drawn=32, palms=16, seeds=4)
    either = draw_seeds(problem, prior, IK, "either", np.random.default_rng(1), few)
    assert set(either.kinds) == {"side"}
    none = draw_seeds(problem, prior, IK, "top", np.random.default_rng(1), few)
    assert len(none.x) == 0
    assert "other --kind" in why_none(none.statistics, [], 0)[1]


@pytest.mark.parametrize(
    ("success", "rounds"), [((0.5, 0.84, 0.9), 3), ((0.5,) * 5, 5), ((0.9,), 1)]
)
def test_the_search_ends_with_a_grasp_that_is_likely_enough(
    can_plan: Synthesis,
    monkeypatch: pytest.MonkeyPatch,
    success: tuple[float, ...],
    rounds: int,
) -> None:
    given = [replace(can_plan.accepted[0], success=each, object_slack=0.02) for each in success]
    found, drawn = with_solutions(given, monkeypatch)
    assert drawn == rounds
    assert [one.success for one in found.accepted] == sorted(success, reverse=True)


def test_motions_are_searched_for_the_likeliest_few(
    can_plan: Synthesis, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(synthesis, "MOST_MOTIONS", 3)
    given = [replace(can_plan.accepted[0], success=each) for each in (0.4, 0.2, 0.6, 0.5, 0.3)]
    found, _ = with_solutions(given, monkeypatch)
    assert [one.success for one in found.accepted] == [0.6, 0.5, 0.4]
    assert [(one.success, one.reason) for one in found.rejected] == [
        (0.3, "not_tried"),
        (0.2, "not_tried"),
    ]


def test_objectives_without_prior_do_not_decide_what_is_solved_again(
    can_plan: Synthesis, monkeypatch: pytest.MonkeyPatch
) -> None:
    limits = []
    monkeypatch.setattr(synthesis, "_polish", lambda _problems, _new, best, *_: limits.append(best))
    monkeypatch.setattr(synthesis, "judge", lambda *_: [])
    score = NearPalm((CAN[0] - 0.09, 0.0, CAN[2]), (1.0, 0.0, 0.0), REST)
    whole = problems(CylinderField(RADIUS, 0.24, CAN), score, Environment(), CAN)
    seeds = Seeds(can_plan.accepted[0].x[None], ("side",), SeedStatistics(1, 1, 1))
    solved = replace(can_plan.accepted[0], objective=2.0)
    antipodal = replace(solved, objective=0.0, has_prior=False)
    timings = dict.fromkeys(("solve", "check"), 0.0)
    for accepted in ([solved, antipodal], [antipodal]):
        synthesis._solved(whole, seeds, accepted, Sqp(), SynthesisConfig(), timings)
    assert limits == [2.0, np.inf]


def with_solutions(
    given: list[Candidate], monkeypatch: pytest.MonkeyPatch
) -> tuple[Synthesis, int]:
    """Result of a search whose rounds find one of these candidates each, and its rounds."""
    drawn: list[object] = []

    def draw(problem: GraspProblem, *_: object) -> Seeds:
        drawn.append(problem)
        return Seeds(np.zeros((1, 1)), ("side",), SeedStatistics(1, 1, 1))

    monkeypatch.setattr(synthesis, "draw_seeds", draw)
    monkeypatch.setattr(synthesis, "_solved", lambda *_: [given[len(drawn) - 1]])
    monkeypatch.setattr(synthesis, "_beside", lambda *_: [])
    score = NearPalm((CAN[0] - 0.09, 0.0, CAN[2]), (1.0, 0.0, 0.0), REST)
    whole = problems(CylinderField(RADIUS, 0.24, CAN), score, Environment(), CAN)
    rng = np.random.default_rng(0)
    found = synthesise(whole, AroundObject(CAN, 0.09, REST), IK, Sqp(), rng)
    return found, len(drawn)


def test_every_reason_is_told_apart(can_plan: Synthesis) -> None:
    field = CylinderField(RADIUS, 0.24, CAN)
    place = (CAN[0] - 0.09, 0.0, CAN[2])
    score = NearPalm(place, (1.0, 0, 0), REST)
    exact = problems(field, score, Environment(), CAN).exact
    assert can_plan.best is not None
    good = can_plan.best.x
    into_table = np.clip(np.zeros_like(good), exact.lower, exact.upper)
    into_table[1] = exact.upper[1]  # the stretched arm leans forward, beyond level
    beyond = good.copy()
    beyond[0] = exact.upper[0] + 0.1
    reasons = [c.reason for c in judge(exact, np.stack([into_table, beyond]))]
    assert reasons[0] in ("table_collision", "object_collision")
    assert reasons[1] == "solver"
    strict = judge(exact, good[None], AcceptanceConfig(success=0.9999999, least=0.9999999))[0]
    assert strict.reason == "low_success_probability"
    picky = judge(exact, good[None], AcceptanceConfig(success=0.0, least=0.0, objective=1e-3))[0]
    assert picky.reason == "objective"
    assert f"{picky.objective:.2f}" in explain("objective", picky, 4)
    nowhere = NearPalm((float("nan"), 0.0, 0.0), (1.0, 0, 0), REST)
    unknown = problems(field, nowhere, Environment(), CAN).exact
    assert judge(unknown, good[None])[0].reason == "low_success_probability"


def test_the_refined_field_is_exact_where_it_matters() -> None:
    field = CylinderField(RADIUS, 0.24)
    grid = GridField(field, np.full(3, -0.2), np.full(3, 0.2), GridConfig(step=0.01, band=0.0))
    refined = RefinedField(grid, field, beyond=0.005)
    points = np.random.default_rng(0).uniform(-0.2, 0.2, (5000, 3))
    true = field(points)
    near = true < 0.005
    np.testing.assert_array_equal(refined(points)[near], true[near])
    assert (refined(points)[~near] > 0.005 - 1e-12).all()
    assert refined.queries < len(points)


def test_the_cautious_field_never_says_more_than_the_exact_one() -> None:
    field = CylinderField(RADIUS, 0.24)
    grid = GridField(field, np.full(3, -0.2), np.full(3, 0.2), GridConfig(step=0.01, band=0.0))
    refined = RefinedField(grid, field, beyond=0.005)
    cautious = refined.cautious()
    points = np.random.default_rng(0).uniform(-0.2, 0.2, (5000, 3))
    true = field(points)
    assert (refined(points) - true).max() > 1e-3  # what the path check's proof may not build on
    assert (cautious(points) - true).max() <= 1e-12
    values, gradients = cautious.with_gradient(points)
    np.testing.assert_array_equal(values, cautious(points))
    np.testing.assert_array_equal(gradients, refined.with_gradient(points)[1])
    near = true < 0.005
    np.testing.assert_array_equal(values[near], true[near])


def test_of_fallbacks_those_with_clear_fingers_come_first() -> None:
    none = np.zeros(0)
    clear = Candidate(none, none, 0.2, 0.0, 6.0, 1.0, 1.0, 1.0, 1.0, "objective")
    near = replace(clear, objective=0.0, reason="closing", closing_slack=-0.003)
    nearer = replace(near, success=0.5, closing_slack=-0.004)  # hardly
    deep = replace(near, closing_slack=-0.03)
    rejected = [deep, nearer, near, clear]
    found = _outcome([], rejected, 8, SeedStatistics(), SynthesisConfig(), {}, clearance=0.001)
    expected = [clear, nearer, near, deep]
    assert all(c is d for c, d in zip(found.fallbacks, expected, strict=True))


def test_the_likeliest_fallback_is_chosen_and_not_the_one_of_least_objective() -> None:
    none = np.zeros(0)
    usual = Candidate(none, none, 0.04, 0.0, 3.0, 1.0, 1.0, 1.0, 1.0, "low_success_probability")
    likely = replace(usual, success=0.55, objective=6.0, reason="objective")
    statistics = SeedStatistics()
    found = _outcome([], [usual, likely], 8, statistics, SynthesisConfig(), {}, clearance=0.001)
    assert found.fallbacks[0] is likely
