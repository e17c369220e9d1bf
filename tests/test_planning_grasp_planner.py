"""From a cloud to an answer, by both methods, on a can whose grasps have a known score."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from planning_worlds import AroundObject, CylinderField, NearPalm
from torch import Tensor

from pointsdf_cli.camera.pinhole import CAMERAS
from pointsdf_cli.camera.raycast import MeshCaster
from pointsdf_cli.camera.view import View
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.geometry.frames import invert_transform
from pointsdf_cli.io.plans import OK
from pointsdf_cli.models import reconstruction as reconstruction_module
from pointsdf_cli.planning import synthesis
from pointsdf_cli.planning.acceptance import Candidate
from pointsdf_cli.planning.fields import (
    MeanField,
    NearField,
    ReconstructionField,
    RedistancedField,
    SeenField,
    UnionField,
)
from pointsdf_cli.planning.grasp_planner import GraspPlanner, PlanOptions
from pointsdf_cli.planning.likeliest import ENOUGH
from pointsdf_cli.planning.motion import MotionConfig
from pointsdf_cli.planning.planner import PlannerConfig
from pointsdf_cli.planning.seeds import SeedConfig
from pointsdf_cli.planning.synthesis import SynthesisConfig
from pointsdf_cli.planning.target import (
    EmptyFieldError,
    Target,
    given_object,
    missed_points,
    surface_of,
)
from pointsdf_cli.viz.shading import look_at

Array = np.ndarray
RADIUS, HEIGHT = 0.035, 0.2
CAN = (0.6, 0.0, HEIGHT / 2)
REST = np.array([0.0] * 6 + [1.3, 0.5])
SMALL = PlannerConfig(synthesis=SynthesisConfig(rounds=1, seeds=SeedConfig(palms=12, seeds=4)))


class CanGrasps:
    """The palm 9 cm before the can's axis, facing it, is best; seeds stand around the can."""

    def __init__(self, field: Field) -> None:
        self.field = field
        self._score = NearPalm((CAN[0] - 0.09, CAN[1], CAN[2]), (1.0, 0.0, 0.0), REST, width=0.08)
        self._prior = AroundObject(CAN, 0.09, REST)

    def log_success(self, preshape: Tensor, T_world_palm: Tensor) -> Tensor:
        return self._score.log_success(preshape, T_world_palm)

    def log_prior(self, preshape: Tensor, T_world_palm: Tensor) -> Tensor:
        return self._score.log_prior(preshape, T_world_palm)

    def sample(self, kind: str, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        return self._prior.sample(kind, count, rng)


class CanModel:
    """Knows every object to be the can."""

    def on(
        self, points: Array, T_world_camera: Array, field: Field | None = None, seed: int = 0
    ) -> CanGrasps:
        assert field is not None
        return CanGrasps(field)


def can_view(azimuth: float = 0.0) -> View:
    """The can as a camera across the table sees it, without noise."""
    can = trimesh.creation.cylinder(RADIUS, HEIGHT, sections=64)
    can.apply_translation(CAN)
    eye = (CAN[0] + 0.9 * np.cos(azimuth), 0.9 * np.sin(azimuth), 0.6)
    T_world_camera = look_at(eye, CAN)
    camera = CAMERAS["kinect2"]
    vertices = np.asarray(can.vertices)
    patch = MeshCaster(vertices, can.faces, camera).cast(invert_transform(T_world_camera))
    return View(camera.back_project(patch.u, patch.v, patch.depth), T_world_camera)


VIEW = can_view()


@pytest.fixture(scope="module")
def planner() -> GraspPlanner:
    return GraspPlanner(PlanOptions(planner=SMALL), CanModel())


@pytest.fixture(scope="module")
def partial() -> GraspPlanner:
    return GraspPlanner(PlanOptions(method="partial-view", planner=SMALL), CanModel())


def test_a_can_gets_a_plan_that_the_true_can_allows(planner: GraspPlanner) -> None:
    answer = planner.plan([VIEW], seed=1)
    assert answer.plan.status == OK, answer.plan.sentence
    assert answer.plan.kind == "side"
    assert answer.reconstruction is not None
    np.testing.assert_array_equal(answer.candidates[0], answer.plan.q)
    stages = ("reconstruction", "score", "configuration", "motion")
    assert all(answer.plan.timings[stage] >= 0 for stage in stages)
    again = planner.plan([VIEW], seed=1)
    np.testing.assert_array_equal(again.plan.trajectory, answer.plan.trajectory)


def test_the_search_goes_on_until_a_grasp_is_likely_to_hold(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    two = replace(SMALL, synthesis=replace(SMALL.synthesis, rounds=2))
    twice = GraspPlanner(PlanOptions(method="partial-view", planner=two), CanModel())
    solved: list[list[Candidate]] = []
    judged = synthesis.judge

    def kept(*args: Any, **kwargs: Any) -> list[Candidate]:
        solved.append(judged(*args, **kwargs))
        return solved[-1]

    monkeypatch.setattr(synthesis, "judge", kept)
    plan = twice.plan([VIEW], seed=1).plan
    accepted = [one.success for each in solved for one in each if not one.reason]
    assert plan.success_probability == max(accepted) > ENOUGH
    once = len(solved)
    monkeypatch.setattr(synthesis, "ENOUGH", 1.1)
    solved.clear()
    plan = twice.plan([VIEW], seed=1).plan
    accepted = [one.success for each in solved for one in each if not one.reason]
    assert len(solved) > once
    assert plan.success_probability == max(accepted)


def test_the_motion_uses_the_share_of_the_speed_limits_that_is_asked_for() -> None:
    plans = []
    for speed in (0.5, 0.1):
        config = replace(SMALL, motion=MotionConfig(speed=speed))
        options = PlanOptions(method="partial-view", planner=config)
        asked = GraspPlanner(options, CanModel())
        plan = asked.plan([VIEW], seed=1).plan
        assert plan.status == OK
        fastest = np.abs(np.diff(plan.trajectory, axis=0)) / np.diff(plan.times)[:, None]
        share = (fastest / asked.robot.velocity).max()
        assert 0.8 * speed < share < 1.001 * speed
        plans.append(plan)
    usual, slow = plans
    np.testing.assert_array_equal(slow.q, usual.q)
    assert slow.times[-1] > 2 * usual.times[-1]
    with pytest.raises(InputError, match=r"0\.001 to 1"):
        MotionConfig(speed=0.0)


def test_reconstruction_fills_the_can_and_the_partial_view_does_not(
    planner: GraspPlanner, partial: GraspPlanner
) -> None:
    middle = np.array([CAN])
    filled = planner.see([VIEW]).target
    seen = partial.see([VIEW]).target
    assert filled.field(middle)[0] < -0.02
    # Nothing was seen within a radius of the axis: the surface there is one voxel thick.
    assert 0.02 < seen.field(middle)[0] < RADIUS + 0.005
    on_the_far_side = np.array([[CAN[0] - RADIUS, 0.0, CAN[2]]])
    assert abs(filled.field(on_the_far_side)[0]) < 0.015
    assert seen.field(on_the_far_side)[0] > 0.02
    assert partial.see([VIEW]).reconstruction is None


def test_the_score_reads_the_methods_own_field_whatever_constrains(planner: GraspPlanner) -> None:
    truth = CylinderField(RADIUS, HEIGHT, CAN)
    own = planner.see([VIEW])
    given = planner.see([VIEW], field=truth)
    assert given.target.field is truth
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (20, 3)) + CAN
    assert isinstance(given.target.score, CanGrasps)
    assert isinstance(own.target.score, CanGrasps)
    np.testing.assert_array_equal(given.target.score.field(points), own.target.score.field(points))
    without = planner.see([VIEW], field="none")
    assert without.target.field(points).min() > 0.5


def test_two_views_are_the_mean_of_both_and_what_they_saw(planner: GraspPlanner) -> None:
    other = can_view(2.0)
    first, second = (planner.see([view]) for view in (VIEW, other))
    joint = planner.see([VIEW, other])
    completed = [ReconstructionField(s.reconstruction) for s in (first, second)]
    both = UnionField(MeanField(completed), SeenField(joint.points))
    points = np.random.default_rng(0).uniform(-0.08, 0.08, (50, 3)) + CAN
    found, expected = joint.target.field(points), both(points)
    near = expected < RedistancedField.ENOUGH
    assert 10 < near.sum() < 40
    np.testing.assert_allclose(found[near], expected[near], atol=1e-6)
    assert (found >= expected - RedistancedField.MARGIN - 1e-6).all()
    truth = CylinderField(RADIUS, HEIGHT, CAN)(points)
    # A can is known to within 2 mm from one view, and from both no worse than from the worse one.
    one, two, mean = (
        np.abs(s.target.field(points) - truth)[near].mean() for s in (first, second, joint)
    )
    assert mean < max(one, two) < 0.002


def test_the_hand_keeps_off_what_was_seen_where_the_network_saw_nothing(
    planner: GraspPlanner,
) -> None:
    # A wire that stands out of the can: far too thin for a reconstruction.
    wire = np.array(CAN) + [[0.0, 0.0, HEIGHT / 2], [0.0, 0.0, HEIGHT / 2 + 0.02]]
    T = VIEW.T_world_camera
    seen = np.concatenate([VIEW.points, (wire - T[:3, 3]) @ T[:3, :3]])
    perceived = planner.see([View(seen, T)])
    beside = wire[-1:] + [0.0, 0.01, 0.0]
    assert ReconstructionField(perceived.reconstruction)(beside)[0] > 0.012
    for field in (perceived.target.field, perceived.target.kept):
        value = field.with_gradient(beside)[0]
        assert value[0] < 0.012
        np.testing.assert_allclose(field(beside), value)
    np.testing.assert_allclose(
        perceived.target.field.with_gradient(beside)[1], [[0, 1, 0]], atol=1e-6
    )
    assert isinstance(perceived.target.score, CanGrasps)
    assert perceived.target.score.field(beside)[0] > 0.012


def test_the_mean_has_the_mean_gradient() -> None:
    ball, can = CylinderField(0.03, 0.1), CylinderField(0.05, 0.2, (0.02, 0.0, 0.0))
    points = np.random.default_rng(1).uniform(-0.2, 0.2, (10, 3))
    values, gradients = MeanField((ball, can)).with_gradient(points)
    np.testing.assert_allclose(values, (ball(points) + can(points)) / 2)
    expected = (ball.with_gradient(points)[1] + can.with_gradient(points)[1]) / 2
    np.testing.assert_allclose(gradients, expected)


def test_far_away_the_box_answers_and_near_the_field() -> None:
    ball, low, high = CylinderField(0.03, 0.06), np.full(3, -0.03), np.full(3, 0.03)
    field = NearField(ball, low, high, exact_to=0.02)
    points = np.random.default_rng(2).uniform(-0.3, 0.3, (500, 3))
    values, gradients = field.with_gradient(points)
    np.testing.assert_array_equal(values, field(points))
    outside = np.linalg.norm(points - np.clip(points, low, high), axis=1)
    near = outside < 0.02
    assert 0 < near.sum() < len(points)
    np.testing.assert_array_equal(values[near], ball(points)[near])
    np.testing.assert_allclose(values[~near], outside[~near])
    assert (values <= ball(points) + 1e-12).all()
    step = 1e-6 * gradients[~near]
    np.testing.assert_allclose(field(points[~near] + step) - values[~near], 1e-6, rtol=1e-3)


def test_low_things_are_grasped_from_the_top_first(planner: GraspPlanner) -> None:
    low = np.random.default_rng(0).uniform((0.5, -0.1, 0.0), (0.6, 0.1, 0.025), (200, 3))
    assert planner.kinds(low)[0] == "top"
    high = low * [1, 1, 4]
    assert planner.kinds(high) == ("either",)


def test_the_surface_is_where_the_field_is_zero() -> None:
    truth = CylinderField(RADIUS, HEIGHT, CAN)
    points = np.array([CAN])
    shape, grasps = given_object(truth, points), CanGrasps(truth)
    made = surface_of(Target.of(shape, grasps, grasps))
    assert made is not None
    assert np.abs(truth(made[0])).max() < 0.004
    assert trimesh.Trimesh(*made).is_watertight


def test_a_plan_does_not_depend_on_the_processors_fastest_products(
    planner: GraspPlanner, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Where nothing was seen the field is nearly flat, and their errors there would change plans.
    monkeypatch.setattr(reconstruction_module, "fast_products", lambda device: torch.bfloat16)
    quick = planner.see([VIEW]).target
    monkeypatch.setattr(reconstruction_module, "fast_products", lambda device: None)
    exact = planner.see([VIEW]).target
    points = np.random.default_rng(0).uniform(-0.08, 0.08, (200, 3)) + CAN
    np.testing.assert_allclose(quick.field(points), exact.field(points), atol=1e-6)
    assert quick.kept is not None
    assert exact.kept is not None
    np.testing.assert_allclose(quick.kept(points), exact.kept(points), atol=1e-6)
    assert quick.surface is not None
    assert exact.surface is not None
    np.testing.assert_allclose(quick.surface[0], exact.surface[0], atol=1e-6)


def test_the_planned_surface_is_the_redistanced_fields_own(planner: GraspPlanner) -> None:
    perceived = planner.see([VIEW])
    target, made = perceived.target, perceived.surface()
    assert isinstance(target.field, RedistancedField)
    assert made is not None
    assert target.surface is not None
    np.testing.assert_array_equal(made[1], target.surface[1])
    assert np.abs(target.field(target.surface[0])).max() < 0.003


def test_a_surface_that_lacks_what_was_seen_is_doubted() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.04)
    surface = np.asarray(ball.vertices), np.asarray(ball.faces, dtype=np.int32)
    seen = 0.04 * np.random.default_rng(0).normal(size=(1000, 3))
    seen *= 0.04 / np.linalg.norm(seen, axis=1, keepdims=True)
    assert missed_points(surface, seen) == []
    beside = seen + [0.04, 0, 0]
    (said,) = missed_points(surface, beside)
    missed = (np.abs(np.linalg.norm(beside, axis=1) - 0.04) > 0.008).mean()
    told = re.search(r"misses (\d+)% of the seen points", said)
    assert told is not None
    assert int(told[1]) == pytest.approx(100 * missed, abs=3)
    assert "100%" in missed_points(None, seen)[0]


def test_a_field_without_inside_is_no_object(planner: GraspPlanner) -> None:
    far = CylinderField(0.01, 0.02, (9.0, 9.0, 9.0))
    with pytest.raises(EmptyFieldError):
        given_object(far, np.array([CAN]))
    answer = planner.plan([VIEW], field=far)
    assert (answer.plan.status, answer.plan.reason) == ("no_plan", "no_object")
    assert answer.target is None


def test_bad_options_are_refused() -> None:
    with pytest.raises(InputError, match="reconstruction, partial-view"):
        PlanOptions(method="guess")
    with pytest.raises(InputError, match="auto, side, top"):
        PlanOptions(kind="below")


def test_the_bundled_network_plans_for_no_other_hand() -> None:
    gripper = Path(__file__).parent / "robots" / "gripper.yaml"
    with pytest.raises(InputError, match="made with the robot 'lbr4_allegro'"):
        GraspPlanner(PlanOptions(method="partial-view", robot=gripper))
