"""Verdicts on an executed grasp: lifted, held, unshaken, and why not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pointsdf_cli.geometry.arrays import Array

FLUNG_SPEED = 3.0
"""An object faster than this [m/s] was shot out by the contact solver, not moved by a hand."""
DEEPEST = 0.008
"""A robot link deeper in the object than this [m] at the end means that contacts failed."""
HELD_FRACTION = 0.7
"""Share of the lift's height that a held object must have risen."""
FARTHEST_RISE = 0.5
"""No hand lifts an object higher than this [m]."""

UNTRIED = -1
"""`Outcome.unshaken` where nothing was pushed."""

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
        lifted: The object rose with the hand and is in it after the lift.
        held: It is still in the hand after the hold; equal to `lifted` without a hold.
        unshaken: 1 if it is still in the hand after all pushes, 0 if it was lost in one or before,
            `UNTRIED` if nothing was to be pushed.
        lost_in: Step in which it was lost: "lift", "hold" or a key of `PUSHES`; else empty.
        valid: The simulation until `held` was judged can be believed; if not, `held` is False.
        cause: "held", or why not: "missed" (nothing touched when the lift began), "slipped",
            "dropped", "flung", "penetration".
        lift_height: Height by which the object's centre of mass had risen then [m].
        slip: Distance that it had moved then in the palm's frame since the grip [m].
        links: Links of the hand that touched the object then.
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
        rise: Height by which the object's centre of mass has risen [m].
        hand_links: Links of the hand that touch the object.
        depth: Deepest overlap of any robot link with it [m].
        on_table: It touches the table.
        fastest: Greatest speed that it has had [m/s].
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
        touched: The hand touched the object when the lift began.
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
