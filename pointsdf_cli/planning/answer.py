"""Intermediate and final results of the grasp planner."""

from __future__ import annotations

from dataclasses import dataclass

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.io.plans import Plan
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.planning.target import Target


@dataclass(frozen=True)
class PerceivedObject:
    """A perceived object, ready for planning.

    Attributes:
        target: The object as a constraint and a score.
        points: [N, 3], observed points of all views, world, m.
        reconstruction: Reconstruction of the first view; None in partial-view grasping.
        timings: Seconds by stage.
        resampled: Fields completed from `resampled_views` further samples of the points.
        fused: Mean field of all views; None for one view.
    """

    target: Target
    points: Array
    reconstruction: Reconstruction | None
    timings: dict[str, float]
    resampled: tuple[Field, ...] = ()
    fused: Field | None = None


@dataclass(frozen=True)
class Answer:
    """A plan and its inputs.

    Attributes:
        plan: The artifact; its status says whether there is a plan.
        target: The object as a constraint and a score; None without an object.
        reconstruction: Reconstruction of the cloud; None in partial-view grasping, or without an
            object.
    """

    plan: Plan
    target: Target | None
    reconstruction: Reconstruction | None

    @property
    def candidates(self) -> Array:
        """Configurations [C, J] of all accepted grasps, best first."""
        return self.plan.accepted.q
