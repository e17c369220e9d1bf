"""Intermediate and final results of the grasp planner."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from pointsdf_cli.geometry.arrays import Array, Surface
from pointsdf_cli.io.plans import Plan
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.planning.target import Target, surface_of


@dataclass(frozen=True)
class PlanNotes:
    """Content of a plan that the search does not know.

    Attributes:
        warnings: Sentences about implausible input, appended to the plan's sentence.
        timings: Seconds by further stage; read after the search.
        surface: Whether the plan holds the object's surface.
    """

    warnings: Sequence[str] = ()
    timings: Mapping[str, float] = field(default_factory=dict)
    surface: bool = False


NO_NOTES = PlanNotes()


@dataclass(frozen=True)
class PerceivedObject:
    """A perceived object, ready for planning.

    Attributes:
        target: The object as a constraint and a score.
        points: [N, 3], observed points of all views, world, m.
        reconstruction: Reconstruction of the first view; None in partial-view grasping.
        timings: Seconds by stage.
    """

    target: Target
    points: Array
    reconstruction: Reconstruction | None
    timings: dict[str, float]

    def surface(self) -> Surface | None:
        """The object's surface, world frame; None without one."""
        return surface_of(self.target)


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
        """Configurations [C, J] of the best accepted grasps, best first."""
        return self.plan.accepted.q
