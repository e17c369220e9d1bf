"""Request to a planner and its result in plain data, as `plan` and `serve` exchange them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from pointsdf_cli import choices
from pointsdf_cli.choices import require_choice
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.io.clouds import Cloud, check_object_cloud, check_scene_cloud
from pointsdf_cli.io.plans import Plan
from pointsdf_cli.planning import option_checks
from pointsdf_cli.planning.cloud_checks import require_pose
from pointsdf_cli.planning.environment import Environment, Obstacle
from pointsdf_cli.planning.object_choice import TargetChoice

if TYPE_CHECKING:
    from pointsdf_cli.planning.acceptance import AcceptanceConfig

Corners = tuple[tuple[float, ...], tuple[float, ...]]


@dataclass(frozen=True)
class PlanChoices:
    """Options of the search, apart from the robot and the networks.

    Attributes:
        method, solver, kind: As in `PlanOptions`.
        clearance: Least distance to everything [m]; the default ones if None.
        margin: Preferred distance to the object [m].
        speed: Share of the joints' speed limits that the motion uses.
        min_success: Least predicted probability; the default thresholds if None.

    Raises:
        InputError: A name is unknown, or a number out of range.
    """

    method: str = option_checks.RECONSTRUCTION
    solver: str = "sqp"
    kind: str = "auto"
    clearance: float | None = None
    margin: float = option_checks.MARGIN
    speed: float = option_checks.SPEED
    min_success: float | None = None

    def __post_init__(self) -> None:
        require_choice(self.method, choices.Method, "--method")
        require_choice(self.solver, choices.Solver, "--solver")
        require_choice(self.kind, choices.GraspKind, "--kind")
        option_checks.check_speed(self.speed)
        option_checks.check_distance("margin", self.margin)
        if self.clearance is not None:
            option_checks.check_distance("clearance", self.clearance)
        least = self.min_success
        if least is not None and not 0 <= least < 1:
            wrong = f"{least} is not a probability"
            raise InputError(wrong, where="--min-success", allowed="0 ≤ p < 1")

    def acceptance(self) -> AcceptanceConfig:
        """Default thresholds, or `min_success` as the least probability, of fallbacks too."""
        from pointsdf_cli.planning.acceptance import AcceptanceConfig

        least, default = self.min_success, AcceptanceConfig()
        if least is None:
            return default
        return AcceptanceConfig(max(least, default.success), least, floor=least)


@dataclass(frozen=True)
class PlanRequest:
    """Input of a plan, apart from the robot, the networks and the number of threads.

    Attributes:
        clouds: Clouds, one for each camera, each with its pose.
        names: Names of the clouds, for messages.
        choices: Options of the search.
        environment: Known table and obstacles.
        start: [J], the robot's present configuration [rad], or the arm's alone; its home if None.
        seed: Random seed; equal seeds give equal plans.
        segment: "auto", or "none" if the clouds hold the object alone.
        target: The user's choice of the object.
        others: Treat other observed objects as obstacles.
        workspace: Corners [m] of the workspace; the default ones if None.
        cleaned: Drop flying pixels, outliers and specks.
        obstacles: Model of other objects: "reconstruction", or "hull" of their seen points.
    """

    clouds: Sequence[Cloud] = ()
    names: Sequence[str] = ()
    choices: PlanChoices = field(default_factory=PlanChoices)
    environment: Environment = field(default_factory=Environment)
    start: Array | None = None
    seed: int = 0
    segment: str = "auto"
    target: TargetChoice | None = None
    others: bool = True
    workspace: Corners | None = None
    cleaned: bool = True
    obstacles: str = option_checks.RECONSTRUCTION

    def check(self) -> None:
        """Refuse an unusable request before anything heavy is imported.

        Raises:
            InputError: Options exclude each other, or a cloud has no pose, another unit than
                metres, or too few points.
        """
        has_target, has_workspace = self.target is not None, self.workspace is not None
        option_checks.check_segment(self.segment, has_target, has_workspace)
        require_choice(self.obstacles, choices.Obstacles, "--obstacles")
        check = check_object_cloud if self.segment == "none" else check_scene_cloud
        for cloud, name in zip(self.clouds, self.names, strict=True):
            require_pose(cloud, name)
            check(cloud, name)


@dataclass(frozen=True)
class PlanResult:
    """A plan and its inputs.

    Attributes:
        plan: The artifact; its status says whether there is a plan.
        report: Sentences about the segmentation.
        warnings: Sentences about implausible input.
        start: [J], the robot's start configuration.
        points: [N, 3], observed points of the object, world, m.
        camera: [3], position of the first camera.
        obstacles: All obstacles.
        options: The planner's options in plain types, as stored in the plan file.
        least: Probability below which a grasp is not likely to hold.
        table: Whether there is a table.
    """

    plan: Plan
    report: tuple[str, ...]
    warnings: tuple[str, ...]
    start: Array
    points: Array
    camera: Array
    obstacles: tuple[Obstacle, ...]
    options: dict[str, Any]
    least: float
    table: bool = True

    def messages(self) -> dict[str, Any]:
        """Entries of the JSON of `plan --json` and of the server, besides the plan."""
        likely = bool(self.plan.success_probability >= self.least)
        return {"report": list(self.report), "warnings": list(self.warnings), "likely": likely}


def headline(plan: Plan) -> str:
    """Summarise the outcome in one line."""
    if plan.reason:
        return f"no plan: {plan.reason}. {plan.sentence}"
    return f"{plan.kind} grasp, predicted to hold with probability {plan.success_probability:.2f}"


def as_sentences(warnings: Sequence[str]) -> str:
    """Join warnings to the text stored in a plan."""
    ended = (each if each[-1] in ".?" else f"{each}." for each in warnings)
    return " ".join(f"{each[0].upper()}{each[1:]}" for each in ended)
