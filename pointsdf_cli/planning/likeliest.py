"""Choice of the grasp that is most likely to hold, among those of several rounds of seeds.

The paper ends the search with the first grasp of h > 0.6 and takes the one with the least cost. But
a calibrated h tells grasps above 0.6 apart: a few more rounds of seeds pay (docs/notebook.md,
"Searching on").
"""

from __future__ import annotations

from collections.abc import Iterable

from pointsdf_cli.planning.acceptance import Candidate

ENOUGH = 0.85
"""Probability to hold at which a grasp ends the search."""
NEARBY = 3
"""Number of grasps beside which the next round samples too."""
TIGHT = 0.95
"""Factor on the probability to hold of tight grasps: the unseen side may be nearer than
predicted."""
PREFERRED_SLACK = 0.006
"""Distance to the object [m] below which a grasp is tight; slacks are exact up to it."""


def probability_to_hold(candidate: Candidate, clearance: float) -> float:
    """Success probability of a candidate, less if it is tight.

    Args:
        candidate: The candidate.
        clearance: Clearance to the object [m] with which its slack was computed.
    """
    tight = candidate.object_slack < PREFERRED_SLACK - clearance
    return candidate.success * (TIGHT if tight else 1.0)


def likeliest_first(candidates: Iterable[Candidate], clearance: float) -> list[Candidate]:
    """Candidates by their probability to hold; equals keep their order.

    Args:
        candidates: The candidates.
        clearance: As in `probability_to_hold`.
    """
    return sorted(candidates, key=lambda one: -probability_to_hold(one, clearance))
