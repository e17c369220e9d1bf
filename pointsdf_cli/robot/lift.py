"""Lift of a grasped object: upwards, straight if possible, and level if possible.

Near the robot an arm folds as the hand rises, until its elbow is at its limit. Then the hand must
move outwards while it rises, or turn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.robot.arm_chain import ArmChain
from pointsdf_cli.robot.cartesian_path import FollowConfig, follow, straight

LIFT_HEIGHT = 0.15
"""Height [m] of every lift, planned and executed: an object is then clear of what is beside it."""
STEPS = 15
"""Number of steps of the path."""
WAYS = ((0.0, 1.0), (0.05, 1.0), (0.1, 1.0), (0.0, 0.1), (0.05, 0.02), (0.1, 0.02))
"""Attempts in turn: outward motion of the palm on the way [m], and cost of a rotation by 1 rad in
metres off the line; at 1 the palm does not rotate."""
FOLLOW = FollowConfig(0.003, 0.005, jump=0.3, iterations=12, settled=1e-5, longest=0.15)
"""Least squares until they settle: the line is left by up to 3 mm, or by a turn, where it must."""
MOST_TURN = 0.6
"""Largest turn [rad] of the palm on the way; more pours out the contents of the object."""


def lift_path(
    chain: ArmChain,
    q: Array,
    height: float = LIFT_HEIGHT,
    free: Callable[[Array], bool] | None = None,
) -> Array | None:
    """Arm joints [K + 1, A] from configuration q [J] to one with the palm `height` [m] above.

    Args:
        chain: Chain of the arm.
        q: [J], start configuration.
        height: Height of the lift [m].
        free: Function that tells whether a path [K + 1, A] is free of collision; None for no check.

    Returns:
        None if no attempt succeeds.
    """
    arm, T_world_palm = q[None, chain.robot.arm], chain.palm(q)
    away = T_world_palm[:3, 3] - chain.robot.T_world_base[:3, 3]
    away[2] = 0.0
    away /= max(float(np.linalg.norm(away)), 1e-6)
    for outwards, weight in WAYS:
        poses = straight(T_world_palm, [outwards * away + [0.0, 0.0, height]], STEPS)
        config = replace(FOLLOW, turn_weight=weight, rotation=0.005 if weight == 1 else MOST_TURN)
        (path,), (reached,) = follow(chain, arm, poses, config)
        if reached == STEPS and (free is None or free(path)):
            return path
    return None
