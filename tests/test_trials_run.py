"""Whole trials of a can: who constrains the hand by the truth does not enter it; evidence fits."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh

from pointsdf_cli.camera.view import View
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.planning.target import EmptyFieldError
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.trials.planner_variants import TrialPlanner
from pointsdf_cli.trials.protocol import (
    CAMERAS,
    NO_CLEANING,
    NO_FREE_SPACE,
    NO_SUCCESS,
    NO_SUPPORT_PLANE,
    ORACLE,
    PlannerVariant,
    Trial,
    TrialObject,
    make_trials,
)
from pointsdf_cli.trials.run import TrialConfig, TrialRunner

pytest.importorskip("pybullet")


@pytest.fixture(scope="module")
def runner() -> Iterator[TrialRunner]:
    made = TrialRunner(TrialConfig())
    yield made
    made.close()


@pytest.fixture(scope="module")
def can(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TrialObject]:
    folder = tmp_path_factory.mktemp("can")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RGRASP_CACHE", str(folder / "cache"))
        trimesh.creation.cylinder(0.03, 0.15).export(folder / "can.ply")
        yield TrialObject("can", folder / "can.ply")


def one_trial(can: TrialObject, method: str, ablation: str = "", camera: str = "high") -> Trial:
    (trial,) = make_trials([can], [PlannerVariant(method, ablation)], yaws=1, cameras=(camera,))
    return trial


def test_the_oracle_plans_clear_of_the_truth_and_says_what_it_saw(
    runner: TrialRunner, can: TrialObject
) -> None:
    trial = one_trial(can, "reconstruction", ORACLE, "low")
    row, evidence = runner.run(trial)
    assert row.status == "ok", row.reason
    assert row.penetration == 0.0
    assert not row.contact
    assert row.held == (row.cause == "held")
    # The can stands where the protocol puts it, seen from the side away from the robot.
    stands = evidence.T_world_object[0]
    np.testing.assert_allclose(stands[:2, 3], [0.6, 0.0], atol=0.08)
    assert stands[2, 3] == pytest.approx(0.075, abs=0.002)
    camera = evidence.T_world_camera[:3, 3]
    assert camera[2] == pytest.approx(CAMERAS["low"])
    assert camera[0] > stands[0, 3] + 0.8
    radial = np.linalg.norm(evidence.cloud[:, :2] - stands[:2, 3], axis=1)
    assert np.percentile(np.abs(radial - 0.03), 70) < 0.006
    # It believed in the truth, drawn from a grid.
    true = apply_transform(stands, trimesh.creation.cylinder(0.03, 0.15).vertices)
    np.testing.assert_allclose(
        np.sort(evidence.vertices.max(axis=0)), np.sort(true.max(axis=0)), atol=2e-3
    )
    assert len(evidence.q) == len(evidence.T_world_object) == len(evidence.phases)
    robot = load_robot()
    np.testing.assert_allclose(evidence.trajectory[0], robot.home, atol=1e-9)
    np.testing.assert_allclose(evidence.trajectory[-1], evidence.q[0], atol=1e-9)


def test_contenders_of_a_pair_see_the_same_points(runner: TrialRunner, can: TrialObject) -> None:
    _, one = runner.run(one_trial(can, "partial-view"))
    row, two = runner.run(one_trial(can, "reconstruction", NO_SUCCESS))
    np.testing.assert_array_equal(one.cloud, two.cloud)
    np.testing.assert_array_equal(one.T_world_object[0], two.T_world_object[0])
    # Whoever thinks all grasps equally good predicts that each holds.
    assert row.success_probability == pytest.approx(1.0)


def test_ablations_of_the_view_leave_out_what_they_say(
    can: TrialObject, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: dict[str, View] = {}
    runner = TrialRunner(TrialConfig(sensor="structured-light"))

    class Nothing:
        shape = None

        def __init__(self, variant: PlannerVariant) -> None:
            self._kept = TrialPlanner.__new__(TrialPlanner)
            self._kept.variant, self._kept._planner = variant, self

        def see(self, views: list[View], *_: object) -> None:
            seen[self._kept.variant.ablation] = views[0]
            raise EmptyFieldError("nothing")

        def nothing(self, what: str) -> None:
            return None

    monkeypatch.setattr(runner, "_planner", lambda variant: Nothing(variant)._kept)
    for ablation in ("", NO_CLEANING, NO_FREE_SPACE, NO_SUPPORT_PLANE):
        runner.run(one_trial(can, "reconstruction", ablation))
    runner.close()
    whole = seen[""].evidence
    assert whole is not None
    assert whole.visibility is not None
    assert whole.support_plane is not None
    assert len(seen[NO_CLEANING].points) > len(seen[""].points)
    bare, floating = seen[NO_FREE_SPACE].evidence, seen[NO_SUPPORT_PLANE].evidence
    assert bare is not None
    assert floating is not None
    assert bare.visibility is None
    np.testing.assert_array_equal(bare.support_plane, whole.support_plane)
    assert floating.support_plane is None
    np.testing.assert_array_equal(floating.visibility.free, whole.visibility.free)


def test_a_mesh_that_is_none_is_refused(runner: TrialRunner, tmp_path: Path) -> None:
    (tmp_path / "bad.ply").write_text("no mesh", encoding="ascii")
    trial = one_trial(TrialObject("bad", tmp_path / "bad.ply"), "partial-view")
    with pytest.raises(InputError):
        runner.run(trial)
