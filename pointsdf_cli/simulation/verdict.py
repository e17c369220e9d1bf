"""Verdicts on an executed grasp: lifted, held, unshaken, and why not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pointsdf_cli.geometry.arrays import Array

FLUNG_SPEED = 3.0
"""Speed [m/s] above which an object was ejected by the contact solver, not moved by a hand."""
DEEPEST = 0.008
"""Final depth [m] of a robot link in the object above which contacts have failed."""
HELD_FRACTION = 0.7
"""Least rise of a held object, as a share of the lift's height."""
FARTHEST_RISE = 0.5
"""Largest credible rise of an object [m]."""

UNTRIED = -1
"""Value of `Outcome.unshaken` without pushes."""

LIFT, HOLD, PUSH = "lift", "hold", "push"
PUSHES: dict[str, Array] = {
    f"{PUSH} {sign}{axis}": np.where(np.arange(3) == k, -1.0 if sign == "-" else 1.0, 0.0)
    for k, axis in enumerate("xyz")
    for sign in "+-"
}
"""Names and directions [3], world frame, of the pushes of a held object, in their order."""


@dataclass(frozen=True)
class Outcome:
    """Result of an executed grasp. Each verdict implies those before it.

    Attributes:
        lifted: Whether the object rose with the hand and is in it after the lift.
        held: Whether it is still in the hand after the hold; equal to `lifted` without a hold.
        unshaken: 1 if it is still in the hand after all pushes, 0 if it was lost in one or before,
            `UNTRIED` without pushes.
        lost_in: Step in which it was lost: "lift", "hold" or a key of `PUSHES`; else empty.
        valid: Whether the simulation until the verdict `held` is credible; if not, `held` is False.
        cause: "held", or why not: "missed" (no contact at the beginning of the lift), "slipped",
            "dropped", "flung", "penetration".
        lift_height: Rise of the object's centre of mass at the verdict `held` [m].
        slip: Its motion in the palm's frame from the grip until then [m].
        links: Number of the hand's links in contact with it then.
        duration: Simulated time [s].
    """

    lifted: bool
    held: bool
    unshaken: int
    lost_in: str
    valid: bool
    cause: str
    lift_height: float
    slip: float
    links: int
    duration: float


@dataclass(frozen=True)
class Seen:
    """Observation of the object and the hand at one moment.

    Attributes:
        rise: Rise of the object's centre of mass [m].
        hand_links: Number of the hand's links that touch the object.
        depth: Deepest overlap of any robot link with it [m].
        on_table: Whether it touches the table.
        fastest: Its greatest speed so far [m/s].
    """

    rise: float
    hand_links: int
    depth: float
    on_table: bool
    fastest: float


def cause_of(seen: Seen, lift_height: float, touched: bool) -> str:
    """Cause of an outcome: "held", or why the object is not held.

    Args:
        seen: The object at the end.
        lift_height: Height of the lift [m].
        touched: Whether the hand touched the object when the lift began.
    """
    if seen.fastest > FLUNG_SPEED or not np.isfinite(seen.rise) or seen.rise > FARTHEST_RISE:
        return "flung"
    if seen.depth > DEEPEST:
        return "penetration"
    if seen.rise >= HELD_FRACTION * lift_height and seen.hand_links > 0 and not seen.on_table:
        return "held"
    if not touched:
        return "missed"
    return "slipped" if seen.hand_links > 0 else "dropped"
