"""Intermediate and final results of the grasp planner."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

from pointsdf_cli.geometry.arrays import Array, Surface
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.io.plans import Plan
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.planning.acceptance import Candidate
from pointsdf_cli.planning.target import Target, surface_of

if TYPE_CHECKING:
    from pointsdf_cli.simulation.rehearsal import Rehearsed


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


class Choice(Protocol):
    """Choice among the accepted grasps of one object (likeliest.py, rehearsed.py).

    Attributes:
        surface: The surface on which grasps were rehearsed; None without rehearsals.
        timings: Seconds by stage so far.
    """

    @property
    def surface(self) -> Surface | None: ...

    @property
    def timings(self) -> dict[str, float]: ...

    def stop(self, new: list[Candidate]) -> bool:
        """Whether the candidates of a round end the search."""

    def best(self) -> list[Candidate]:
        """The grasps beside which the next round samples too."""

    def ranked(self, accepted: list[Candidate]) -> list[Candidate]:
        """The candidates to search motions for, in this order."""

    def of(self, chosen: Candidate | None) -> Rehearsed | None:
        """Rehearsal of the chosen candidate; None without one."""


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
        rehearsed: Rehearsal of the chosen grasp; None without one.
        surface: Surface on which grasps were rehearsed; None without rehearsals.
    """

    plan: Plan
    target: Target | None
    reconstruction: Reconstruction | None
    rehearsed: Rehearsed | None = None
    surface: Surface | None = None

    @property
    def candidates(self) -> Array:
        """Configurations [C, J] of the best accepted grasps, best first."""
        return self.plan.accepted.q
