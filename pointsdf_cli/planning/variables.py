"""Variables of planning: arm and preshape joints (7 + 8 for the LBR4 with Allegro).

The hand's other joints rest; a joint that follows another (`<mimic>`) has no variable of its own.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.robot.description import RobotDescription


class Variables:
    """Map between decision variables x [..., n] and configurations q [..., J].

    Attributes:
        columns: [n], index of each variable in q: the arm's joints, then the preshape's.
        lower, upper: [n], q_min ≤ q ≤ q_max of the paper, for followers too.
        of_preshape: Indices of the preshape joints [K] that have a variable.
    """

    def __init__(self, robot: RobotDescription) -> None:
        arm = np.arange(len(robot.joint_names))[robot.arm]
        followers = {column: rest for column, *rest in robot.followers}
        free = [k for k, column in enumerate(robot.preshape_columns) if column not in followers]
        self.of_preshape = np.array(free, dtype=np.int64)
        self.columns = np.concatenate([arm, robot.preshape_columns[self.of_preshape]])
        self.lower: Array = robot.lower[self.columns]
        self.upper: Array = robot.upper[self.columns]
        self._rest = robot.configuration(np.zeros(len(arm)), np.zeros(len(robot.preshape_columns)))
        self._rest[self.columns] = 0.0
        self._spread = np.zeros((len(self.columns), len(self._rest)))
        self._spread[np.arange(len(self.columns)), self.columns] = 1.0
        for column, leader, ratio in robot.followers:
            if leader in self.columns:
                k = int(np.flatnonzero(self.columns == leader)[0])
                self._rest[column], self._spread[k, column] = 0.0, ratio
                ends = sorted((robot.lower[column] / ratio, robot.upper[column] / ratio))
                self.lower[k] = max(self.lower[k], ends[0])
                self.upper[k] = min(self.upper[k], ends[1])
        self._preshape, self._coupled = robot.preshape_columns, bool(robot.followers)
        self._arm_count = len(arm)

    @property
    def count(self) -> int:
        """Number of variables, n."""
        return len(self.columns)

    @property
    def driven(self) -> NDArray[np.bool_]:
        """Mask [J] of the joints that the variables move, followers included."""
        return (self._spread != 0).any(axis=0)

    def configuration(self, x: Array) -> Array:
        """Configurations q [..., J] of variables x [..., n]."""
        return np.asarray(x @ self._spread + self._rest)

    def configuration_tensor(self, x: Tensor) -> Tensor:
        """Configurations q [..., J] of variables x [..., n], with gradients."""
        spread, rest = (torch.as_tensor(one, dtype=x.dtype) for one in (self._spread, self._rest))
        return x @ spread + rest

    def of(self, q: Array) -> Array:
        """Variables x [..., n] of configurations q [..., J]."""
        return np.ascontiguousarray(q[..., self.columns])

    def derivatives(self, by_q: Array) -> Array:
        """Derivatives [..., n] by x of what has derivatives [..., J] by q."""
        if not self._coupled:
            return self.of(by_q)
        return np.ascontiguousarray(by_q @ self._spread.T)

    def preshape(self, x: Tensor) -> Tensor:
        """Preshape joints [..., K] of variables x [..., n], with gradients."""
        return self.configuration_tensor(x)[..., self._preshape]

    def coupled(self, preshape: Array) -> Array:
        """Preshapes [..., K] whose followers take the place that their leader gives them."""
        x = np.zeros((*preshape.shape[:-1], self.count))
        x[..., self._arm_count :] = preshape[..., self.of_preshape]
        return self.configuration(x)[..., self._preshape]
