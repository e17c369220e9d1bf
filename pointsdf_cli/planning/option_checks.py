"""Option names and ranges of the planner, checked before any slow import."""

from __future__ import annotations

from typing import get_args

from pointsdf_cli import choices
from pointsdf_cli.choices import require_choice
from pointsdf_cli.errors import InputError

RECONSTRUCTION, PARTIAL_VIEW = "reconstruction", "partial-view"
METHODS = get_args(choices.Method)

MARGIN = 0.004
"""Distance to the object that plans keep where they can [m]: reconstructions err by a few
millimetres on the unseen side, and arms lag behind their trajectory by as much."""
SPEED = 0.5
"""Usual share of the joints' speed limits."""
SLOWEST = 0.001
"""Least share of the joints' speed limits: a motion then takes an hour."""
LARGEST_CLEARANCE = 0.015
"""Largest clearance [m]. Distances are exact only up to 2 cm, and a hand that keeps 1.5 cm away
holds nothing."""


def check_speed(speed: float) -> None:
    """Require a share of the joints' speed limits.

    Raises:
        InputError: Less than `SLOWEST` or more than 1.
    """
    if not SLOWEST <= speed <= 1:
        raise InputError(f"{speed:g}", where="--speed", allowed=f"{SLOWEST:g} to 1")


def check_distance(name: str, value: float) -> None:
    """Require a plausible clearance or margin [m].

    Raises:
        InputError: Negative, or above `LARGEST_CLEARANCE`.
    """
    if not 0 <= value <= LARGEST_CLEARANCE:
        allowed = f"0 m or more, at most {LARGEST_CLEARANCE:g} m"
        raise InputError(f"a {name} of {value:g} m", where=f"--{name}", allowed=allowed)


def check_segment(segment: str, target: bool, workspace: bool) -> None:
    """Check the options of segmentation.

    Args:
        segment: One of `choices.Segment`.
        target, workspace: Whether these options were given; both need `auto`.

    Raises:
        InputError: `segment` is none of them, or excludes an option that was given.
    """
    require_choice(segment, choices.Segment, "--segment")
    for name, given in (("target", target), ("workspace", workspace)):
        if given and segment == "none":
            raise InputError(f"--{name} without --segment auto", hint="leave one of the two out")
