"""Plausibility of a robot's description beyond the syntax of its files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import scipy
import trimesh

from pointsdf_cli.robot.closing import NEARER, Closing, closing_of, open_hand
from pointsdf_cli.robot.collision import SelfCollision, table_clearance
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.inverse_kinematics import IkConfig, InverseKinematics
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.robot.mimic import followers_of
from pointsdf_cli.robot.surface import SPACING, clear_of, link_surface
from pointsdf_cli.robot.urdf import MOVING, Joint

ERROR, WARNING = "error", "warning"
SLACK = 1e-3
"""Limits of a follower may be narrower than its leader's by this much [rad or m]."""
FINE = 0.0025
"""Spacing of surface points of links at home [m]; edges that cross slip between coarser ones."""
POSES, ANYWHERE = 60, 24
"""Number of palm poses for inverse kinematics, and of configurations to check."""


@dataclass(frozen=True)
class Finding:
    """Problem of a description, certain or possible.

    Attributes:
        level: "error" stops planning or makes it meaningless; "warning" may be meant.
        what: One sentence.
        fix: Change to make in the YAML.
    """

    level: str
    what: str
    fix: str


@dataclass(frozen=True)
class RobotCheck:
    """Findings and measurements.

    Attributes:
        findings: Errors first.
        closing: Closing motion of the hand.
        samples: Surface samples of all links.
        farthest: The farthest that any point of a link's surface was found from them [m].
        reached: Share of random palm poses, taken from within the limits, that inverse kinematics
            solves.
        self_distance, table_distance: Least at home with the hand open [m].
    """

    findings: tuple[Finding, ...]
    closing: Closing = field(repr=False)
    samples: int
    farthest: float
    reached: float
    self_distance: float
    table_distance: float

    @property
    def passed(self) -> bool:
        """Whether there are no errors."""
        return all(finding.level != ERROR for finding in self.findings)


def check_robot(robot: RobotDescription, seed: int = 0) -> RobotCheck:
    """Check everything about a robot that grasping needs."""
    rng = np.random.default_rng(seed)
    kinematics = Kinematics(robot)
    closing = closing_of(robot)
    samples, farthest = _coverage(robot, rng)
    self_distance, own = _self_collisions(robot, kinematics, rng)
    table_distance, table = _table(robot, kinematics)
    carried = _carried(robot)  # inverse kinematics refuses any other arm
    reached = _reached(robot, kinematics, rng) if carried else 0.0
    findings = [*_closes(robot, closing), *_coupled(robot), *own, *table, *_joints(robot)]
    findings += _left_home(robot)
    if farthest > SPACING:
        what = f"a surface point is {farthest * 1e3:.1f} mm from any sample"
        findings.append(Finding(ERROR, what, "report it"))
    if carried and reached < 0.9:
        what = f"inverse kinematics solves {reached:.0%} of palm poses that the arm can take"
        fix = "check `arm_joints`: all joints of the arm, and none that does not move the palm"
        findings.append(Finding(WARNING, what, fix))
    findings.sort(key=lambda finding: finding.level != ERROR)
    return RobotCheck(
        tuple(findings), closing, samples, farthest, reached, self_distance, table_distance
    )


def _closes(robot: RobotDescription, closing: Closing) -> Iterator[Finding]:
    """Check that the fingers close towards the space in front of the palm."""
    for joint, nearer in closing.nearer.items():
        if nearer < NEARER:
            speed = float(robot.closing_speeds[robot.closing_joints.index(joint)])
            yield Finding(
                ERROR,
                f"{joint} brings no fingertip nearer to the palm's axis when it closes",
                f"closing_joints: {{{joint}: {-speed:g}}}, if it opens instead; or turn the "
                "palm frame so that x points from the palm to where the fingers meet",
            )
    x = float(closing.middle[0])
    if x <= 0:
        yield Finding(
            ERROR,
            f"the fingertips are behind the palm frame (at x = {x:.3f} m on average)",
            "palm: x must point out of the palm, to where the fingers close",
        )
    if not _carried(robot):
        fix = "arm_joints must lead from the base to the palm"
        yield Finding(ERROR, "an arm joint does not move the palm", fix)


def _coupled(robot: RobotDescription) -> Iterator[Finding]:
    """Check that followers (`<mimic>`) close as their leaders do, and can go where these go."""
    names = robot.joint_names
    speeds = dict(zip(robot.closing_joints, map(float, robot.closing_speeds), strict=True))
    for column, leader, ratio in robot.followers:
        name, first = names[column], names[leader]
        leads, own = speeds.get(first), speeds.get(name)
        says = f"{name} follows {first} (<mimic>, multiplier {ratio:g})"
        if leads is not None and (own is None or own * leads * ratio < 0):
            what = f"{says} but does not close as it does"
            yield Finding(ERROR, what, f"closing_joints: {{{name}: {ratio * leads:g}}}")
        elif own is not None and leads is None:
            what = f"{says}, which does not close"
            yield Finding(ERROR, what, f"closing_joints: {{{first}: {own / ratio:g}}}")
        low, high = sorted(
            ratio * float(one[leader]) + 0.0 for one in (robot.hard_lower, robot.hard_upper)
        )
        least, most = float(robot.hard_lower[column]), float(robot.hard_upper[column])
        if low < least - SLACK or high > most + SLACK:
            what = f"{says} from {low:g} to {high:g}, beyond its limits {least:g} to {most:g}"
            fix = f'<limit lower="{low:g}" upper="{high:g}"> of {name} in the URDF, or its <mimic>'
            yield Finding(ERROR, what, fix)
        if name in robot.preshape_joints and first not in robot.preshape_joints:
            what = f"{says}, which is not in preshape_joints"
            yield Finding(ERROR, what, f"name {first} in preshape_joints, too")
    for joint, first, ratio in _left_out(robot):
        what = f"{joint.name} follows {first} (<mimic>, multiplier {ratio:g}) and is left out"
        fix = f"name {joint.name} in hand_joints"
        if first in speeds:
            fix += f", and closing_joints: {{{joint.name}: {ratio * speeds[first]:g}}}"
        yield Finding(ERROR, what, fix)
    led = {names[column] for column, *_ in robot.followers}
    for joint in robot.joints:
        if joint.mimic and joint.name in speeds and joint.name not in led:
            what = f"{joint.name} follows {joint.mimic[0]} (<mimic>), which is kept at 0"
            fix = f"name {joint.mimic[0]} in hand_joints and in closing_joints, too"
            yield Finding(ERROR, what, fix)


def _left_out(robot: RobotDescription) -> list[tuple[Joint, str, float]]:
    """Joints that are not the robot's but follow one that is, with its name and the ratio."""
    names = robot.joint_names
    moving = [joint for joint in robot.tree.joints if joint.kind in MOVING]
    others = tuple(joint.name for joint in moving if joint.name not in names)
    by_name = {joint.name: joint for joint in moving}
    every = (*names, *others)
    return [
        (by_name[every[column]], every[leader], ratio)
        for column, leader, ratio in followers_of(robot.tree, every)
        if column >= len(names) > leader
    ]


def _left_home(robot: RobotDescription) -> list[Finding]:
    """Hand joints that grasps keep at rest, although home has them elsewhere."""
    used = robot.configuration(robot.home[robot.arm], robot.home[robot.preshape_columns])
    return [
        Finding(
            WARNING,
            f"{robot.joint_names[j]}: {robot.home[j]:.3g} at home, but {used[j]:.3g} in grasps",
            "name it in preshape_joints, or give the same value in home",
        )
        for j in np.flatnonzero(np.abs(used - robot.home) > 1e-3)
    ]


def _carried(robot: RobotDescription) -> bool:
    """Whether every arm joint lies on the way from the root to the palm."""
    way = robot.tree.joints_to_root(robot.palm_link)
    return set(robot.arm_joints) <= {joint.name for joint in way}


def _self_collisions(
    robot: RobotDescription, kinematics: Kinematics, rng: np.random.Generator
) -> tuple[float, list[Finding]]:
    """At home, and pairs of links that touch whatever the robot does."""
    fine, coarse = SelfCollision(kinematics, FINE), SelfCollision(kinematics, 0.03, 0.0)
    if not fine.pairs:
        return float("inf"), []
    q = robot.follow(rng.uniform(robot.lower, robot.upper, (ANYWHERE, len(robot.lower))))
    distance = fine(*kinematics(np.stack([robot.home, open_hand(robot)]))).numpy()
    anywhere = coarse(*kinematics(q)).numpy() < 0
    found = []
    for k, (a, b) in enumerate(fine.pairs):
        share = float(anywhere[:, k].mean())
        if distance[:, k].min() < 0:
            where = "at home" if distance[0, k] < 0 else "at home with the hand open"
            what = f"{a} and {b} overlap by {-distance[:, k].min() * 1e3:.1f} mm {where}"
            fix = (
                f"may_touch: [[{a}, {b}]], if their shapes merely overlap; otherwise another "
                "`home` (it may also give the hand's joints, after the arm's)"
            )
            found.append(Finding(ERROR, what, fix))
        elif share > 0.95:
            what = f"{a} and {b} overlap in {share:.0%} of random configurations"
            fix = f"may_touch: [[{a}, {b}]], if they cannot be kept apart"
            found.append(Finding(WARNING, what, fix))
    return float(distance.min()), found


def _table(robot: RobotDescription, kinematics: Kinematics) -> tuple[float, list[Finding]]:
    q = np.stack([robot.home, open_hand(robot)])
    links, height = table_clearance(robot, *kinematics(q))
    least = height.amin(dim=0).numpy()
    found = [
        Finding(
            ERROR,
            f"{link} reaches {-value * 1e3:.1f} mm below the table at home",
            f"links_on_table: [{link}], if it stands there; otherwise `mount` or `home`",
        )
        for link, value in zip(links, least, strict=True)
        if value < 0
    ]
    return float(least.min()) if len(least) else np.inf, found


def _joints(robot: RobotDescription) -> Iterator[Finding]:
    known = {*robot.joint_names, *(joint.name for joint, *_ in _left_out(robot))}
    left = [j for j in robot.tree.joints if j.kind in MOVING and j.name not in known]
    for joint in left:
        if not joint.lower <= 0 <= joint.upper:
            what = f"{joint.name} would be kept at 0, beyond {joint.lower:g} to {joint.upper:g}"
            fix = "list it among arm_joints or hand_joints, or make it fixed in the URDF"
            yield Finding(ERROR, what, fix)
    if left:
        what = f"{', '.join(joint.name for joint in left)} can move and will be kept at 0"
        fix = "list them among arm_joints or hand_joints if they are to move"
        yield Finding(WARNING, what, fix)
    too_fast = np.abs(robot.closing_speeds) > robot.velocity[robot.closing_columns]
    if too_fast.any():
        fast = [robot.closing_joints[k] for k in np.flatnonzero(too_fast)]
        what = f"{', '.join(fast)} would close faster than the URDF's velocity limit"
        yield Finding(WARNING, what, "smaller numbers in closing_joints")
    for joint in robot.joints:
        if joint.kind == "revolute" and joint.upper - joint.lower > 4 * np.pi + 0.01:
            what = f"{joint.name} turns by more than two turns: {joint.lower:g} to {joint.upper:g}"
            yield Finding(WARNING, what, "rad in the URDF's <limit>; are these degrees?")
    if robot.tree.without_mass:
        yield Finding(
            WARNING,
            f"{', '.join(robot.tree.without_mass)}: no <inertial> in the URDF; the simulator "
            "takes their shapes to weigh as much as water",
            "give those links their <inertial>; a hand's decides how its fingers close",
        )


def _coverage(robot: RobotDescription, rng: np.random.Generator) -> tuple[int, float]:
    """Number of surface samples, and how far random surface points are from them at most [m]."""
    count, farthest = 0, 0.0
    for shapes in robot.tree.shapes.values():
        if not shapes:
            continue
        points = link_surface(shapes)
        count += len(points)
        tree = scipy.spatial.cKDTree(points)
        for i, shape in enumerate(shapes):
            seed = int(rng.integers(2**31))
            drawn, _ = trimesh.sample.sample_surface(shape.as_mesh(), 500, seed=seed)
            # What lies inside another shape is no surface of the link.
            drawn = drawn[clear_of(np.array(drawn), [*shapes[:i], *shapes[i + 1 :]], 0.0)]
            if len(drawn):
                farthest = max(farthest, float(tree.query(drawn)[0].max()))
    return count, farthest


def _reached(robot: RobotDescription, kinematics: Kinematics, rng: np.random.Generator) -> float:
    q = rng.uniform(robot.lower, robot.upper, (POSES, len(robot.lower)))
    solver = InverseKinematics(robot, IkConfig(pool=4000))
    return float(solver.solve(kinematics.palm(q).numpy()).any.mean())
