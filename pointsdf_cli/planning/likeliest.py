"""Choice of the grasp that is most likely to hold, among those of several rounds of seeds.

The paper ends the search with the first grasp of h > 0.6 and takes the one with the least cost. But
a calibrated h tells grasps above 0.6 apart: a few more rounds of seeds pay (docs/notebook.md,
"Searching on").
"""

from __future__ import annotations

from pointsdf_cli.planning.acceptance import Candidate

ENOUGH = 0.85
"""Probability to hold at which a grasp ends the search."""
MOST_MOTIONS = 12
"""Largest number of grasps for which motions are searched. The first few are often near each other,
and without a motion for the same reason."""
NEARBY = 3
"""Number of grasps beside which the next round samples too."""
TIGHT = 0.95
"""Factor on the probability to hold of grasps that keep less than the preferred slack from the
object, whose unseen side may be nearer than predicted."""


def trust(candidate: Candidate, least_slack: float) -> float:
    """Factor on a candidate's success probability, below 1 if it is tight.

    Args:
        candidate: The candidate.
        least_slack: Slack of the distance to the object [m] below which a grasp is tight.
    """
    return TIGHT if candidate.object_slack < least_slack else 1.0


class LikeliestChoice:
    """Choice by the success network.

    Args:
        least_slack: As in `trust`.
    """

    def __init__(self, least_slack: float) -> None:
        self.surface = None
        self.timings: dict[str, float] = {}
        self._least_slack = least_slack
        self._candidates: list[Candidate] = []

    def stop(self, new: list[Candidate]) -> bool:
        """Whether one of a round's candidates is likely enough to hold."""
        self._candidates += new
        return any(self._chance(one) >= ENOUGH for one in new)

    def best(self) -> list[Candidate]:
        """The grasps beside which the next round samples too."""
        return self._likeliest_first()[:NEARBY]

    def ranked(self, accepted: list[Candidate]) -> list[Candidate]:
        """The most likely few candidates of all rounds; fallbacks in their order."""
        return self._likeliest_first()[:MOST_MOTIONS] if self._candidates else accepted

    def of(self, chosen: Candidate | None) -> None:
        """No rehearsal."""

    def _likeliest_first(self) -> list[Candidate]:
        return sorted(self._candidates, key=self._chance, reverse=True)

    def _chance(self, candidate: Candidate) -> float:
        return candidate.success * trust(candidate, self._least_slack)
