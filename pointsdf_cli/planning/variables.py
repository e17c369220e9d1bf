"""Variables of planning: arm and preshape joints (7 + 8 for the LBR4 with Allegro).

The hand's other joints rest.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.robot.description import RobotDescription


class Variables:
    """Map between decision variables x [..., n] and configurations q [..., J].

    Attributes:
        columns: [n], index of each variable in q: the arm's joints, then the preshape's.
        lower, upper: [n], q_min ≤ q ≤ q_max of the paper.
        arm_count: Number of the arm's variables.
    """

    def __init__(self, robot: RobotDescription) -> None:
        arm = np.arange(len(robot.joint_names))[robot.arm]
        self.columns = np.concatenate([arm, robot.preshape_columns])
        self.arm_count = len(arm)
        self.lower: Array = robot.lower[self.columns]
        self.upper: Array = robot.upper[self.columns]
        rest = robot.configuration(np.zeros(len(arm)), np.zeros(len(robot.preshape_columns)))
        rest[self.columns] = 0.0
        self._rest = rest
        spread = np.zeros((len(self.columns), len(rest)))
        spread[np.arange(len(self.columns)), self.columns] = 1.0
        self._spread = torch.from_numpy(spread)

    @property
    def count(self) -> int:
        """Number of variables, n."""
        return len(self.columns)

    def configuration(self, x: Array) -> Array:
        """Configurations q [..., J] of variables x [..., n]."""
        q = np.broadcast_to(self._rest, (*x.shape[:-1], len(self._rest))).copy()
        q[..., self.columns] = x
        return q

    def configuration_tensor(self, x: Tensor) -> Tensor:
        """Configurations q [..., J] of variables x [..., n], with gradients."""
        return x @ self._spread.to(x.dtype) + torch.as_tensor(self._rest, dtype=x.dtype)

    def of(self, q: Array) -> Array:
        """Variables x [..., n] of configurations q [..., J]; maps derivatives likewise."""
        return np.ascontiguousarray(q[..., self.columns])

    def preshape(self, x: Tensor) -> Tensor:
        """The hand's part [..., K] of x."""
        return x[..., self.arm_count :]
