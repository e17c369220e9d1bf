"""Procedural stand-ins for the eight objects of the paper's trials: same kind, same size.

They are made by the generators of household objects with the parameters written here, so that the
trials need no download. Sizes are those of the YCB scans, and of shop goods for the two objects
that are not in YCB.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pointsdf_cli.errors import InputError
from pointsdf_cli.objects.families import choose_families
from pointsdf_cli.objects.family import Draw, Option, Value
from pointsdf_cli.objects.generate import build


@dataclass(frozen=True)
class StandIn:
    """One object as a member of a family.

    Attributes:
        family: Family in objects/families.py.
        parameters: Fixed parameters; all others take the middle of their range.
        size: Box to which the object is then stretched, along x, y and z [m].
    """

    family: str
    parameters: Mapping[str, Value]
    size: tuple[float, float, float]


def _bottle(size: tuple[float, float, float], **parameters: Value) -> StandIn:
    return StandIn("squeeze_bottle", parameters, size)


STAND_INS: dict[str, StandIn] = {
    "mustard": _bottle(
        (0.096, 0.058, 0.191),
        cap_form="nozzle",
        half_width=0.048,
        depth_ratio=0.6,
        height_ratio=3.5,
        squareness=2.6,
        waist=0.95,
        top_ratio=0.8,
    ),
    "soft_scrub": _bottle(
        (0.102, 0.068, 0.251),
        cap_form="flat",
        half_width=0.051,
        depth_ratio=0.67,
        height_ratio=4.6,
        squareness=3.2,
        waist=0.9,
        top_ratio=0.85,
    ),
    "toy_airplane": StandIn(
        "aeroplane",
        {
            "length": 0.25,
            "body_ratio": 0.16,
            "span_ratio": 1.05,
            "wing_thickness": 0.01,
            "biplane": False,
            "propeller": True,
        },
        (0.26, 0.255, 0.15),
    ),
    "lego": StandIn(
        "brick",
        {"pitch": 0.016, "rows": 4, "columns": 2, "height_units": 1.2, "hollow_below": False},
        (0.032, 0.064, 0.024),
    ),
    "pringles": StandIn(
        "crisps_tube", {"radius": 0.0375, "height_ratio": 6.6}, (0.077, 0.077, 0.247)
    ),
    "pitcher": StandIn(
        "pitcher",
        {
            "radius": 0.056,
            "height_ratio": 4.3,
            "mouth_ratio": 1.0,
            "belly_ratio": 1.0,
            "closed": True,
            "grip_bar": False,
        },
        (0.149, 0.116, 0.242),
    ),
    "juice_box": StandIn(
        "drink_carton",
        {"width": 0.064, "depth_ratio": 0.66, "height_ratio": 1.64, "top": "flat", "cap": False},
        (0.064, 0.042, 0.105),
    ),
    "max_gel": _bottle(
        (0.075, 0.055, 0.185),
        cap_form="dome",
        half_width=0.0375,
        depth_ratio=0.73,
        height_ratio=4.4,
        squareness=2.2,
        waist=1.0,
        top_ratio=0.95,
    ),
}


class FixedDraw(Draw):
    """Deterministic draws: named values as given, all others at the middle of their range."""

    def __init__(self, values: Mapping[str, Value]) -> None:
        super().__init__(np.random.default_rng(0))
        self._given = dict(values)

    def uniform(self, name: str, low: float, high: float) -> float:
        """The given value, or the mean of the limits."""
        return self._record(name, float(self._given.get(name, (low + high) / 2)))

    def log_uniform(self, name: str, low: float, high: float) -> float:
        """The given value, or the geometric mean of the limits."""
        return self._record(name, float(self._given.get(name, float(np.sqrt(low * high)))))

    def integer(self, name: str, low: int, high: int) -> int:
        """The given value, or the middle whole number."""
        return self._record(name, int(self._given.get(name, (low + high) // 2)))

    def choice(self, name: str, options: Sequence[Option]) -> Option:
        """The given value, or the first option."""
        return self._record(name, self._given.get(name, options[0]))

    def chance(self, name: str, probability: float) -> bool:
        """The given value, or the likelier one."""
        return self._record(name, bool(self._given.get(name, probability > 0.5)))


def make_stand_in(name: str) -> tuple[np.ndarray, np.ndarray]:
    """The stand-in of a trial object: vertices [V, 3] float32 m and faces [F, 3] int32.

    Raises:
        InputError: No such object.
    """
    if name not in STAND_INS:
        raise InputError(f"no stand-in {name!r}", allowed=", ".join(STAND_INS))
    wanted = STAND_INS[name]
    (family,) = choose_families([wanted.family])
    draw = FixedDraw({"unevenness": 0.0, **wanted.parameters})
    vertices, faces = build(family, draw)
    unknown = set(wanted.parameters) - set(draw.values)
    if unknown:
        raise ValueError(f"{wanted.family} draws no {', '.join(sorted(unknown))}")
    # Stretch by a few per cent instead of solving for the parameters.
    scale = np.asarray(wanted.size) / np.ptp(vertices, axis=0)
    return (vertices * scale).astype(np.float32), faces
