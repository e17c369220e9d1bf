"""The ROS 2 example: its messages by the definitions of rosbags, its timing by hand.

ROS itself is not a dependency: the node that sends the messages runs here on stand-ins of ROS.
"""

from __future__ import annotations

import importlib.util
import runpy
import signal
import sys
import types
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from bags import STORE, TYPES
from plan_files import turning_plan

from pointsdf_cli.assets import DEFAULT_ROBOT, asset_path
from pointsdf_cli.io.motion_file import velocities_of, write_trajectory
from pointsdf_cli.io.plans import Plan, write_plan
from pointsdf_cli.robot.description import RobotDescription, load_robot

FOLDER = Path(__file__).resolve().parents[1] / "examples" / "ros2"
NAME = "trajectory_msgs/msg/JointTrajectory"


@pytest.fixture(scope="module")
def example() -> Iterator[Any]:
    spec = importlib.util.spec_from_file_location("trajectories", FOLDER / "trajectories.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["trajectories"] = module  # NamedTuple looks its annotations up there
    spec.loader.exec_module(module)
    yield module
    del sys.modules["trajectories"]


@pytest.fixture(scope="module")
def robot() -> RobotDescription:
    return load_robot()


@pytest.fixture(scope="module")
def plan(robot: RobotDescription) -> Plan:
    plan = turning_plan(robot)
    lift = np.repeat(plan.q[None], 4, axis=0)
    lift[:, 1] += [0.0, 0.1, 0.3, 0.4]  # steps of 0.1, 0.2 and 0.1 rad
    return replace(plan, lift=lift)


def message_types(example: Any) -> Any:
    prefix = "trajectory_msgs/msg/JointTrajectory"
    return example.MessageTypes(
        TYPES[prefix], TYPES[f"{prefix}Point"], TYPES["std_msgs/msg/Header"],
        TYPES["builtin_interfaces/msg/Time"], TYPES["builtin_interfaces/msg/Duration"],
        lambda values: np.array(values, dtype=np.float64),
    )  # fmt: skip


def sent(example: Any, trajectory: Any) -> Any:
    """The message as a subscriber gets it: through ROS's own wire format."""
    raw = STORE.serialize_cdr(example.message(trajectory, message_types(example)), NAME)
    return STORE.deserialize_cdr(raw, NAME)


def test_the_motion_arrives_as_it_was_planned(example: Any, plan: Plan, tmp_path: Path) -> None:
    write_trajectory(tmp_path / "motion.json", plan)
    motion = example.read_motion(tmp_path / "motion.json")
    got = sent(example, motion)
    assert tuple(got.joint_names) == plan.joint_names
    # The first point is where the robot stands.
    np.testing.assert_allclose([p.positions for p in got.points], plan.trajectory[1:])
    seconds = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in got.points]
    np.testing.assert_allclose(seconds, plan.times[1:], atol=1e-9)
    velocities = velocities_of(plan.times, plan.trajectory)
    np.testing.assert_allclose([p.velocities for p in got.points], velocities[1:])
    assert all(len(p.accelerations) == len(p.effort) == 0 for p in got.points)


def test_a_controller_gets_its_own_joints(
    example: Any, plan: Plan, robot: RobotDescription, tmp_path: Path
) -> None:
    write_trajectory(tmp_path / "motion.json", plan)
    arm, hand = example.read_hand(asset_path(DEFAULT_ROBOT))
    assert arm == robot.joint_names[:7]
    assert tuple(hand.speeds) == robot.closing_joints
    ends = [robot.hard_upper[robot.joint_names.index(name)] for name in hand.limits]
    np.testing.assert_allclose(list(hand.limits.values()), ends)  # all close upwards
    part = example.read_motion(tmp_path / "motion.json").of(arm[::-1])
    np.testing.assert_allclose(part.positions, plan.trajectory[:, :7][:, ::-1])


def test_no_joint_is_faster_than_the_lift_may_be(example: Any, plan: Plan, tmp_path: Path) -> None:
    write_plan(tmp_path / "plan.h5", plan, seed=0)
    lift = example.read_lift(tmp_path / "plan.h5", speed=0.2)
    np.testing.assert_allclose(lift.positions, plan.lift)
    # 0.4 rad at 0.2 rad/s at most; 3 t² − 2 t³ of the way at the share t of 3 s.
    assert lift.times[-1] == pytest.approx(3.0)
    t = lift.times / 3
    np.testing.assert_allclose(3 * t**2 - 2 * t**3, [0, 0.25, 0.75, 1], atol=1e-5)
    assert np.abs(lift.velocities).max() <= 0.2
    np.testing.assert_array_equal(lift.velocities[[0, -1]], 0)
    write_plan(tmp_path / "none.h5", replace(plan, lift=plan.lift[:0]), seed=0)
    assert example.read_lift(tmp_path / "none.h5", speed=0.2) is None


def test_fingers_close_at_their_own_speeds_and_stop_at_their_ends(example: Any) -> None:
    # a: 1 rad at 0.5 rad/s, 2 s; b: from 0.04 to 0 m at 0.01 m/s, 4 s; c does not close.
    hand = example.Hand({"a": 0.5, "b": -0.01}, {"a": 1.0, "b": 0.0})
    way = example.closing(hand, ["a", "b", "c"], [0.0, 0.04, 0.3])
    np.testing.assert_allclose(way.times, [0, 2, 4])
    np.testing.assert_allclose(way.positions, [[0, 0.04, 0.3], [1, 0.02, 0.3], [1, 0, 0.3]])
    assert [p.time_from_start.sec for p in sent(example, way).points] == [2, 4]


def test_joints_that_follow_others_are_the_hardwares(example: Any) -> None:
    _, hand = example.read_hand(asset_path("robots/panda.yaml"))
    assert hand.followers == {"panda_finger_joint2"}
    assert set(hand.speeds) == set(hand.limits) == {"panda_finger_joint1"}


def test_a_grip_presses_and_stays_within_the_limits(example: Any) -> None:
    hand = example.Hand({"a": 0.5, "b": -0.01}, {"a": 1.0, "b": 0.0})
    target = example.grip(hand, ["a", "b", "c"], [0.5, 0.03, 0.3], squeeze=0.1, time=0.5)
    np.testing.assert_allclose(target.positions, [[0.6, 0.0, 0.3]])
    assert sent(example, target).points[0].time_from_start.nanosec == 500_000_000


def test_a_hand_has_stalled_when_all_fingers_have(example: Any) -> None:
    hand = example.Hand({"a": 0.5, "b": -0.01}, {"a": 1.0, "b": 0.0})
    assert example.stalled(hand, {"a": 0.01, "b": -0.0005, "arm": 1.0})
    assert not example.stalled(hand, {"a": 0.01, "b": -0.005})


def test_another_start_is_noticed(example: Any, plan: Plan, tmp_path: Path) -> None:
    write_trajectory(tmp_path / "motion.json", plan)
    motion = example.read_motion(tmp_path / "motion.json")
    measured = dict(zip(plan.joint_names, plan.trajectory[0], strict=True))
    assert example.farthest_from(motion, 0, measured)[1] == 0
    measured[plan.joint_names[2]] += 0.25
    joint, off = example.farthest_from(motion, 0, measured)
    assert joint == plan.joint_names[2]
    assert off == pytest.approx(0.25)


class Goals(list):
    """The goals that the node sent, in order, and ROS as far as the node uses it.

    ROS cannot be installed from package registries, so its actions are stand-ins here that accept
    every goal and reach it at once. Each spin takes 0.05 s.

    Args:
        off: Distance of the arm's first joint from where each trajectory ends [rad].
        gripper: Results (reached_goal, stalled, position) of the gripper's goals in turn; None for
            one that is aborted, or the whole answer.
    """

    def __init__(self, off: float, gripper: list[Any]) -> None:
        super().__init__()
        self.off, self.gripper, self.spins = off, gripper, 0
        self.missing, self.due = "", (0, dict[str, float]())  # a server; positions after some spins
        self.heard: list[Any] = []

    def result_of(self, goal: Any, state: dict[str, float]) -> Any:
        """Result of a goal; a trajectory moves the robot."""
        if not hasattr(goal, "trajectory"):
            found = self.gripper.pop(0)
            if isinstance(found, SimpleNamespace):
                return found
            reached, stalled, position = found or (False, False, 0.0)
            result = SimpleNamespace(reached_goal=reached, stalled=stalled, position=position)
            return SimpleNamespace(status=4 if found else 6, result=result)
        names, end = goal.trajectory.joint_names, goal.trajectory.points[-1].positions
        state.update(zip(names, end, strict=True))
        if names[0] == next(iter(state)):
            state[names[0]] += self.off
        return SimpleNamespace(status=4, result=SimpleNamespace(error_code=0))

    def modules(self, start: dict[str, float]) -> dict[str, types.ModuleType]:
        """Stand-ins of the modules that the node imports; the robot stands at `start`."""
        goals, state = self, dict(start)

        class Future:
            def __init__(self, value: Any) -> None:
                self.result, self.done = (lambda: value), (lambda: value is not None)

        class ActionClient:
            def __init__(self, node: Any, action: Any, name: str) -> None:
                self.name, self.wait_for_server = name, lambda timeout_sec: name != goals.missing

            def send_goal_async(self, goal: Any) -> Future:
                goals.append((self.name, goal))
                result = goals.result_of(goal, state)
                handle = SimpleNamespace(
                    accepted=True, get_result_async=lambda: Future(result),
                    cancel_goal_async=lambda: Future(None),
                )  # fmt: skip
                return Future(handle)

        class Node:
            def __init__(self, name: str) -> None:
                pass

            def create_subscription(self, kind: Any, topic: str, heard: Any, depth: int) -> None:
                goals.heard.append(heard)

            def destroy_node(self) -> None:
                pass

        class GripperGoal:
            def __init__(self) -> None:
                self.command = SimpleNamespace()

        def message_of(name: str) -> Any:
            return lambda **values: SimpleNamespace(kind=name, **values)

        def spin_once(node: Any, timeout_sec: float) -> None:
            goals.spins += 1  # the drivers of arm and hand publish in turn
            if goals.spins >= goals.due[0]:
                state.update(goals.due[1])
                goals.due = (0, {})
            names = list(state)[:7] if goals.spins % 2 else list(state)[7:]
            positions, still = [state[name] for name in names], [0.0] * len(names)
            for heard in goals.heard:
                heard(SimpleNamespace(name=names, position=positions, velocity=still))

        none = lambda *_, **__: None  # noqa: E731
        follow = SimpleNamespace(Goal=message_of("goal"), Result=SimpleNamespace(SUCCESSFUL=0))
        contents = {
            "rclpy": {"spin_once": spin_once, "init": none, "try_shutdown": none,
                      "spin_until_future_complete": none},
            "rclpy.action": {"ActionClient": ActionClient},
            "rclpy.node": {"Node": Node},
            "rclpy.signals": {"SignalHandlerOptions": SimpleNamespace(NO=0)},
            "rclpy.task": {"Future": Future},
            "control_msgs.action": {"FollowJointTrajectory": follow,
                                    "GripperCommand": SimpleNamespace(Goal=GripperGoal)},
            "action_msgs.msg": {"GoalStatus": SimpleNamespace(STATUS_SUCCEEDED=4)},
            "builtin_interfaces.msg": {n: message_of(n) for n in ("Duration", "Time")},
            "sensor_msgs.msg": {"JointState": message_of("JointState")},
            "std_msgs.msg": {"Header": message_of("Header")},
            "trajectory_msgs.msg": {
                n: message_of(n) for n in ("JointTrajectory", "JointTrajectoryPoint")
            },
        }  # fmt: skip
        for name in [name for name in contents if "." in name]:
            contents.setdefault(name.split(".")[0], {})
        made = {name: types.ModuleType(name) for name in contents}
        for name, values in contents.items():
            vars(made[name]).update(values)
        return made


def run_node(
    monkeypatch: pytest.MonkeyPatch,
    plan: Plan,
    folder: Path,
    *more: str,
    moved: float = 0.0,
    off: float = 0.0,
    gripper: tuple[Any, ...] = (),
    lifts: Plan | None = None,
    missing: str = "",
) -> Goals:
    """The goals of the node for a plan, the robot's first joint `moved` from its start; plan.h5 is
    of the plan `lifts`."""
    write_trajectory(folder / "motion.json", plan)
    write_plan(folder / "plan.h5", lifts or plan, seed=0)
    start = dict(zip(plan.joint_names, plan.trajectory[0].tolist(), strict=True))
    start[plan.joint_names[0]] += moved
    goals = Goals(off, list(gripper))
    goals.missing = missing
    for name, module in goals.modules(start).items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.syspath_prepend(str(FOLDER))
    robot = str(asset_path(DEFAULT_ROBOT))
    files = [str(folder / "motion.json"), str(folder / "plan.h5"), robot]
    monkeypatch.setattr(sys, "argv", ["execute_plan.py", *files, *more])
    clock = SimpleNamespace(monotonic=lambda: 0.05 * goals.spins)
    monkeypatch.setitem(sys.modules, "time", clock)
    before = {each: signal.getsignal(each) for each in (signal.SIGTERM, signal.SIGHUP)}
    try:
        runpy.run_path(str(FOLDER / "execute_plan.py"), run_name="__main__")
    except SystemExit as leave:
        leave.goals = goals  # type: ignore[attr-defined]
        raise
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
    return goals


ARM = "/arm_controller/follow_joint_trajectory"
HAND = "/hand_controller/follow_joint_trajectory"
FAILED = SimpleNamespace(status=6, result=SimpleNamespace(error_code=-4, error_string="blocked"))


def test_the_node_moves_closes_grips_and_lifts(
    monkeypatch: pytest.MonkeyPatch, plan: Plan, robot: RobotDescription, tmp_path: Path
) -> None:
    goals = run_node(monkeypatch, plan, tmp_path)
    assert [name for name, _ in goals] == [HAND, ARM, HAND, HAND, ARM]
    lift = goals[-1][1].trajectory
    assert tuple(lift.joint_names) == robot.joint_names[:7]
    np.testing.assert_allclose(lift.points[-1].positions, plan.lift[-1, :7])


def test_a_lift_that_somebody_cancels_is_no_success(
    monkeypatch: pytest.MonkeyPatch, plan: Plan, tmp_path: Path
) -> None:
    arm = []

    def result_of(self: Goals, goal: Any, state: dict[str, float]) -> Any:
        if goal.trajectory.joint_names[0] == next(iter(state)):
            arm.append(goal)
        if len(arm) == 2:  # the controller's result of a cancelled goal: no error
            return SimpleNamespace(status=5, result=SimpleNamespace(error_code=0))
        return moved(self, goal, state)

    moved = Goals.result_of
    monkeypatch.setattr(Goals, "result_of", result_of)
    with pytest.raises(SystemExit, match="status 5"):
        run_node(monkeypatch, plan, tmp_path)
    assert len(arm) == 2


def of_the_hand(
    monkeypatch: pytest.MonkeyPatch, told: Callable[[Goals, int, Any], Any]
) -> list[str]:
    """Let `told` answer goals of the hand by their number, without a motion; None is a success.

    Returns the controllers in the order of their goals.
    """
    sent: list[str] = []

    def result_of(self: Goals, goal: Any, state: dict[str, float]) -> Any:
        arm = goal.trajectory.joint_names[0] == next(iter(state))
        sent.append("arm" if arm else "hand")
        answer = told(self, sent.count("hand"), goal) if not arm else None
        return answer or moved(self, goal, state)

    moved = Goals.result_of
    monkeypatch.setattr(Goals, "result_of", result_of)
    return sent


def test_the_arm_does_not_drive_on_where_the_hand_fails(
    monkeypatch: pytest.MonkeyPatch, plan: Plan, tmp_path: Path
) -> None:
    def result_of(self: Goals, goal: Any, state: dict[str, float]) -> Any:
        return None if goal.trajectory.joint_names[0] == next(iter(state)) else FAILED

    monkeypatch.setattr(Goals, "result_of", result_of)  # the arm moves on
    with pytest.raises(SystemExit, match="blocked") as left:
        run_node(monkeypatch, plan, tmp_path)
    goals = left.value.goals  # type: ignore[attr-defined]
    assert [name for name, _ in goals] == [HAND, ARM]
    assert goals.spins < 10


@pytest.mark.parametrize("missing", [HAND, ARM])
def test_nothing_moves_where_a_controller_is_missing(
    monkeypatch: pytest.MonkeyPatch, plan: Plan, tmp_path: Path, missing: str
) -> None:
    with pytest.raises(SystemExit, match=f"no action server of {missing.rpartition('/')[0]}") as at:
        run_node(monkeypatch, plan, tmp_path, missing=missing)
    assert at.value.goals == []  # type: ignore[attr-defined]


@pytest.mark.parametrize("number", [2, 3], ids=["closing", "gripping"])
def test_a_hand_that_fails_lifts_nothing(
    monkeypatch: pytest.MonkeyPatch, plan: Plan, tmp_path: Path, number: int
) -> None:
    sent = of_the_hand(monkeypatch, lambda goals, at, goal: FAILED if at == number else None)
    with pytest.raises(SystemExit, match="blocked"):
        run_node(monkeypatch, plan, tmp_path)
    assert sent == ["hand", "arm", *["hand"] * (number - 1)]


def test_fingers_that_do_not_move_grip_nothing(
    monkeypatch: pytest.MonkeyPatch, plan: Plan, tmp_path: Path
) -> None:
    reached = SimpleNamespace(status=4, result=SimpleNamespace(error_code=0))
    sent = of_the_hand(monkeypatch, lambda goals, at, goal: reached if at == 2 else None)
    with pytest.raises(SystemExit, match="no finger moved"):
        run_node(monkeypatch, plan, tmp_path)
    assert sent == ["hand", "arm", "hand"]


def test_fingers_that_start_late_are_waited_for(
    monkeypatch: pytest.MonkeyPatch, plan: Plan, robot: RobotDescription, tmp_path: Path
) -> None:
    reached = SimpleNamespace(status=4, result=SimpleNamespace(error_code=0))

    def late(goals: Goals, at: int, goal: Any) -> Any:
        if at != 2:
            return None
        end = goal.trajectory.points[-1].positions
        goals.due = goals.spins + 40, dict(zip(goal.trajectory.joint_names, end, strict=True))
        return reached

    of_the_hand(monkeypatch, late)
    goals = run_node(monkeypatch, plan, tmp_path)
    grip = goals[3][1].trajectory
    target = dict(zip(grip.joint_names, grip.points[-1].positions, strict=True))
    for name in robot.closing_joints:  # nothing was in the way
        assert target[name] == pytest.approx(robot.hard_upper[robot.joint_names.index(name)])


@pytest.mark.parametrize("option", ["--lift-speed", "--tolerance", "--squeeze"])
@pytest.mark.parametrize("value", ["-0.1", "nan", "text"])
def test_numbers_out_of_their_range_are_refused_before_the_motion(
    monkeypatch: pytest.MonkeyPatch, plan: Plan, tmp_path: Path, option: str, value: str
) -> None:
    with pytest.raises(SystemExit) as left:
        run_node(monkeypatch, plan, tmp_path, f"{option}={value}")
    assert left.value.code == 2
    assert left.value.goals == []  # type: ignore[attr-defined]


def test_a_joint_without_limits_closes_as_it_does_in_plans(example: Any, tmp_path: Path) -> None:
    hand = "closing_joints: {f: -0.5, g: 0.5, h: 0.5}\narm_joints: [a]\nurdf: r.urdf\n"
    (tmp_path / "r.yaml").write_text(hand)
    (tmp_path / "r.urdf").write_text(
        '<robot><joint name="f" type="continuous"/><joint name="g" type="revolute"/>'
        '<joint name="h" type="revolute"><limit lower="-1" upper="1.2"/></joint></robot>'
    )
    _, closing = example.read_hand(tmp_path / "r.yaml")
    assert closing.limits == {"f": -np.pi, "g": np.pi, "h": 1.2}


OPENED = (True, False, 0.04)
GRIPPER = ("--gripper", "/gripper_cmd", "--gripper-open", "0.04", "--gripper-closed", "0")


def test_a_gripper_opens_before_the_motion_and_closes_before_the_lift(
    monkeypatch: pytest.MonkeyPatch, plan: Plan, tmp_path: Path
) -> None:
    more = (*GRIPPER, "--gripper-effort", "15")
    # The Franka Hand's driver does not tell that it stalled.
    # ros2_control's own, by default, aborts where it stalled.
    stalled = SimpleNamespace(reached_goal=False, stalled=True, position=0.02)
    aborted = SimpleNamespace(status=6, result=stalled)
    for told in ((False, True, 0.0), (True, False, 0.03), aborted):
        results = (OPENED, told)
        goals = run_node(monkeypatch, plan, tmp_path, *more, gripper=results)
        assert [name for name, _ in goals] == ["/gripper_cmd", ARM, "/gripper_cmd", ARM]
    commands = [goal.command for name, goal in goals if name == "/gripper_cmd"]
    assert [(each.position, each.max_effort) for each in commands] == [(0.04, 15.0), (0.0, 15.0)]
    with pytest.raises(SystemExit):
        run_node(monkeypatch, plan, tmp_path, "--gripper", "/gripper_cmd")


@pytest.mark.parametrize(
    ("results", "told", "sent"),
    [
        ((None,), "failed", ["/gripper_cmd"]),
        (((False, True, 0.01),), "did not open", ["/gripper_cmd"]),
        ((OPENED, None), "failed", ["/gripper_cmd", ARM, "/gripper_cmd"]),
        ((OPENED, (True, False, 0.0)), "met nothing", ["/gripper_cmd", ARM, "/gripper_cmd"]),
    ],
)
def test_the_arm_does_not_move_after_a_gripper_that_failed(
    monkeypatch: pytest.MonkeyPatch,
    plan: Plan,
    tmp_path: Path,
    results: tuple[tuple[bool, bool, float] | None, ...],
    told: str,
    sent: list[str],
) -> None:
    with pytest.raises(SystemExit, match=told) as left:
        run_node(monkeypatch, plan, tmp_path, *GRIPPER, gripper=results)
    assert [name for name, _ in left.value.goals] == sent  # type: ignore[attr-defined]


def test_the_node_sends_nothing_from_another_start(
    monkeypatch: pytest.MonkeyPatch, plan: Plan, tmp_path: Path
) -> None:
    with pytest.raises(SystemExit, match="plan again with --start") as left:
        run_node(monkeypatch, plan, tmp_path, moved=0.1)
    assert left.value.goals == []  # type: ignore[attr-defined]


def test_the_hand_does_not_close_where_the_arm_is_not_at_the_grasp(
    monkeypatch: pytest.MonkeyPatch, plan: Plan, tmp_path: Path
) -> None:
    with pytest.raises(SystemExit, match=r"is 0\.050 from the grasp") as left:
        run_node(monkeypatch, plan, tmp_path, off=0.05)
    assert len(left.value.goals) == 2  # type: ignore[attr-defined]


def test_a_plan_of_another_run_is_refused(
    monkeypatch: pytest.MonkeyPatch, plan: Plan, tmp_path: Path
) -> None:
    none = replace(
        plan, status="no_plan", reason="ik_failed", q=plan.q * np.nan,
        trajectory=plan.trajectory[:0], times=plan.times[:0], lift=plan.lift[:0],
    )  # fmt: skip
    others = {
        "grasps elsewhere": replace(plan, q=plan.q + 0.3, lift=plan.lift[:0]),
        "holds no grasp": none,
        "probability 0.04": replace(plan, success_probability=0.04),
    }
    for told, other in others.items():
        with pytest.raises(SystemExit, match=told) as left:
            run_node(monkeypatch, plan, tmp_path, lifts=other)
        assert left.value.goals == []  # type: ignore[attr-defined]
    assert run_node(monkeypatch, plan, tmp_path, "--accept-unlikely", lifts=other)


def test_the_hand_does_not_close_where_its_fingers_are_not_at_the_preshape(
    monkeypatch: pytest.MonkeyPatch, plan: Plan, tmp_path: Path
) -> None:
    def result_of(self: Goals, goal: Any, state: dict[str, float]) -> Any:
        before = dict(state)
        found = moved(self, goal, state)
        if goal.trajectory.joint_names[0] != next(iter(state)):  # the hand's controller lies
            state.update(before)
        return found

    moved = Goals.result_of
    monkeypatch.setattr(Goals, "result_of", result_of)
    path = plan.trajectory.copy()
    path[0, 8] += 0.3  # the preshape is not where the motion begins
    with pytest.raises(SystemExit, match=r"is 0\.300 from the grasp") as left:
        run_node(monkeypatch, replace(plan, trajectory=path), tmp_path)
    assert len(left.value.goals) == 2  # type: ignore[attr-defined]
