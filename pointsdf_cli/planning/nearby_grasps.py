"""Grasps beside the best ones so far: a local random search, round by round.

What is beside the best is more likely to hold than what the prior draws anew.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.planning.acceptance import Candidate
from pointsdf_cli.robot.arm_chain import ArmChain

SHIFT = 0.01
"""Standard deviation of the palm's position along each axis [m]."""
TURN = 0.15
"""Standard deviation of its rotation about each axis [rad]."""
SPREAD = 0.1
"""Standard deviation of preshape joints, over their ranges."""


class NearbySampler:
    """Sampler of grasps beside the best ones; a `GraspSampler`.

    Args:
        best: The best grasps so far, to sample around; without any, no samples are drawn.
        chain: Kinematics of the arm.
    """

    def __init__(self, best: list[Candidate], chain: ArmChain) -> None:
        self._best, self._chain = best, chain

    def sample(self, kind: str, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Preshape joints [N, K] and T_world_palm [N, 4, 4] of `count` grasps beside those of this
        kind."""
        robot = self._chain.robot
        best = [candidate.q for candidate in self._best if candidate.kind == kind]
        if not best:
            return np.zeros((0, len(robot.preshape_joints))), np.zeros((0, 4, 4))
        q = np.stack(best)[rng.integers(len(best), size=count)]
        low, high = robot.preshape_ranges.T
        preshape = q[:, robot.preshape_columns]
        preshape = preshape + SPREAD * (high - low) * rng.standard_normal(preshape.shape)
        palms = self._chain.palm(q)
        turn = Rotation.from_rotvec(TURN * rng.standard_normal((count, 3))).as_matrix()
        palms[:, :3, :3] = turn @ palms[:, :3, :3]
        palms[:, :3, 3] += SHIFT * rng.standard_normal((count, 3))
        return np.clip(preshape, low, high), palms
