"""The planner as a whole, on objects with exact fields: plans, reasons, artifacts."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from planning_worlds import CAN, REST, CylinderField, NearPalm
from planning_worlds import can_target as target

import pointsdf_cli.planning.planner as planner_module
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.io.plans import Plan, read_plan, write_plan
from pointsdf_cli.planning.acceptance import AcceptanceConfig, Candidate
from pointsdf_cli.planning.contacts import link_poses
from pointsdf_cli.planning.environment import Environment, Obstacle
from pointsdf_cli.planning.fields import RefinedField
from pointsdf_cli.planning.motion import Motion, MotionConfig, plan_motion
from pointsdf_cli.planning.path_check import PathChecker
from pointsdf_cli.planning.plan_artifact import plan_of
from pointsdf_cli.planning.planner import Planner, PlannerConfig
from pointsdf_cli.planning.seeds import SeedConfig
from pointsdf_cli.planning.synthesis import Synthesis, SynthesisConfig, synthesise
from pointsdf_cli.robot.description import load_robot

SMALL = SynthesisConfig(rounds=1, seeds=SeedConfig(palms=12, seeds=4))


@pytest.fixture(scope="module")
def planner() -> Planner:
    return Planner(load_robot(), PlannerConfig(synthesis=SMALL))


@pytest.fixture(scope="module")
def plan(planner: Planner) -> Plan:
    return plan_of(planner.search(target()))


def test_a_can_gets_a_plan_with_a_motion(planner: Planner, plan: Plan, tmp_path: Path) -> None:
    assert plan.status == "ok", plan.sentence
    assert plan.success_probability > 0.6
    assert plan.objective < 5
    np.testing.assert_array_equal(plan.trajectory[0], planner.robot.home)
    np.testing.assert_array_equal(plan.trajectory[-1], plan.q)
    # The lift begins there and leaves the fingers where they are.
    np.testing.assert_array_equal(plan.lift[0], plan.q)
    np.testing.assert_array_equal(plan.lift[:, 7:], np.repeat(plan.q[None, 7:], len(plan.lift), 0))
    _, above, _ = planner.inverse.chain.palm_and_jacobian(plan.lift[-1:, :7])
    np.testing.assert_allclose(above[0] - plan.T_world_palm[:3, 3], [0, 0, 0.15], atol=0.005)
    # The palm is where the arm's forward kinematics puts it.
    rotation, position, _ = planner.inverse.chain.palm_and_jacobian(plan.q[None, :7])
    np.testing.assert_allclose(plan.T_world_palm[:3, 3], position[0], atol=1e-12)
    np.testing.assert_allclose(plan.T_world_palm[:3, :3], rotation[0], atol=1e-12)
    assert plan.link_clearance_object.min() >= 0.001
    assert plan.link_clearance_table.min() >= 0.002
    # Every link's distance is the least of its samples': exact where it is small.
    poses, patches = link_poses(planner.kinematics, plan.q[None]), planner.geometry.patches
    for name, said in zip(plan.link_names, plan.link_clearance_object, strict=True):
        link = planner.kinematics.index(name)
        points = patches.points[patches.link == link].reshape(-1, 3)
        if len(points):
            points = points @ poses.rotation[0, link].T + poses.position[0, link]
            least = float(target().field(points).min())
            assert said == pytest.approx(least, abs=1e-9 if least < 0.005 else 0.01 + 0.3 * least)
    assert plan.link_clearance_object.max() > 0.1
    write_plan(tmp_path / "plan.h5", plan, seed=0)
    assert read_plan(tmp_path / "plan.h5").status == "ok"


def test_solutions_are_judged_by_the_network_wherever_the_grid_could_be_wrong(
    planner: Planner, plan: Plan
) -> None:
    problem = planner.problems(target(), Environment()).exact
    assert isinstance(problem.object.field, RefinedField)
    alone = problem.with_field(target().field, problem.clearances, exact_to=0.006)
    rng = np.random.default_rng(0)
    near = problem.variables.of(plan.q) + rng.normal(0, 0.06, (64, problem.variables.count))
    judged, true = problem.residuals(near).object, alone.residuals(near).object
    matters = true < 0.005
    assert 10 < matters.sum() < 64
    np.testing.assert_allclose(judged[matters], true[matters], atol=1e-9)
    assert (judged[~matters] >= 0.005).all()


def test_the_whole_trajectory_is_free_of_the_exact_object(planner: Planner, plan: Plan) -> None:
    checker = PathChecker(planner.geometry, target().field)
    assert checker.is_free(plan.trajectory)


def test_every_millimetre_of_the_trajectory_is_free(planner: Planner, plan: Plan) -> None:
    """No proof is used: the fastest point of the robot is looked at every millimetre."""
    checker = PathChecker(planner.geometry, target().field)
    for a, b in pairwise(plan.trajectory):
        steps = max(1, int(np.ceil(float(checker.motion(a, b).max()) / 0.001)))
        share = np.linspace(0, 1, steps, endpoint=False)[:, None]
        assert checker.slack((1 - share) * a + share * b).min() >= 0


def test_plan_and_motion_keep_the_margin_where_they_can(planner: Planner, plan: Plan) -> None:
    assert plan.link_clearance_object.min() >= 0.004
    wide = PathChecker(planner.geometry, target().field).with_clearance(0.004)
    assert wide.is_free(plan.trajectory)
    # It is what was asked of the checker: the can is no nearer, and no farther, than it is.
    near = PathChecker(planner.geometry, target().field).with_clearance(0.0)
    where = plan.q[None]
    assert near.slack(where)[0] >= wide.slack(where)[0]


def test_where_nothing_is_good_the_best_that_is_free_comes_with_a_warning() -> None:
    # The palm is wanted 5 cm within a thick pillar: h is below exp(-(5 / 5)^2) = 0.37.
    wanted = NearPalm((0.55, 0.0, 0.12), (1.0, 0.0, 0.0), REST, width=0.05)
    pillar = replace(target(), field=CylinderField(0.10, 0.24, CAN), score=wanted)
    acceptance = AcceptanceConfig(success=0.9, least=0.9, objective=30.0, floor=0.001)
    asked = replace(SMALL, acceptance=acceptance)
    tolerant = Planner(load_robot(), PlannerConfig(synthesis=asked))
    plan = plan_of(tolerant.search(pillar))
    assert (plan.status, plan.reason) == ("ok", "")
    assert f"{plan.success_probability:.2f}" in plan.sentence
    assert plan.success_probability < np.exp(-1)
    assert plan.link_clearance_object.min() >= 0.001
    strict = replace(asked, acceptance=replace(acceptance, floor=0.9))
    strict_planner = Planner(load_robot(), PlannerConfig(synthesis=strict))
    assert plan_of(strict_planner.search(pillar)).status == "no_plan"


def test_out_of_a_chimney_there_is_no_motion(planner: Planner) -> None:
    # The arm starts upright in a chimney that is too narrow to bend in; the grasp is below it.
    walls = []
    for k, (x, y) in enumerate(((0.16, 0), (-0.16, 0), (0, 0.16), (0, -0.16))):
        pose = np.eye(4)
        pose[:3, 3] = (x, y, 1.25)
        size = (0.02, 0.34, 0.9) if x else (0.34, 0.02, 0.9)
        walls.append(Obstacle(f"wall_{k}", "box", size, pose))
    start = np.clip(np.zeros(23), planner.robot.lower, planner.robot.upper)
    hasty = Planner(
        planner.robot,
        PlannerConfig(synthesis=SMALL, motion=MotionConfig(attempts=1, checks=400)),
    )
    plan = plan_of(hasty.search(target(), Environment(tuple(walls)), start=start))
    assert plan.status == "no_plan"
    assert plan.reason == "motion"
    assert "clear the space" in plan.sentence
    assert np.isnan(plan.q).all()
    assert plan.trajectory.shape == (0, 23)
    assert "motion" in plan.rejected.reasons


def test_fingers_that_would_meet_an_obstacle_are_a_reason(planner: Planner) -> None:
    """A post behind the can: only grasps whose fingers keep clear of it are accepted."""
    found, good = found_for_the_can(planner)
    assert good.closing_slack == np.inf  # without obstacles nothing is checked
    behind = transform(np.eye(3), [CAN[0] + 0.035 + 0.045, CAN[1], CAN[2]])
    post = Environment((Obstacle("post", "cylinder", (0.005, 0.24), behind),))
    near = planner.search(target(), post)
    assert near.found.accepted
    assert all(0 <= c.closing_slack < 0.5 for c in near.found.accepted)
    met = [c for c in near.found.rejected if c.reason == "closing"]
    assert all(c.closing_slack < 0 for c in met)
    poor = replace(good, reason="closing", closing_slack=-0.004)
    assert poor.is_fallback(AcceptanceConfig())
    assert not replace(poor, success=0.01).is_fallback(AcceptanceConfig())
    fallback = replace(found, accepted=[], fallbacks=[poor], best=None, reason="closing")
    checker = PathChecker(planner.geometry, target().field, post)
    best, _, rest = planner._with_motion(checker, fallback, planner.robot.home, 0)
    assert best is poor
    assert "4 mm" in rest.sentence
    # Rejected candidates are the others.
    rejected = replace(fallback, rejected=[*found.rejected, poor])
    _, _, rest = planner._with_motion(checker, rejected, planner.robot.home, 0)
    assert not any(one is poor for one in rest.rejected)
    assert "obstacle" in rest.sentence


def test_out_of_reach_has_a_reason_and_no_motion(planner: Planner) -> None:
    plan = plan_of(planner.search(target((1.5, 0.0, 0.12))))
    assert (plan.status, plan.reason) == ("no_plan", "inverse_kinematics")


def test_bad_options_are_refused(planner: Planner) -> None:
    with pytest.raises(InputError, match="sqp, slsqp"):
        PlannerConfig(solver="newton")
    with pytest.raises(InputError, match="23"):
        planner.search(target(), start=np.zeros(7))


def found_for_the_can(planner: Planner) -> tuple[Synthesis, Candidate]:
    """What a search finds, and the candidate with the least cost, which can be lifted from."""
    problems = planner.problems(target(), Environment())
    rng = np.random.default_rng(0)
    found = synthesise(problems, target().prior, planner.inverse, planner.solver, rng, SMALL)
    return found, min(found.accepted, key=lambda one: one.objective)


def test_where_the_best_grasp_has_no_motion_the_next_one_is_taken(planner: Planner) -> None:
    """The best candidate is boxed in by a start that reaches only the other one."""
    found, good = found_for_the_can(planner)
    # A configuration that stands in the can: nothing leads there.
    inside = good.q.copy()
    inside[0] -= 0.1
    bad = replace(good, q=inside, objective=0.0)
    checker = PathChecker(planner.geometry, target().field)
    best, motion, rest = planner._with_motion(
        checker, replace(found, accepted=[bad, good]), planner.robot.home, 0
    )
    assert best is good
    assert motion is not None
    assert motion.failure == ""
    assert rest.rejected[-1].reason == "motion"


def test_a_fallback_without_a_motion_is_told_by_its_motion(planner: Planner) -> None:
    found, good = found_for_the_can(planner)
    inside = good.q.copy()
    inside[1] += 0.3
    unlikely = replace(good, q=inside, success=0.08, reason="low_success_probability")
    only = replace(found, best=None, accepted=[], fallbacks=[unlikely], rejected=[unlikely])
    checker = PathChecker(planner.geometry, target().field)
    best, motion, rest = planner._with_motion(checker, only, planner.robot.home, 0)
    assert best is None
    assert motion is None
    assert rest.reason == "motion"
    assert "no free path" in rest.sentence
    assert rest.rejected == [unlikely]


def test_a_grasp_gets_its_second_search_before_the_next_one_gets_any(planner: Planner) -> None:
    _, good = found_for_the_can(planner)
    grasps = [replace(good, object_slack=slack) for slack in (0.01, 0.01, 0.0, 0.01)]
    checker = PathChecker(planner.geometry, target().field)
    searches = list(planner._searches(checker, grasps))
    # The third grasp keeps no more than the clearance anyway.
    assert [k for k, _, _ in searches] == [0, 0, 1, 1, 2, 0, 1, 2, 3]
    assert [effort is planner.config.motion for _, _, effort in searches] == [False] * 5 + [
        True
    ] * 4


def test_a_grasp_that_the_arm_cannot_lift_from_comes_last(planner: Planner) -> None:
    found, good = found_for_the_can(planner)
    # An arm that points nearly straight up has nowhere higher to go.
    upright = np.clip(np.zeros(23), planner.robot.lower, planner.robot.upper)
    stuck = replace(good, q=0.3 * planner.robot.home + 0.7 * upright, objective=0.0)
    checker = PathChecker(planner.geometry, target().field)

    both = replace(found, accepted=[stuck, good])
    best, motion, rest = planner._with_motion(checker, both, planner.robot.home, 0)
    assert best is good
    assert motion is not None
    assert rest.rejected[-1].reason == "lift"
    assert rest.sentence == ""

    alone = replace(found, accepted=[stuck])
    best, motion, rest = planner._with_motion(checker, alone, planner.robot.home, 0)
    assert best is stuck
    assert motion is not None
    assert "no room to lift" in rest.sentence


def test_searches_for_motions_end(planner: Planner, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of many grasps that cannot be reached would take seconds."""
    found, good = found_for_the_can(planner)
    inside = good.q.copy()
    inside[1] += 0.3
    asked: list[np.ndarray] = []

    def counted(*given: object) -> Motion:
        asked.append(given[3])  # type: ignore[arg-type]
        return plan_motion(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(planner_module, "plan_motion", counted)
    several = replace(found, accepted=[replace(good, q=inside)] * 5, fallbacks=[])
    checker = PathChecker(planner.geometry, target().field)
    best, _, rest = planner._with_motion(checker, several, planner.robot.home, 0)
    assert best is None
    every = len(asked)
    assert every > 5  # brief and thorough ones
    monkeypatch.setattr(planner_module, "MOST_CHECKS", 0)
    best, _, again = planner._with_motion(checker, several, planner.robot.home, 0)
    assert best is None
    assert len(asked) == every + 1
    assert (again.reason, again.sentence) == (rest.reason, rest.sentence)


def test_a_grasp_below_a_shelf_is_no_grasp_to_lift_from(planner: Planner) -> None:
    found, good = found_for_the_can(planner)
    alone = replace(found, accepted=[good])
    poses = link_poses(planner.kinematics, good.q[None])
    hand = [planner.robot.tree.links.index(link) for link in planner.robot.hand_links]
    top = poses.position[0, hand, 2].max()
    sentences = []
    # The hand rises by 15 cm; it reaches a few centimetres beyond its links' frames.
    for above in (0.1, 0.5):
        board = Obstacle(
            "board", "box", (0.5, 0.6, 0.02), transform(np.eye(3), [0.75, 0, top + above])
        )
        checker = PathChecker(planner.geometry, target().field, Environment((board,)))
        assert checker.without_object().slack(good.q[None])[0] > 0
        best, motion, rest = planner._with_motion(checker, alone, planner.robot.home, 0)
        assert best is good
        assert motion is not None
        sentences.append(rest.sentence)
    assert "no room to lift" in sentences[0]
    assert sentences[1] == ""


def test_a_lift_goes_around_what_is_above(planner: Planner) -> None:
    _, good = found_for_the_can(planner)
    free = PathChecker(planner.geometry, target().field)
    straight = planner._lift(free, good)
    assert straight is not None
    way = []
    for x in np.linspace(-0.1, 0.1, 9):
        palm = planner.inverse.chain.palm(good.q)[:3, 3]
        block = Obstacle(
            "block", "box", (0.03, 0.03, 0.03), transform(np.eye(3), palm + [x, 0, 0.2])
        )
        checker = PathChecker(planner.geometry, target().field, Environment((block,)))
        if checker.without_object().is_free(straight):
            continue
        lift = planner._lift(checker, good)
        if lift is not None:
            assert checker.without_object().is_free(lift)
            way.append(np.linalg.norm((planner.inverse.chain.palm(lift[-1])[:3, 3] - palm)[:2]))
    assert way
    assert min(way) > 0.04


def test_a_fallback_waits_until_no_accepted_grasp_has_a_motion(
    planner: Planner, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The way to the accepted grasp is narrow: a brief search misses it."""
    found = planner.search(target()).found
    good = found.accepted[0]
    poor = replace(good, q=good.q + 1e-3, success=0.05, reason="low_success_probability")
    found = replace(found, accepted=[good], fallbacks=[poor])
    enough = planner.config.motion.checks

    def narrow(
        checker: PathChecker, inverse: object, start: object, goal: object, seed: int,
        config: MotionConfig,
    ) -> Motion:  # fmt: skip
        if goal is good.q and config.checks < enough:
            return Motion(None, np.zeros((0, 0)), "narrow", 1)
        return plan_motion(checker, planner.inverse, planner.robot.home, goal, seed)

    monkeypatch.setattr(planner_module, "plan_motion", narrow)
    checker = PathChecker(planner.geometry, CylinderField(0.035, 0.24, CAN))
    best, motion, _ = planner._with_motion(checker, found, planner.robot.home, 0)
    assert best is good
    assert motion is not None


def test_a_floor_below_the_usual_one_holds_for_fallbacks_too() -> None:
    none = np.zeros(0)
    unlikely = Candidate(none, none, 0.02, 0.0, 6.0, 1.0, 1.0, 1.0, 1.0, "objective")
    assert unlikely.is_fallback(AcceptanceConfig(least=0.01))
    assert not unlikely.is_fallback(AcceptanceConfig())
