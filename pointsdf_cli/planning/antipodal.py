"""Antipodal grasps of a reconstructed surface, for hands with jaws.

Two contacts hold an object if the line between them lies in both friction cones (Nguyen,
"Constructing force-closure grasps", 1988). What the success network likes best is seldom aligned
with the surface as well as that, and the prior knows only grasps across a bounding box. So these
grasps are judged beside the solver's solutions, by the predicted success alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from torch import Tensor

from pointsdf_cli.choices import TOP
from pointsdf_cli.geometry.arrays import Array, Surface
from pointsdf_cli.geometry.signed_distance import sample_surface
from pointsdf_cli.planning.grasp_problem import GraspProblem
from pointsdf_cli.planning.objective import ALPHA, BETA, GraspScore
from pointsdf_cli.planning.screen import lowest
from pointsdf_cli.planning.seeds import UnsolvedGrasps
from pointsdf_cli.planning.target import Target, surface_of
from pointsdf_cli.robot.jaws import Jaws

SAMPLES = 2000
"""Points of the surface among which pairs are looked for."""
ASIDE = 0.003
"""Largest distance [m] of the second point from the first one's normal: about the spacing of the
points on a bottle."""
FACING = float(np.cos(np.radians(15.0)))
"""Least cosine between the line of the contacts and the farther normal: half of the friction cone
of a coefficient of 0.6, because reconstructed normals err by about as much."""
THINNEST = 0.002
"""Least distance of two contacts [m]: a surface that folds back onto itself is no object."""
BLOCKS = 10
"""Parts in which pairs are looked for: their matrices stay in the processor's cache."""
TRIES = 8
"""Poses that are drawn for each that is asked for: some are of another kind or in the table."""
UPWARDS = 0.2
"""Largest upward component of an approach."""
DOWNWARDS = 0.7
"""Least downward component of a grasp from the top."""


@dataclass(frozen=True)
class AntipodalPairs:
    """N pairs of opposite points.

    Attributes:
        middle: [N, 3], world, m.
        axis: [N, 3], unit, from one contact to the other.
        width: [N], m.
    """

    middle: Array
    axis: Array
    width: Array


def antipodal_pairs(surface: Surface, widest: float, rng: np.random.Generator) -> AntipodalPairs:
    """Opposite points of a surface whose normals face each other.

    Args:
        surface: Vertices [V, 3] (world, m) and faces [F, 3], counter-clockwise from outside.
        widest: Largest distance of two contacts [m].
        rng: Random generator.
    """
    points, normals = sample_surface(*surface, SAMPLES, rng)
    inward = -normals
    blocks = np.array_split(range(SAMPLES), BLOCKS)
    parts = [_opposite(points, normals, rows, widest) for rows in blocks]
    first, width = (np.concatenate(part) for part in zip(*parts, strict=True))
    return AntipodalPairs(points[first] + inward[first] * width[:, None] / 2, inward[first], width)


def _opposite(points: Array, normals: Array, rows: Array, widest: float) -> tuple[Array, Array]:
    """Index and width of all pairs whose first point is among `rows`."""
    inward = -normals[rows]
    along = inward @ points.T - (inward * points[rows]).sum(axis=1)[:, None]
    between = (along >= THINNEST) & (along <= widest)
    row, second = np.nonzero(between & (inward @ normals.T >= FACING))
    first, width = rows[row], along[row, second]
    aside = ((points[second] - points[first]) ** 2).sum(axis=1) - width**2
    kept = aside <= ASIDE**2
    return first[kept], width[kept]


class AntipodalSampler:
    """Sampler of grasps with open jaws on antipodal pairs, from any side; a `GraspSampler`.

    Args:
        pairs: The pairs.
        jaws: The hand's jaws.
        reach: Along z from the palm's origin to the middle between the jaws [m].
        outline: [P, 3], the open hand's points, palm frame, m.
        floor: Least height of these points [m].
    """

    def __init__(
        self, pairs: AntipodalPairs, jaws: Jaws, reach: float, outline: Array, floor: float
    ) -> None:
        self.pairs, self._jaws, self._reach = pairs, jaws, reach
        self._outline, self._floor = outline, floor

    def sample(self, kind: str, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Preshape joints [N, K] and T_world_palm [N, 4, 4] of at most `count` grasps."""
        palms = self._palms(TRIES * count, rng)
        from_top = palms[:, 2, 0] < -DOWNWARDS
        palms = palms[from_top == (kind == TOP)]
        palms = palms[lowest(self._outline[None], palms) >= self._floor][:count]
        return np.tile(self._jaws.preshape, (len(palms), 1)), palms

    def _palms(self, count: int, rng: np.random.Generator) -> Array:
        pairs, jaws = self.pairs, self._jaws
        if not len(pairs.width):
            return np.zeros((0, 4, 4))
        chosen = rng.integers(len(pairs.width), size=count)
        z = pairs.axis[chosen]
        z = z * np.where(z @ jaws.home_z < 0, -1.0, 1.0)[:, None]
        one = np.cross(z, np.eye(3)[np.abs(z).argmin(axis=1)])
        one /= np.linalg.norm(one, axis=1, keepdims=True)
        turn = rng.uniform(0, 2 * np.pi, count)[:, None]
        x = np.cos(turn) * one + np.sin(turn) * np.cross(z, one)
        x = np.where(x[:, 2:] > UPWARDS, -x, x)
        depth = rng.uniform(*jaws.pads, count)[:, None]
        palms = np.tile(np.eye(4), (count, 1, 1))
        palms[:, :3, :3] = np.stack([x, np.cross(z, x), z], axis=2)
        palms[:, :3, 3] = pairs.middle[chosen] - depth * x - self._reach * z
        return palms


class SuccessAlone:
    """A score whose prior is constant: the cost is zero where h exceeds `good`.

    Args:
        score: Score of the same object.
        good: Success probability that is good enough.
    """

    def __init__(self, score: GraspScore, good: float) -> None:
        self._score = score
        self._log_prior = float(-np.log(good) - BETA) / ALPHA

    def log_success(self, preshape: Tensor, T_world_palm: Tensor) -> Tensor:
        """log h [B]."""
        return self._score.log_success(preshape, T_world_palm)

    def log_prior(self, preshape: Tensor, T_world_palm: Tensor) -> Tensor:
        """The constant [B]."""
        return T_world_palm.new_full((len(T_world_palm),), self._log_prior)


def antipodal_grasps(
    target: Target, problem: GraspProblem, good: float, rng: np.random.Generator
) -> list[UnsolvedGrasps]:
    """Antipodal grasps of an object; none for a hand without jaws, or without a surface.

    Args:
        target: The object.
        problem: Problem whose clearances they must meet.
        good: Success probability that is good enough.
        rng: Random generator of the pairs.
    """
    hand, robot = problem.geometry.hand, problem.kinematics.robot
    surface = None if hand.jaws is None else surface_of(target)
    if hand.jaws is None or surface is None:
        return []
    widest = hand.jaws.opening - 2 * problem.clearances.object
    pairs = antipodal_pairs(surface, widest, rng)
    outline = hand(hand.jaws.preshape[None])[0]
    floor = problem.lowest if problem.environment.table else -np.inf
    sampler = AntipodalSampler(pairs, hand.jaws, robot.palm_reach or 0.0, outline, floor)
    return [UnsolvedGrasps(sampler, SuccessAlone(target.score, good))]
