"""Closing the hand, gripping, lifting, holding: one executor for collection and for trials."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import invert_transform, rotation_vector
from pointsdf_cli.robot.arm_chain import ArmChain
from pointsdf_cli.robot.lift import LIFT_HEIGHT
from pointsdf_cli.simulation.physics import GRAVITY
from pointsdf_cli.simulation.verdict import HOLD, LIFT, PUSHES, UNTRIED, Outcome, Seen, cause_of
from pointsdf_cli.simulation.world import World

SPEED_UP = 8.0
"""Ratio of the closing speed to the real robot's."""
STALL_SPEED = 0.1
"""Fraction of its commanded speed below which a joint has stalled."""
STALL_TIME = 0.05
"""Time below that speed until it counts as stalled [s]."""
LONGEST_CLOSING = 1.5
"""Largest duration of the closing [s]; longer for a slower hand."""
GRIP_TIME = 0.2
"""Time to build up the grip [s]."""
SQUEEZE = 0.1
"""Angle [rad] by which a turning joint may still close after the grip is built up: the torques of
fingers that press without a limit do not balance, and push an object out of the hand."""
LIFT_TIME = 0.8
"""Duration of the lift [s]."""
SETTLE_TIME = 0.5
"""Time to hold still after the lift [s]."""
SHAKE_TIME = 1.0
"""Duration of the shake [s]."""
PUSH_TIME = 1.0
"""Duration of each push [s]."""


@dataclass(frozen=True)
class ExecutorConfig:
    """Execution of a grasp (as the paper's robot does).

    Attributes:
        closing_effort: Fraction of a joint's effort while it closes.
        grip_effort: Fraction of a joint's effort while it holds.
        shake: Amplitude of a lateral shake after the lift [m/s²]; 0 for none.
        hold: Time that a lifted object is then held [s]; 0 for none.
        push: Force on a held object's centre of mass [N], in each direction of `PUSHES` in turn; 0
            for none.
    """

    closing_effort: float = 0.3
    grip_effort: float = 1.0
    shake: float = 0.0
    hold: float = 0.0
    push: float = 0.0

    def __post_init__(self) -> None:
        for name, most, unit in (("shake", 100, "m/s²"), ("hold", 600, "s"), ("push", 1000, "N")):
            value = getattr(self, name)
            if not 0 <= value <= most:
                what, allowed = f"{value:g} {unit}", f"0 to {most} {unit}"
                raise InputError(what, where=f"--{name}", allowed=allowed)


LONGEST_SETTLING = 2.0
"""Largest time to wait for a moving object to rest in the hand or fall [s]."""
LOOK = 1 / 60
"""Interval [s] of checks of the object: speed, whether it is left behind or lost."""
STEADY_SPEED = 0.03
"""Speed [m/s] below which an object rests in the hand."""
OFF_TABLE = -0.05
"""Height [m] of the centre of mass below which an object has fallen off the table."""
CLEAR_HEIGHT = 0.05
"""Height [m] above the grip from which the hand no longer reaches an object left on the table."""
CLEAR_ASIDE = 0.005
"""Lateral distance [m] beyond which a straight rise cannot meet the object."""
PALM_TO_TIP = 0.25
"""Lever arm [m]: motion of the hand's farthest point per radian of the palm's rotation."""


class Executor:
    """Executor of grasps in a world.

    Args:
        world: World with the robot and the object, from `World.reset`.
        config: Times, speeds, efforts.
        watch: Function called after every step, to draw or record.
    """

    def __init__(
        self,
        world: World,
        config: ExecutorConfig,
        watch: Callable[[World, str], None] | None = None,
    ) -> None:
        self._world = world
        self._config = config
        self._watch = watch
        robot = world.robot
        self._arm = np.arange(len(robot.arm_joints))
        self._hand = np.arange(len(robot.arm_joints), len(robot.joint_names))
        self._closing = robot.closing_columns
        self._still = np.setdiff1d(self._hand, self._closing)
        self._turning = self._closing[~robot.slides[self._closing]]
        self._fastest = self._start_height = 0.0
        self._touched, self._gripped = False, np.zeros(3)
        self._look_every = max(1, round(LOOK / world.physics.step))

    def run(self, q: ArrayLike, lift: Array) -> Outcome:
        """Close, grip, lift along a path, settle, shake, hold, push, judge.

        Args:
            q: [J], configuration in which the hand begins to close, that of the world's robot.
            lift: [K, A], arm joints from there to the end of the lift.
        """
        world, config = self._world, self._config
        q = np.asarray(q, dtype=float)
        self._start_height = self._object_height()
        self._fastest = 0.0
        world.joints.drive_to(q, self._arm, world.robot.effort[self._arm])
        world.joints.drive_to(q, self._still, world.robot.effort[self._still])
        self._close()
        self._grip()
        self._touched = world.robot_contact().hand_links > 0
        self._gripped = self._object_in_palm()
        self._lift(lift)
        # An object left on the table is not in the hand to settle or be shaken.
        if not self._left_behind():
            self._settle()
            if config.shake > 0:
                self._shake()
        outcome = self._judged(LIFT)
        if outcome.lifted and config.hold > 0:
            self._hold_test()
            outcome = self._judged(HOLD)
        if config.push > 0:
            lost_in = self._lost_by_pushes() if outcome.held else outcome.lost_in
            outcome = replace(outcome, unshaken=int(not lost_in), lost_in=lost_in)
        return replace(outcome, duration=world.time)

    def _judged(self, step: str) -> Outcome:
        """Verdict on the object where it is now, after the lift or the hold."""
        seen = self._seen()
        cause = cause_of(seen, LIFT_HEIGHT, self._touched)
        held = cause == "held"
        return Outcome(
            lifted=held or step == HOLD,
            held=held,
            unshaken=UNTRIED,
            lost_in="" if held else step,
            valid=cause not in ("flung", "penetration"),
            cause=cause,
            lift_height=seen.rise,
            slip=float(np.linalg.norm(self._object_in_palm() - self._gripped)),
            links=seen.hand_links,
            duration=self._world.time,
        )

    def _seen(self) -> Seen:
        contact = self._world.robot_contact()
        rise = self._object_height() - self._start_height
        on_table = self._world.object_on_table()
        return Seen(rise, contact.hand_links, contact.depth, on_table, self._fastest)

    def _close(self) -> None:
        """Move all closing joints until each has stalled or reached its limit.

        A stalled joint goes on pressing: it moves again when what stopped it gives way, such as
        an object that slides, or a fingertip that slides on the table.
        """
        world, robot = self._world, self._world.robot
        speeds = robot.closing_speeds * SPEED_UP
        efforts = robot.effort[self._closing] * self._config.closing_effort
        # Tolerance at the end of travel: 2% of it, but at most 0.02 (rad for a finger).
        travel = (robot.hard_upper - robot.hard_lower)[self._closing]
        at_end = np.minimum(0.02, 0.02 * travel)
        longest = max(LONGEST_CLOSING, 1.25 * float((travel / np.abs(speeds)).max()))
        slow = np.zeros(len(speeds))
        check = max(1, round(0.0125 / world.physics.step))
        world.joints.drive_at(speeds, self._closing, efforts)
        began = world.time
        self._wait(0.05, "close")  # let the joints get going before judging that they stall
        while (slow < STALL_TIME).any() and world.time - began < longest:
            self._advance(check, "close")
            position, velocity = (values[self._closing] for values in world.joints.state())
            stalled = velocity * np.sign(speeds) < STALL_SPEED * np.abs(speeds)
            stalled |= np.abs(position - robot.closing_ends) < at_end
            slow = np.where(stalled, slow + check * world.physics.step, 0.0)

    def _grip(self) -> None:
        """Press with the full effort of every closing joint, then hold the grip.

        Turning joints hold with targets of position `SQUEEZE` farther in, still with their full
        effort. Sliding jaws go on pressing, as force-controlled grippers do.
        """
        world, config, robot = self._world, self._config, self._world.robot
        speeds = robot.closing_speeds * SPEED_UP * 0.25
        efforts = robot.effort[self._closing] * config.grip_effort
        world.joints.drive_at(speeds, self._closing, efforts)
        self._wait(GRIP_TIME, "grip")
        target, _ = world.joints.state()
        target[self._closing] += np.sign(robot.closing_speeds) * SQUEEZE
        target = np.clip(target, robot.hard_lower, robot.hard_upper)
        efforts = robot.effort[self._turning] * config.grip_effort
        world.joints.drive_to(target, self._turning, efforts)

    def _lift(self, path: Array) -> None:
        """Move the arm along a path in joint space, slowly at both ends.

        The lift ends early once the object is on the table and out of the hand's reach.
        """
        world = self._world
        steps = max(1, round(LIFT_TIME / world.physics.step))
        s = np.arange(1, steps + 1) / steps
        s = s * s * (3 - 2 * s)
        knots = np.linspace(0.0, 1.0, len(path))
        arm = np.stack([np.interp(s, knots, column) for column in path.T], axis=1)
        aside = CLEAR_ASIDE + _sideways(world.chain, path)
        for k, _ in enumerate(world.joints.follow(arm)):
            if k % self._look_every == 0 and self._left_behind():
                risen = s[k] * LIFT_HEIGHT >= CLEAR_HEIGHT
                if risen or (self._at_rest() and not world.rises_into_object(aside)):
                    return
            self._advance(1, "lift")

    def _left_behind(self) -> bool:
        """Whether the object is on the table, untouched by the robot."""
        return self._world.object_on_table() and not self._world.robot_contact().links

    def _at_rest(self) -> bool:
        return self._world.object.speed()[0] < STEADY_SPEED

    def _wait(self, duration: float, phase: str) -> None:
        self._advance(round(duration / self._world.physics.step), phase)

    def _settle(self) -> None:
        """Hold still until the object rests in the hand or has left it."""
        world = self._world
        began = world.time
        self._wait(SETTLE_TIME, "settle")
        while world.time - began < LONGEST_SETTLING:
            if self._at_rest() or not world.robot_contact().links:
                return
            self._wait(0.1, "settle")

    def _shake(self) -> None:
        """Lateral accelerations back and forth, first along x, then along y, at 4 Hz."""
        world, config = self._world, self._config
        for axis in np.eye(3)[:2]:
            steps = round(SHAKE_TIME / 2 / world.physics.step)
            for k in range(steps):
                pull = config.shake * np.sin(2 * np.pi * 4.0 * k * world.physics.step)
                world.set_gravity(pull * axis - [0.0, 0.0, GRAVITY])
                self._advance(1, "shake")
        world.set_gravity([0, 0, -GRAVITY])
        self._wait(0.25, "shake")

    def _hold_test(self) -> None:
        """Hold still for the time of the hold, or until the object has left the hand."""
        steps = round(self._config.hold / self._world.physics.step)
        for begun in range(0, steps, self._look_every):
            if not self._world.robot_contact().links:
                return
            self._advance(min(self._look_every, steps - begun), HOLD)

    def _lost_by_pushes(self) -> str:
        """Push the object in every direction until one takes it out of the hand.

        Returns:
            That one's key in `PUSHES`; empty if none does.
        """
        world, config = self._world, self._config
        steps = round(PUSH_TIME / world.physics.step)
        for name, direction in PUSHES.items():
            for begun in range(0, steps, self._look_every):
                some = min(self._look_every, steps - begun)
                self._advance(some, name, config.push * direction)
                if not world.robot_contact().hand_links:
                    return name
            if cause_of(self._seen(), LIFT_HEIGHT, self._touched) != "held":
                return name
        return ""

    def _advance(self, steps: int, phase: str, force: Array | None = None) -> None:
        world = self._world
        for done in range(1, steps + 1):
            if force is not None:
                world.object.push(force)  # it acts during one step
            world.step()
            # Checked with and without `watch` alike: the checks decide what counts as flung.
            looks = done % self._look_every == 0 or done == steps
            if looks and self._object_height() > OFF_TABLE:
                # Below the table it falls freely.
                self._fastest = max(self._fastest, world.object.speed()[0])
            if self._watch:
                self._watch(world, phase)

    def _object_height(self) -> float:
        return float(self._world.object.centre()[2])

    def _object_in_palm(self) -> Array:
        """The object's centre of mass [3] in the palm's frame."""
        T_palm_world = invert_transform(self._world.palm_pose())
        return T_palm_world[:3, :3] @ self._world.object.centre() + T_palm_world[:3, 3]


def _sideways(chain: ArmChain, path: Array) -> float:
    """Largest sideways deviation [m] of the hand along arm joints [K, A].

    The arm may move farther sideways, but an object that only the arm could meet is lost anyway.
    """
    rotation, position, _ = chain.palm_and_jacobian(path)
    aside = np.linalg.norm(position[:, :2] - position[0, :2], axis=1)
    turn = np.linalg.norm(rotation_vector(rotation @ rotation[0].T), axis=1)
    return float((aside + PALM_TO_TIP * turn).max())
