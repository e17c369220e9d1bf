"""Axial noise of a structured-light depth camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError

REFERENCE_DEPTH = 1.5
"""Depth [m] of the stated standard deviation."""


@dataclass(frozen=True)
class DepthNoise:
    """Gaussian noise along the ray's z; its deviation grows with the square of the depth.

    A camera that triangulates measures disparity d = f·b/z with an error that does not depend on
    z, so σ_z = z²/(f·b)·σ_d (Khoshelham and Elberink 2012, "Accuracy and resolution of Kinect
    depth data", eq. 4). `sigma` fixes the factor: the paper's 1 mm at 1.5 m.

    Attributes:
        sigma: Standard deviation at `REFERENCE_DEPTH` [m].
    """

    sigma: float = 0.001

    def __post_init__(self) -> None:
        if not 0 <= self.sigma <= 0.1:
            what = f"a noise of {self.sigma} m at {REFERENCE_DEPTH} m"
            raise InputError(what, where="--noise", allowed="0 to 0.1 m")

    def deviation(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """Standard deviation [m] at each depth [m]."""
        return depth * depth * np.float32(self.sigma / REFERENCE_DEPTH**2)

    def apply(self, depth: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
        """Depths [m], of any shape, with noise added, drawn in the order of the pixels."""
        noise = rng.standard_normal(depth.shape, dtype=np.float32)
        return depth + self.deviation(depth) * noise
