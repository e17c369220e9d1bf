"""Plans survive being written, as HDF5 and as JSON; what cannot be a plan is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.motion_file import trajectory_as_json, velocities_of, write_trajectory
from pointsdf_cli.io.plans import (
    AcceptedGrasps,
    Plan,
    RejectedSeeds,
    plan_as_json,
    read_plan,
    write_plan,
)


@pytest.fixture
def plan() -> Plan:
    rejected = RejectedSeeds(
        q=np.array([[0.5, 0.6]]),
        reasons=("object_collision",),
        success_probability=np.array([0.7]),
        objective=np.array([4.0]),
        slack=np.array([[-0.003, 0.02, np.inf, 0.004]]),
    )
    return Plan(
        status="ok",
        reason="",
        sentence="",
        joint_names=("shoulder", "elbow"),
        q=np.array([0.1, -0.2]),
        trajectory=np.array([[0.0, 0.0], [0.05, -0.1], [0.1, -0.2]]),
        times=np.array([0.0, 0.99999999996, 1.25]),
        T_world_palm=np.eye(4),
        success_probability=0.8,
        objective=1.5,
        seeds_tried=8,
        timings={"solve": 0.25},
        link_names=("arm", "hand"),
        link_clearance_object=np.array([np.inf, 0.002]),
        link_clearance_table=np.array([0.3, 0.05]),
        rejected=rejected,
        kind="side",
        accepted=AcceptedGrasps(
            np.array([[0.1, -0.2], [0.2, 0.3]]),
            ("side", "top"),
            np.array([0.8, 0.7]),
            np.array([1.5, 2.5]),
        ),
        lift=np.array([[0.1, -0.2], [0.15, -0.2]]),
    )


def with_tetrahedron(plan: Plan) -> Plan:
    vertices = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], np.float32)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)
    return replace(plan, object_vertices=vertices, object_faces=faces)


def test_a_plan_keeps_the_completed_object(plan: Plan, tmp_path: Path) -> None:
    whole = with_tetrahedron(plan)
    write_plan(tmp_path / "plan.h5", whole, seed=0)
    back = read_plan(tmp_path / "plan.h5")
    np.testing.assert_array_equal(back.object_vertices, whole.object_vertices)
    np.testing.assert_array_equal(back.object_faces, whole.object_faces)


def test_a_plan_of_before_has_no_object_and_is_read(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "plan.h5"
    write_plan(path, with_tetrahedron(plan), seed=0)
    with h5py.File(path, "a") as file:
        del file["object_vertices"], file["object_faces"]
    back = read_plan(path)
    np.testing.assert_array_equal(back.q, plan.q)
    assert back.object_vertices.shape == back.object_faces.shape == (0, 3)


def test_faces_of_vertices_that_are_not_there_are_refused(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "plan.h5"
    write_plan(path, with_tetrahedron(plan), seed=0)
    with h5py.File(path, "a") as file:
        file["object_faces"][0, 0] = 4
    with pytest.raises(InputError, match="faces"):
        read_plan(path)


def no_plan(plan: Plan) -> Plan:
    nan = np.full(2, np.nan)
    return replace(
        plan,
        status="no_plan",
        reason="motion",
        sentence="No way.",
        q=nan,
        trajectory=np.zeros((0, 2)),
        times=np.zeros(0),
        T_world_palm=np.full((4, 4), np.nan),
        rejected=RejectedSeeds(np.zeros((0, 2)), (), np.zeros(0), np.zeros(0), np.zeros((0, 4))),
        link_clearance_object=nan,
        link_clearance_table=nan,
        kind="",
        accepted=AcceptedGrasps.none(2),
        lift=np.zeros((0, 2)),
    )


@pytest.mark.parametrize("found", [True, False])
def test_what_is_written_is_read(tmp_path: Path, plan: Plan, found: bool) -> None:
    plan = plan if found else no_plan(plan)
    write_plan(tmp_path / "plan.h5", plan, seed=3, config={"solver": "sqp"})
    back = read_plan(tmp_path / "plan.h5")
    for name in Plan.__dataclass_fields__:
        if name in ("rejected", "accepted"):
            continue
        one, two = getattr(plan, name), getattr(back, name)
        if isinstance(one, np.ndarray):
            np.testing.assert_array_equal(one, two)
        else:
            assert one == two, name
    assert back.accepted.kinds == plan.accepted.kinds
    np.testing.assert_array_equal(back.accepted.q, plan.accepted.q)
    np.testing.assert_array_equal(back.accepted.objective, plan.accepted.objective)
    assert back.rejected.reasons == plan.rejected.reasons
    np.testing.assert_array_equal(back.rejected.slack, plan.rejected.slack)


def test_the_file_says_what_the_contract_names(tmp_path: Path, plan: Plan) -> None:
    write_plan(tmp_path / "plan.h5", plan, seed=3)
    with h5py.File(tmp_path / "plan.h5") as file:
        assert file.attrs["schema"] == "plan"
        assert file.attrs["status"] == "ok"
        assert json.loads(file.attrs["timings_json"]) == {"solve": 0.25}
        assert file["q"].attrs["units"] == "rad or m"
        assert file["T_world_palm"].attrs["frame"] == "world"
        assert [n.decode() for n in file["joint_names"]] == ["shoulder", "elbow"]


def test_json_is_strict_and_says_null_for_what_is_not_there(plan: Plan) -> None:
    text = json.dumps(plan_as_json(plan), allow_nan=False)
    data = json.loads(text)
    assert data["q"] == [0.1, -0.2]
    assert data["link_clearance"]["arm"] == {"object": None, "table": 0.3}
    assert data["rejected"][0]["slack"]["obstacles"] is None
    none = json.loads(json.dumps(plan_as_json(no_plan(plan)), allow_nan=False))
    assert none["q"] is None
    assert none["reason"] == "motion"


def test_times_split_into_whole_seconds_and_nanoseconds(tmp_path: Path, plan: Plan) -> None:
    points = trajectory_as_json(plan)["points"]
    assert points[1]["time_from_start"] == {"sec": 1, "nanosec": 0}
    assert points[2]["time_from_start"] == {"sec": 1, "nanosec": 250_000_000}
    write_trajectory(tmp_path / "motion.json", plan)
    data = json.loads((tmp_path / "motion.json").read_text())
    assert data["joint_names"] == ["shoulder", "elbow"]
    assert data["points"][2]["positions"] == [0.1, -0.2]
    with pytest.raises(InputError, match="no motion"):
        trajectory_as_json(no_plan(plan))


def test_a_plan_that_contradicts_itself_is_refused(plan: Plan) -> None:
    with pytest.raises(InputError, match="status"):
        replace(plan, reason="motion")
    with pytest.raises(InputError, match="fit"):
        replace(plan, q=np.zeros(3))


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    (tmp_path / "plan.h5").write_bytes(b"no")
    with pytest.raises(InputError, match="HDF5"):
        read_plan(tmp_path / "plan.h5")


def test_velocities_are_exact_along_a_leg_and_zero_at_a_corner() -> None:
    # From rest at 2 rad/s² for 1 s along x, and back to rest in the next; then the same along y.
    t = np.linspace(0, 2, 9)
    way = np.where(t < 1, t**2, 2 - (2 - t) ** 2)
    x = np.concatenate([way, np.full(8, 2.0)])
    y = np.concatenate([np.zeros(9), way[1:]])
    times = np.concatenate([t, 2 + t[1:]])
    velocities = velocities_of(times, np.stack([x, y], axis=1))
    speed = np.where(t < 1, 2 * t, 2 * (2 - t))
    np.testing.assert_allclose(velocities[1:4, 0], speed[1:4], atol=1e-12)
    np.testing.assert_allclose(velocities[13:16, 1], speed[5:8], atol=1e-12)
    np.testing.assert_array_equal(velocities[[0, 8, 16]], 0)  # the ends and the corner
    np.testing.assert_array_equal(velocities[9:, 0], 0)  # cubics stay on the leg
    assert velocities_of(np.array([0.0, 1.0]), np.eye(2)).tolist() == [[0, 0], [0, 0]]
