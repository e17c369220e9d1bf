"""Writes lbr4_barrett.urdf: KUKA LBR4 with a BarrettHand BH8-282, from primitives only.

Run it after a change of any number here: `python assets/robots/make_lbr4_barrett.py`. Lengths,
angles and joint ranges of the fingers are those of the maker's pages ("BarrettHand BH8-280/282
kinematics, joint ranges, conversion factors"); so are speeds, forces and mass of the data sheet.
The two outer fingers stay where they oppose the third one: their spread is not modelled. A clutch
lets a fingertip close on after its finger is stopped: both joints close by themselves here.
"""

from __future__ import annotations

import math

from make_lbr4_allegro import COLOURS, DARK, GREY, WHITE, add_arm
from primitives import Joint, Link, Model, Shape, write_urdf

FROM_CENTRE, BASE, FINGER, TIP = 0.025, 0.050, 0.070, 0.058
"""Outer fingers from the middle (Aw), finger base (A1), finger (A2) and fingertip (A3) [m]."""
HEIGHT = 0.0754
"""Axes of the finger joints above the hand's flange [m]."""
BEND = math.radians(42)
"""Bend of the fingertip against its finger when both joints are at 0 (φ3)."""
CLOSED, TIP_CLOSED = math.radians(140), math.radians(48)
THICK, WIDE = 0.018, 0.017
"""Outline of a finger across its length [m]."""


def phalanx(name: str, mass: float, length: float, end: float) -> Link:
    """A part of a finger along x: its box, and the ball at its end."""
    box = Shape("box", (length, WIDE, THICK), (length / 2, 0, 0))
    ball = Shape("sphere", (end,), (length, 0, 0))
    return Link(name, mass, [(box, GREY), (ball, WHITE if "tip" in name else DARK)])


def add_palm(model: Model) -> None:
    """The hand's body, 2 cm of adapter above the arm's flange, and the three finger bases."""
    parts = [
        (Shape("cylinder", (0.045, 0.078), (0, 0, 0.039)), DARK),
        (Shape("cylinder", (0.030, 0.02), (0, 0, -0.01)), GREY),
    ]
    for x, y in ((-1, 1), (-1, -1), (1, 0)):
        box = Shape("box", (BASE, 0.022, 0.030), (x * BASE / 2, y * FROM_CENTRE, HEIGHT - 0.019))
        parts.append((box, GREY))
    model.links.append(Link("barrett_palm", 0.7, parts))
    # The flange frame of link 7 is 1.5 cm below its face.
    model.joints.append(
        Joint("barrett_mount", "lbr4_link_7", "barrett_palm", (0, 0, 0.035), kind="fixed")
    )


def add_finger(model: Model, name: str, seat: tuple[float, float], away: float) -> None:
    """A finger whose base joint is at `seat` and which lies along x, turned by `away` [rad]."""
    model.links += [
        phalanx(f"{name}_link", 0.06, FINGER, 0.009),
        phalanx(f"{name}_tip", 0.04, TIP - 0.009, 0.009),
    ]
    rows = [  # parent, child, origin, rpy, upper limit, effort, velocity
        ("barrett_palm", "link", (*seat, HEIGHT), (0, 0, away), CLOSED, 1.8, 2.44),
        (f"{name}_link", "tip", (FINGER, 0, 0), (0, -BEND, 0), TIP_CLOSED, 0.9, 0.84),
    ]
    for parent, child, origin, turn, upper, effort, velocity in rows:
        model.joints.append(
            Joint(
                f"{name}_{child}_joint",
                parent,
                f"{name}_{child}",
                origin,
                turn,
                axis=(0, -1, 0),
                limit=(0.0, upper),
                effort=effort,
                velocity=velocity,
                damping=0.02,
            )
        )


def build() -> Model:
    """The whole robot, arm first."""
    model = Model()
    add_arm(model)
    add_palm(model)
    add_finger(model, "left", (-BASE, FROM_CENTRE), math.pi)
    add_finger(model, "right", (-BASE, -FROM_CENTRE), math.pi)
    add_finger(model, "middle", (BASE, 0.0), 0.0)
    return model


if __name__ == "__main__":
    write_urdf(__file__, build(), COLOURS)
