"""Reason why there is no plan, as a code for programs and a sentence for people.

After all rounds two things are known: the collisions of the sampled grasps before any solver moved
them, and the slack of the solver's best solution. If hardly any sampled grasp is free, the most
frequent collision is the reason: the solver can then only move away from the object, and its best
solution would fail for a low success probability.
"""

from __future__ import annotations

from dataclasses import dataclass

from pointsdf_cli.errors import InputError
from pointsdf_cli.planning.acceptance import AcceptanceConfig, Candidate

REASONS = (
    "no_object",
    "inverse_kinematics",
    "table_collision",
    "object_collision",
    "self_collision",
    "low_success_probability",
    "objective",
    "closing",
    "motion",
    "solver",
    "not_tried",
    "lift",
)
"""Reason codes of the plan artifact. "not_tried" (others came first) and "lift" (the arm cannot
raise the hand from there) apply to rejected grasps only."""

COLLISIONS = {
    "object": (
        "object_collision",
        "the object",
        "it may be larger than the open hand; ask for the other --kind",
    ),
    "table": (
        "table_collision",
        "the table",
        "the object may be too low for this kind; ask for the other --kind",
    ),
    "obstacle": ("table_collision", "an obstacle", "clear the space around the object"),
    "itself": ("self_collision", "the robot itself", "move the object away from the robot's base"),
}
"""Reason, name of what is met and advice, by the field of `SeedStatistics`."""

FREE_SHARE = 0.05
"""Share of free grasps among the reached ones below which collisions are the reason."""
FEW_GRASPS = 1000
"""Number of executed training grasps of the success network below which a plan warns."""


@dataclass(frozen=True)
class SeedStatistics:
    """Counts of the sampled palms by outcome.

    Attributes:
        drawn: All palms.
        above_table: Palms above the table.
        reached: Palms above the table that the arm reaches.
        free: Reached palms without collision.
        object, table, obstacle, itself: Reached palms in collision, by their deepest collision.
    """

    drawn: int = 0
    above_table: int = 0
    reached: int = 0
    free: int = 0
    object: int = 0
    table: int = 0
    obstacle: int = 0
    itself: int = 0

    def __add__(self, other: SeedStatistics) -> SeedStatistics:
        sums = {name: count + getattr(other, name) for name, count in vars(self).items()}
        return SeedStatistics(**sums)

    @property
    def in_the_way(self) -> str:
        """Name of the field with the most frequent collision of the reached grasps."""
        return max(COLLISIONS, key=lambda name: getattr(self, name))

    @property
    def is_hardly_free(self) -> bool:
        """Whether so few of the reached grasps are free that collisions are the reason."""
        return self.reached > 0 and self.free < FREE_SHARE * self.reached


def is_hemmed_in(statistics: SeedStatistics) -> bool:
    """Whether collisions with obstacles or the robot itself are the reason."""
    return statistics.is_hardly_free and statistics.in_the_way in ("obstacle", "itself")


def why_none(
    statistics: SeedStatistics,
    rejected: list[Candidate],
    seeds_tried: int,
    config: AcceptanceConfig | None = None,
) -> tuple[str, str]:
    """Reason code and sentence for a search without an accepted candidate."""
    miss = min(  # by violation, then by success probability
        rejected,
        key=lambda c: (round(max(0.0, -c.worst_slack), 4), -c.success, c.objective),
        default=None,
    )
    if not statistics.drawn:
        unseen = "The success network saw no grasp of this kind in training"
        advice = "ask for the other --kind, or train it on more grasps."
        return "low_success_probability", f"{unseen}: {advice}"
    if not statistics.above_table:
        return "table_collision", (
            f"The palms of all {statistics.drawn} drawn grasps are below the table's top: the "
            "object is too low for this kind; ask for the other --kind, or check the camera's pose."
        )
    if miss is None:
        return "inverse_kinematics", explain("inverse_kinematics", None, seeds_tried, config)
    if statistics.is_hardly_free:
        met = statistics.in_the_way
        reason, what, advice = COLLISIONS[met]
        reached, free, entering = statistics.reached, statistics.free, getattr(statistics, met)
        sentence = f"Of {reached} reachable grasps {entering} enter {what} ({free} free): {advice}."
        return reason, sentence
    return miss.reason, explain(miss.reason, miss, seeds_tried, config)


def too_large(width: float, span: float) -> tuple[str, str]:
    """Reason code and sentence for an object of least width `width` and a hand of `span` [m]."""
    wide = f"The object is {width * 100:.0f} cm wide where it is narrowest"
    hand = f"larger than the open hand ({span * 100:.0f} cm)"
    return "object_collision", f"{wide}, {hand}: it cannot be grasped as a whole."


def few_grasps(learned_from: int | None) -> list[str]:
    """Warning if the success network learned from fewer than `FEW_GRASPS` executed grasps; empty if
    `learned_from` is None."""
    if learned_from is None or learned_from >= FEW_GRASPS:
        return []
    few = f"learned from {learned_from} grasps only, fewer than {FEW_GRASPS}"
    return [f"the success network {few}: its probabilities say little"]


def warning(chosen: Candidate, seeds_tried: int) -> str:
    """Warning for a plan whose grasp would not have been accepted."""
    if chosen.closing_slack < 0:
        return (
            f"Of {seeds_tried} grasps none closes clear of obstacles; this one comes "
            f"{-chosen.closing_slack * 1000:.0f} mm too near. Clear the space around the "
            "object, or turn it."
        )
    return (
        f"Of {seeds_tried} grasps none looks good; this is the best that touches nothing, "
        f"predicted to hold with probability {chosen.success:.2f} only. Turn the object, or look "
        "at it from another side."
    )


def explain(
    reason: str, best: Candidate | None, seeds_tried: int, config: AcceptanceConfig | None = None
) -> str:
    """One sentence for a reason code, with the numbers of the nearest miss.

    Raises:
        InputError: No such reason.
    """
    config = config or AcceptanceConfig()
    if reason not in REASONS:
        raise InputError(f"no reason {reason!r}", allowed=", ".join(REASONS))
    if reason == "no_object":
        return "No object was seen: check the camera's pose, the unit, and where it looks."
    if reason == "inverse_kinematics" or best is None:
        far = "The arm reaches none of the grasps that were drawn"
        return f"{far}: move the object nearer to the robot's middle reach, or away from its base."
    depth = f"{max(0.0, -best.worst_slack) * 1000:.1f} mm"
    closing = f"{max(0.0, -best.closing_slack) * 1000:.1f} mm"
    what = "the table" if best.table_slack <= best.obstacle_slack else "an obstacle"
    sentences = {
        "object_collision": f"The nearest of {seeds_tried} grasps enters the object by {depth}: it "
        "may be larger than the open hand; try another side or --clearance 0.",
        "table_collision": f"The nearest of {seeds_tried} grasps enters {what} by {depth}: clear "
        "the space around the object, or ask for top grasps (--kind top) if it is low.",
        "self_collision": f"The nearest of {seeds_tried} grasps folds the robot into itself by "
        f"{depth}: move the object away from the robot's base.",
        "low_success_probability": f"The best of {seeds_tried} grasps is predicted to hold with "
        f"probability {best.success:.2f}, not above {min(config.floor, config.least):g}: turn the "
        "object, or look at it from another side; --min-success 0 takes the best all the same.",
        "objective": f"The best of {seeds_tried} grasps has an objective of {best.objective:.2f}, "
        f"not below {config.objective:g}: it is unlike the grasps that the prior was learned from.",
        "closing": f"The nearest of {seeds_tried} grasps meets an obstacle when its fingers close, "
        f"by {closing}: clear the space around the object.",
        "motion": "A grasp was found, but no free path to it: start from another configuration, or "
        "clear the space between the robot and the object.",
    }
    outside = f"The solver ended outside of the joint limits from all {seeds_tried} seeds."
    return sentences.get(reason, outside)
