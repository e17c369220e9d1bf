"""Execute a plan with ROS 2: motion, closing until the fingers stall, grip, lift.

    rgrasp plan depth.png --intrinsics K.json --camera-pose T_world_camera.json \\
        --start "$START" --speed 0.1 --trajectory motion.json
    python examples/ros2/execute_plan.py motion.json plan.h5 robot.yaml \\
        --arm-controller /arm_controller --hand-controller /hand_controller

Both controllers are joint_trajectory_controllers (ros2_control); positions are read from
/joint_states. A gripper with an action of its own (control_msgs/GripperCommand) takes
`--gripper /gripper_cmd --gripper-open P --gripper-closed P` in place of --hand-controller, in the
unit of that action. Ctrl-C, SIGTERM, SIGHUP or an error cancels the running goals. See
docs/robot.md.
"""

from __future__ import annotations

import argparse
import math
import signal
import sys
import time
from pathlib import Path

try:
    import rclpy
except ImportError:
    sys.exit("no ROS 2 here: source /opt/ros/DISTRO/setup.bash first")
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration, Time
from control_msgs.action import FollowJointTrajectory, GripperCommand
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from trajectories import (
    Hand,
    MessageTypes,
    Trajectory,
    apart,
    closing,
    farthest_from,
    farthest_share,
    grip,
    message,
    read_grasp,
    read_hand,
    read_lift,
    read_motion,
    stalled,
)
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

TYPES = MessageTypes(JointTrajectory, JointTrajectoryPoint, Header, Time, Duration, list)
STALLED_FOR = 0.2  # s
GRIP_TIME = 0.5  # s
LATE = 5.0  # s that a controller may take longer than its trajectory
GRIPPER_TIME = 20.0  # s
CLOSED = 0.02  # of the gripper's way: nearer to its closed position it holds nothing
MOVED = 0.01  # of a finger's way: less is noise
SAME_PLAN = 1e-3  # rad or m between the end of the motion and the plan's grasp
UNLIKELY = 0.1  # success probability below which `rgrasp plan` ends with exit code 4


class Executor(Node):
    """Sends goals to the arm's controller and the hand's, or a gripper's, and follows
    /joint_states."""

    def __init__(self, arm: str, hand: str, gripper: str | None = None) -> None:
        super().__init__("rgrasp_execute_plan")
        self.positions: dict[str, float] = {}
        self.velocities: dict[str, float] = {}
        self.running: list = []
        self.asked: Future | None = None
        self.clients_of = {
            name: ActionClient(self, FollowJointTrajectory, f"{name}/follow_joint_trajectory")
            for name in ((arm,) if gripper else (arm, hand))
        }
        if gripper:
            self.clients_of[gripper] = ActionClient(self, GripperCommand, gripper)
        self.arm, self.hand, self.gripper = arm, hand, gripper or ""
        self.create_subscription(JointState, "/joint_states", self._joint_states, 10)

    def _joint_states(self, state: JointState) -> None:
        self.positions.update(zip(state.name, state.position, strict=False))
        self.velocities.update(zip(state.name, state.velocity, strict=False))

    def wait_for(self, names: tuple[str, ...], seconds: float = 5.0) -> None:
        """Wait until the position and velocity of every joint is known."""
        end = time.monotonic() + seconds
        while not set(names) <= self.positions.keys() & self.velocities.keys():
            rclpy.spin_once(self, timeout_sec=0.1)
            if time.monotonic() > end:
                missing = sorted(set(names) - (self.positions.keys() & self.velocities.keys()))
                sys.exit(f"/joint_states has no position and velocity of {', '.join(missing)}")

    def wait(self, future: Future, seconds: float) -> None:
        """Wait for a future, in short steps, so that Ctrl-C is noticed."""
        end = time.monotonic() + seconds
        while not future.done():
            rclpy.spin_once(self, timeout_sec=0.05)
            if time.monotonic() > end:
                sys.exit(f"no answer within {seconds:.0f} s")

    def wait_for_servers(self) -> None:
        """Wait until every controller is there: none may move while another one is missing."""
        for name, client in self.clients_of.items():
            if not client.wait_for_server(timeout_sec=5.0):
                sys.exit(f"no action server of {name}")

    def send(self, controller: str, trajectory: Trajectory) -> None:
        """Start a trajectory on a controller."""
        goal = FollowJointTrajectory.Goal(trajectory=message(trajectory, TYPES))
        self._start(controller, goal)

    def _start(self, name: str, goal: object) -> None:
        """Send a goal, and wait until its server has accepted it."""
        self.asked = self.clients_of[name].send_goal_async(goal)
        self.wait(self.asked, LATE)
        if not self.asked.result().accepted:
            sys.exit(f"{name} refused the goal")
        self.running.append(self.asked.result())
        self.asked = None

    def move_gripper(self, position: float, effort: float) -> tuple[bool, bool, float]:
        """Send the gripper to a position, in the unit of its action.

        Returns whether it got there, whether it stalled before, and where it is now.
        """
        goal = GripperCommand.Goal()
        goal.command.position, goal.command.max_effort = position, effort
        self._start(self.gripper, goal)
        future = self.running[-1].get_result_async()
        self.wait(future, GRIPPER_TIME)
        self.running = []
        result = future.result().result
        # Without `allow_stalling`, ros2_control aborts a gripper that holds an object.
        if future.result().status != GoalStatus.STATUS_SUCCEEDED and not result.stalled:
            sys.exit(f"the gripper failed on its way to {position:g}")
        return result.reached_goal, result.stalled, result.position

    def finish(self, seconds: float) -> None:
        """Wait for the running goals, and exit if a controller fails or takes longer."""
        futures = [handle.get_result_async() for handle in self.running]
        end = time.monotonic() + seconds + LATE
        # All of them at once: the arm must not drive on while the hand has failed.
        while False in [succeeded(future) for future in futures]:
            rclpy.spin_once(self, timeout_sec=0.05)
            if time.monotonic() > end:
                sys.exit(f"no answer within {seconds + LATE:.0f} s")
        self.running = []

    def require_at(self, motion: Trajectory, point: int, tolerance: float, what: str) -> None:
        """Exit if a joint is farther than `tolerance` from a point of the motion."""
        self.positions.clear()  # wait for the state of now
        self.wait_for(motion.names)
        joint, off = farthest_from(motion, point, self.positions)
        if off > tolerance:
            sys.exit(f"{joint} is {off:.3f} from {what}")

    def cancel(self) -> None:
        """Cancel the running goals; the controllers hold their positions."""
        cancelled = [handle.cancel_goal_async() for handle in self.running]
        if self.asked is not None:  # sent, and not yet accepted
            rclpy.spin_until_future_complete(self, self.asked, timeout_sec=1.0)
            if self.asked.done() and self.asked.result().accepted:
                cancelled.append(self.asked.result().cancel_goal_async())
        for future in cancelled:
            rclpy.spin_until_future_complete(self, future, timeout_sec=1.0)
        self.running, self.asked = [], None

    def close(self, hand: Hand, joints: tuple[str, ...], squeeze: float) -> None:
        """Close the hand until its fingers stall, then press; exit if no finger moves."""
        way = closing(hand, joints, [self.positions[name] for name in joints])
        self.send(self.hand, way)
        result = self.running[-1].get_result_async()
        began = still_since = time.monotonic()
        moved = False
        while time.monotonic() - began < way.times[-1]:
            rclpy.spin_once(self, timeout_sec=0.05)
            succeeded(result)
            now = time.monotonic()
            moved = moved or farthest_share(way, self.positions) > MOVED
            # Fingers need a moment to begin to move.
            if not moved or now - began < STALLED_FOR or not stalled(hand, self.velocities):
                still_since = now
            elif now - still_since > STALLED_FOR:
                break
        if not moved:
            sys.exit("no finger moved: the hand did not close")
        self.cancel()
        q = [self.positions[name] for name in joints]
        self.send(self.hand, grip(hand, joints, q, squeeze, GRIP_TIME))
        result = self.running[-1].get_result_async()
        began = time.monotonic()
        while time.monotonic() - began < GRIP_TIME:
            rclpy.spin_once(self, timeout_sec=0.05)
            succeeded(result)  # or it runs on: the object is in the way
        self.running = []


def succeeded(future: Future) -> bool:
    """Whether a goal is reached; False while it runs. Exit if its controller failed."""
    if not future.done():
        return False
    status, result = future.result().status, future.result().result
    if result.error_code != FollowJointTrajectory.Result.SUCCESSFUL:
        sys.exit(f"a controller failed: {result.error_string} ({result.error_code})")
    if status != GoalStatus.STATUS_SUCCEEDED:  # cancelled by another: no error
        sys.exit(f"a controller ended with status {status}")
    return True


def positive(text: str) -> float:
    """A number above 0, of the command line."""
    if not 0 < float(text) < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is not above 0")
    return float(text)


def read_options() -> argparse.Namespace:
    """Read the command line, and exit if it is wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("motion", type=Path, help="of rgrasp plan --trajectory")
    parser.add_argument("plan", type=Path, help="plan.h5 of the same run")
    parser.add_argument("robot", type=Path, help="the robot's YAML")
    parser.add_argument("--arm-controller", default="/arm_controller")
    parser.add_argument("--hand-controller", default="/hand_controller")
    parser.add_argument("--gripper", help="a GripperCommand action, in place of --hand-controller")
    parser.add_argument("--gripper-open", type=float, help="position before the grasp")
    parser.add_argument("--gripper-closed", type=float, help="position to close towards")
    parser.add_argument("--gripper-effort", type=float, default=20.0, help="largest effort [N]")
    parser.add_argument("--lift-speed", type=positive, default=0.1, help="fastest joint [rad/s]")
    parser.add_argument("--squeeze", type=float, default=0.1, help="beyond the contact [rad or m]")
    parser.add_argument("--accept-unlikely", action="store_true", help="also below 0.1")
    parser.add_argument(
        "--tolerance", type=positive, default=0.02, help="before each step [rad or m]"
    )
    options = parser.parse_args()
    if not options.squeeze >= 0:
        parser.error("--squeeze needs 0 or more")
    if options.gripper and None in (options.gripper_open, options.gripper_closed):
        parser.error("--gripper needs --gripper-open and --gripper-closed")
    return options


def main() -> None:
    options = read_options()
    motion, lift = read_motion(options.motion), read_lift(options.plan, options.lift_speed)
    arm, hand = read_hand(options.robot)
    others = {*arm, *hand.followers}
    fingers = tuple(name for name in motion.names if name not in others)
    grasp = read_grasp(options.plan)
    if grasp.status != "ok":
        sys.exit(f"{options.plan} holds no grasp: {options.motion} is of another run")
    if apart(motion, grasp) > SAME_PLAN:
        sys.exit(f"{options.plan} is of another run than {options.motion}: it grasps elsewhere")
    if grasp.success < UNLIKELY and not options.accept_unlikely:
        sys.exit(f"the grasp holds with probability {grasp.success:.2f}: see --accept-unlikely")
    for name in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(name, lambda *_: sys.exit("terminated"))
    # rclpy's own handler would shut the context down on Ctrl-C, and no goal could be cancelled.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Executor(options.arm_controller, options.hand_controller, options.gripper)
    checked = motion.of(arm if options.gripper else (*arm, *fingers))
    try:
        start = "the start of the motion: plan again with --start"
        node.require_at(checked, 0, options.tolerance, start)
        node.wait_for_servers()
        if options.gripper:
            opened, *_ = node.move_gripper(options.gripper_open, options.gripper_effort)
            if not opened:
                sys.exit(f"the gripper did not open to {options.gripper_open:g}")
        if not options.gripper:  # first: the arm stays where the hand refuses
            node.send(node.hand, motion.of(fingers))
        node.send(node.arm, motion.of(arm))
        node.finish(motion.times[-1])
        node.require_at(checked, -1, options.tolerance, "the grasp")
        if options.gripper:
            _, stalled_at, now = node.move_gripper(options.gripper_closed, options.gripper_effort)
            # Not every driver tells that it stalled: the Franka Hand's does not.
            way = abs(options.gripper_open - options.gripper_closed)
            if not stalled_at and abs(now - options.gripper_closed) < CLOSED * way:
                sys.exit("the gripper met nothing")
        else:
            node.close(hand, fingers, options.squeeze)
        node.require_at(motion.of(arm), -1, options.tolerance, "the grasp after closing")
        if lift is None:
            print("The plan has no lift: lift by hand, or plan again.")
        else:
            node.send(node.arm, lift.of(arm))
            node.finish(lift.times[-1])
    finally:
        node.cancel()
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
