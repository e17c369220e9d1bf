"""Sample points for signed distances around a mesh (docs/method.md, "Reconstruction")."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.signed_distance import SignedDistance, sample_surface
from pointsdf_cli.geometry.volume import enclosed_volume

MARGIN = 1.03
"""Margin factor of the unit box over the object scaled into it (docs/method.md, "object frame")."""


WIDE_VARIANCE, NEAR_VARIANCE = 0.0025, 0.00025
"""Variances of the Gaussian jitter on surface points."""
BOX = 0.6
"""Uniform points lie in ±box about the centre of the bounding box."""


@dataclass(frozen=True)
class SamplingConfig:
    """Numbers and places of a mesh's labelled points.

    The lengths are in units of the mesh scaled so that its longest side is 1/1.03.

    Attributes:
        points: All of them together.
        wide_share, near_share: Fractions of the points; the rest is uniform.

    Raises:
        InputError: A value is out of its range.
    """

    points: int = 50_000
    wide_share: float = 0.4
    near_share: float = 0.4

    def __post_init__(self) -> None:
        if not 100 <= self.points <= 50_000_000:
            what = f"{self.points} points a mesh"
            raise InputError(what, where="--points", allowed="100 to 50000000")
        shares = (self.wide_share, self.near_share, 1 - self.wide_share - self.near_share)
        if min(shares) < -1e-9:
            raise InputError(f"shares of {shares}", where="sampling", allowed="three that sum to 1")


@dataclass(frozen=True)
class SdfSamples:
    """Labelled points of one mesh.

    Attributes:
        points: f4 [N, 3], mesh frame, the mesh's unit.
        sdf: f4 [N], negative inside.
        inside_fraction: Share of all points inside.
        uniform_inside: Fraction of the uniform points alone.
        expected_inside: The same by the mesh's volume (divergence theorem).
    """

    points: NDArray[np.float32]
    sdf: NDArray[np.float32]
    inside_fraction: float
    uniform_inside: float
    expected_inside: float


def sample_sdf(
    vertices: Array, faces: NDArray[np.int32], config: SamplingConfig, rng: np.random.Generator
) -> SdfSamples:
    """Points around a closed mesh with exact signed distances.

    Raises:
        InputError: The share of points found inside contradicts the volume that the surface
            encloses, so the signs mean nothing.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre, unit = (low + high) / 2, MARGIN * float((high - low).max())
    wide = round(config.points * config.wide_share)
    near = min(round(config.points * config.near_share), config.points - wide)
    uniform = config.points - wide - near
    points = np.empty((config.points, 3), dtype=np.float32)
    start = 0
    for count, variance in ((wide, WIDE_VARIANCE), (near, NEAR_VARIANCE)):
        surface, _ = sample_surface(vertices, faces, count, rng)
        jitter = rng.standard_normal((count, 3), dtype=np.float32)
        points[start : start + count] = surface + np.float32(unit * np.sqrt(variance)) * jitter
        start += count
    points[start:] = centre + unit * rng.uniform(-BOX, BOX, (uniform, 3))
    sdf = SignedDistance(vertices, faces, threads=1)(points)
    samples = SdfSamples(
        points=points,
        sdf=sdf,
        inside_fraction=float((sdf < 0).mean()),
        uniform_inside=float((sdf[wide + near :] < 0).mean()) if uniform else 0.0,
        expected_inside=enclosed_volume(vertices, faces) / (2 * BOX * unit) ** 3,
    )
    _refuse_nonsense(samples, uniform)
    return samples


def _refuse_nonsense(samples: SdfSamples, uniform: int) -> None:
    expected = samples.expected_inside
    # Six standard deviations of a binomial share, and a little for rounding.
    slack = 6 * np.sqrt(max(expected, 1 / max(uniform, 1)) / max(uniform, 1)) + 1e-3
    if not 0 < expected < 1 or (uniform and abs(samples.uniform_inside - expected) > slack):
        raise InputError(
            f"{samples.uniform_inside:.1%} of space is inside by the signs, {expected:.1%} by the "
            "volume: its surface crosses itself, so inside and outside mean nothing",
            allowed="a closed surface that does not cross itself",
            hint="mend it in a mesh editor, or leave it out",
        )
